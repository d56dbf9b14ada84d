"""Hidden states in regions: the worst local model is divided by a gate, in free run.

All that is computed, outputs and states, has local models in the leaves of a tree of
sigmoid gates over the last states and the inputs,

    z(t) = sum_m phi_m(z(t-1), u(t)) (A_m z(t-1) + B_m u(t) + b_m) .

The leaf with the largest sum of validity times squared error of the free run is
divided: a gate through the centre of gravity of what it is valid for, across every axis
in turn, both children with the coefficients of their parent. Training moves the gates
of every output and state apart from each other, whatever they began with.

Local linear state-space models: M. Schüssler, T. Münker and O. Nelles, Local model
networks for the identification of nonlinear state space models, IEEE CDC 2019.
"""

import dataclasses
from collections.abc import Iterator

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset
from jaxnarx.models import (
    LocalModels,
    Network,
    OutputModel,
    SigmoidTree,
    scaled_points,
    weights_at,
)
from jaxnarx.simulation import match_records, simulate

FIRST_STEEPNESS = 2.0
"""Steepness of a gate at first, for one standard deviation of what a leaf is valid
for."""
LEAST_DEVIATION = 1e-6
"""Least standard deviation across a gate, in units of the trained range."""


def pad_models(network: Network, most: int) -> Network:
    """The network with a place for so many local models, and one of them active.

    All its variables schedule. One program trains it, however many are active.
    """
    signal = [s for s, _ in network.variables]
    low, high = (np.asarray(a)[signal] for a in (network.low, network.high))
    span = np.where(high > low, high - low, 1.0)
    models = []
    for model in network.models:
        dense = np.asarray(model.local.dense())[:1]
        terms, gates = dense.shape[1], most - 1
        local = LocalModels(
            model.local.factor,
            *jax.device_put(
                (
                    np.tile(np.arange(terms), (most, 1)),
                    np.ones((most, terms), bool),
                    np.tile(dense, (most, 1)),
                )
            ),
        )
        nowhere = np.zeros((gates, len(signal)))
        tree = SigmoidTree(
            *jax.device_put(
                (nowhere, *np.zeros((2, gates)), np.zeros((most, gates), int))
            )
        )
        leaves = low, span, np.arange(most) < 1
        offset, span_, active = jax.device_put(leaves)
        models.append(
            OutputModel(network.variables, offset, span_, tree, active, local)
        )
    return dataclasses.replace(network, models=tuple(models))


def split_candidates(network: Network, data: Dataset) -> Iterator[Network]:
    """The network with its worst leaf divided, across every axis of the data."""
    points, wrong = visited_points(network, data)
    first = network.models[0]
    every = weights_at(first, points)
    leaf = int(np.argmax(every @ wrong))
    weight, z = every[leaf], scaled_points(first, points)
    centre = weight @ z / weight.sum()
    spread = np.sqrt(weight @ (z - centre) ** 2 / weight.sum())
    for dim in np.flatnonzero(spread > LEAST_DEVIATION).tolist():
        gate = np.eye(len(spread))[dim], centre[dim], FIRST_STEEPNESS / spread[dim]
        models = (_divide(model, leaf, *gate) for model in network.models)
        yield dataclasses.replace(network, models=tuple(models))


def visited_points(
    network: Network, data: Dataset
) -> tuple[Float[np.ndarray, "rows dims"], Float[np.ndarray, " rows"]]:
    """States and inputs that a free run is computed from, as the network lags them, and
    the squared error of all outputs."""
    first, longest = len(network.channels.measured.all), 1 + network.history
    data = match_records(network, data)
    run, own = simulate(network, data).value, list(network.modelled)
    spread = np.concatenate([r.y[:, own] for r in data]).std(axis=0)
    points, wrong = [], []
    for record, hidden, made, scored in zip(
        data, run.hidden, run.outputs, run.scored, strict=True
    ):
        error = np.where(scored, (made - record.y[:, own]) / spread, 0.0)
        at = np.flatnonzero(scored.any(axis=1))
        at = at[at >= longest]
        columns = (
            hidden[at - lag, s - first] if s >= first else record.u[at - lag, s]
            for s, lag in network.variables
        )
        points.append(np.stack(list(columns), axis=1))
        wrong.append((error[at] ** 2).sum(axis=1))
    return np.concatenate(points), np.concatenate(wrong)


def _divide(
    model: OutputModel, leaf: int, direction: np.ndarray, border: float, steep: float
) -> OutputModel:
    """Add a gate to a leaf; the new leaf lies above it."""
    new = int(np.asarray(model.active).sum())
    names = ("direction", "border", "log_steepness", "path")
    tree = {name: np.array(getattr(model.validity, name)) for name in names}
    for name, value in zip(names, (direction, border, np.log(steep)), strict=False):
        tree[name][new - 1] = value
    tree["path"][new] = tree["path"][leaf]
    tree["path"][[leaf, new], new - 1] = -1, 1
    coefficient, active = np.array(model.local.coefficient), np.array(model.active)
    coefficient[new], active[new] = coefficient[leaf], True
    tree, coefficient, active = jax.device_put((tree, coefficient, active))
    local = dataclasses.replace(model.local, coefficient=coefficient)
    return dataclasses.replace(
        model, validity=SigmoidTree(**tree), active=active, local=local
    )


def drop_inactive(network: Network) -> Network:
    """The network without places for local models that are not active."""
    models = []
    for model in network.models:
        count = int(np.asarray(model.active).sum())
        tree = model.validity
        if not isinstance(tree, SigmoidTree) or count == len(np.asarray(model.active)):
            return network
        gates = max(count - 1, 0)
        tree = SigmoidTree(
            tree.direction[:gates],
            tree.border[:gates],
            tree.log_steepness[:gates],
            tree.path[:count, :gates],
        )
        parts = (model.local.index, model.local.used, model.local.coefficient)
        local = LocalModels(model.local.factor, *(part[:count] for part in parts))
        models.append(
            dataclasses.replace(
                model, validity=tree, active=model.active[:count], local=local
            )
        )
    return dataclasses.replace(network, models=tuple(models))
