"""A network from nested regions: leaves of a tree, terms in scaled signals."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset
from jaxnarx.models import (
    Network,
    OutputModel,
    SigmoidTree,
    SignedRoot,
    assemble,
    global_model,
    local_models,
    output_model,
)
from jaxnarx.partition.closed_form.design_matrix import (
    BlockDesign,
    Place,
    Region,
    Share,
    gates_on_path,
)
from jaxnarx.partition.closed_form.signals import RunSignals
from jaxnarx.regressors import Pool, Variables


def make_network(
    design: BlockDesign,
    leaves: tuple[Region, ...],
    theta: Float[np.ndarray, " columns"],
    data: Dataset,
) -> Network:
    """The network whose free run is that of these columns with these coefficients.

    A leaf's coefficients are the sums of those of the regions that hold it, since the
    weights of the leaves within a region sum to the region's; of a given partition, of
    all regions and of its own.
    """
    signals, a = design.signals, design.a
    table = np.zeros((len(leaves), len(signals.factor)))
    edge = 0
    for block in design.blocks:
        own = theta[edge : edge + len(block.terms)]
        edge += len(own)
        for row, leaf in zip(table, leaves, strict=True):
            if leaf[: len(block.region)] == block.region:
                row[block.terms] += own
    raw = _rescale_coefficients(signals, table, a)
    fed = np.tile(-a[1:], (len(leaves), 1))
    used = np.any(raw != 0, axis=0)
    pool = _with_feedback(signals, signals.factor[used], len(a) - 1)
    theta = np.concatenate([raw[:, used], fed], axis=1)
    if len(leaves) == 1:
        model = global_model(pool.factor, theta[0])
    else:
        model = _model_of_leaves(signals, leaves, pool, theta)
    if signals.root is not None:
        model = _of_root(model, signals.root.floor)
    return assemble(pool, data, signals.gain, [model])


def _of_root(model: OutputModel, floor: float) -> OutputModel:
    """The model of which all is one group that computes a root above a floor."""
    dtype = np.asarray(model.local.coefficient).dtype
    every = np.ones((1, len(np.asarray(model.active))), bool)
    own, *fields = jax.device_put((every, every[:, 0], np.array([floor], dtype)))
    return dataclasses.replace(model, own=own, root=SignedRoot(*fields))


def _rescale_coefficients(
    signals: RunSignals,
    table: Float[np.ndarray, "leaves terms"],
    a: Float[np.ndarray, " _"],
) -> Float[np.ndarray, "leaves terms"]:
    """Coefficients of the terms of scaled signals from those of centred ones."""
    back, outside, _ = signals.centring.reduce(signals.factor)
    assert not len(outside), "a product without its parts"
    raw = signals.spread * table @ back
    constant = np.flatnonzero(np.all(signals.factor == 0, axis=1))
    raw[:, constant[0]] += signals.middle * a.sum()
    return raw


def _with_feedback(signals: RunSignals, factor: np.ndarray, order: int) -> Pool:
    """Terms that are used, the output's lags last; variables without a term go."""
    pool = signals.pool
    entries = pool.variables.entries
    kept = [n for n in range(len(entries)) if np.any(factor == n + 1)]
    place = np.zeros(len(entries) + 1, np.int32)
    place[np.array(kept, int) + 1] = np.arange(1, len(kept) + 1)
    signal = len(pool.channels.inputs) + pool.outputs[0]
    lags = [(signal, lag, None) for lag in range(1, order + 1)]
    fed = np.zeros((order, factor.shape[1]), np.int32)
    fed[:, 0] = len(kept) + 1 + np.arange(order)
    variables = Variables.of([*(entries[n] for n in kept), *lags])
    rows = np.concatenate([place[factor], fed])
    return Pool(variables, rows, pool.channels, pool.outputs)


def _model_of_leaves(
    signals: RunSignals,
    leaves: tuple[Region, ...],
    pool: Pool,
    theta: Float[np.ndarray, "leaves terms"],
) -> OutputModel:
    """Leaves behind the gates on their ways, or as a given partition says."""
    first = leaves[0][0]
    if isinstance(first, Share):
        validity = first.validity
    else:
        validity = _make_tree(leaves, len(signals.scheduling))
    local = local_models(pool.factor, theta, sparse=True)
    return output_model(
        local, validity, signals.scheduling, signals.offset, signals.span
    )


def _make_tree(leaves: tuple[Region, ...], dims: int) -> SigmoidTree:
    """The gates on the ways to all leaves."""
    gates: dict[Place, int] = {}
    for leaf in leaves:
        for _, place in gates_on_path(leaf):
            gates.setdefault(place, len(gates))
    path = np.zeros((len(leaves), len(gates)), np.int32)
    for row, leaf in zip(path, leaves, strict=True):
        for gate, place in gates_on_path(leaf):
            row[gates[place]] = gate.side
    own = [gate for _, gate in gates]
    direction = np.eye(dims)[[g.dim for g in own]]
    border = np.array([g.border for g in own], float)
    steep = np.log([g.steepness for g in own])
    return SigmoidTree(*jax.device_put((direction, border, steep, path)))
