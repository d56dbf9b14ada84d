"""What a network computes of records, k steps ahead or freely: pure array functions."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.blocks import map_blocks
from jaxnarx.arrays.programs import program
from jaxnarx.arrays.recurrence import free_run, history_of
from jaxnarx.arrays.time_parallel import parallel_run
from jaxnarx.data.batch import Batch
from jaxnarx.models import (
    Network,
    advance,
    collapse,
    collapsed_step,
    collapses,
    depth,
    general_step,
    group_weights,
    widened,
)

BLOCK = 512
"""Samples of a record collapsed at a time: at 100,000 that took a third of the time."""


class RunInputs(eqx.Module):
    """What a run needs of the measurements, computed once per dataset.

    `v`: a leading one and the scaled lagged variables; `x`: scheduling variables of
    every output in physical units; `measured`: scaled outputs, and zeros for hidden
    channels, in whose place `jaxnarx.simulation.observer` puts what they start from;
    `known`: where an output was measured.
    """

    v: Float[Array, "records vars time"]
    x: tuple[Float[Array, "records _ time"], ...]
    measured: Float[Array, "records time outputs"]
    known: Bool[Array, "records time outputs"]


@program
def make_drive(network: Network, batch: Batch) -> RunInputs:
    """Lagged and scheduling variables of every record."""
    return drive_of(network, batch.signals, jnp.asarray(batch.valid))


def drive_of(
    network: Network,
    signals: Float[Array, "records time signals"],
    valid: Bool[Array, "records time signals"],
) -> RunInputs:
    """The same inside a program, from the arrays of a batch."""

    def one(record):
        signals, valid = record
        v, x = network.columns(signals, valid)
        own = np.array(network.signals)
        scaled = network.complete(signals) / network.gain[None]
        return v, x, scaled[:, own], network.complete(valid)[:, own]

    return RunInputs(*jax.lax.map(one, (signals, valid)))


def recursion(network: Network, v: Float[Array, "vars time"], x: tuple):
    """Step, parameters and drive of `free_run` for one record."""
    if collapses(network):

        def block(columns):
            parts = (collapse(network, *columns),)
            if network.parallel:
                parts = *parts, group_weights(network, columns[1])
            return tuple(jnp.moveaxis(part, -1, 0) for part in parts)

        g = map_blocks(block, (v, x), BLOCK)
        return collapsed_step(network), None, g if network.parallel else g[0]
    drive = (v.T, tuple(x_o.T for x_o in x))
    return general_step(network), eqx.filter(network, eqx.is_array), drive


def run_record(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    measured: Float[Array, "time outputs"],
    anchor: Bool[Array, " time"],
) -> Float[Array, "time outputs"]:
    """Scaled outputs of one record, restarted from the measurement at anchors.

    The one simulation semantics: a free run has one anchor. Pure and differentiable.
    """
    return run_states(network, v, x, measured, anchor)[:, : len(network.models)]


def run_states(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    measured: Float[Array, "time outputs"],
    anchor: Bool[Array, " time"],
) -> Float[Array, "time states"]:
    """What the loop of a run carries: the outputs, and those of local models that have
    feedback of their own (`jaxnarx.models.feedback`)."""
    bounds = widened(network, network.lower), widened(network, network.upper)
    inputs, start = recursion(network, v, x), widened(network, measured)
    return free_run(*inputs, start, anchor, *bounds, depth=depth(network))


@program
def run(
    network: Network, drive: RunInputs, anchor: Bool[Array, "records time"]
) -> Float[Array, "records time outputs"]:
    """Scaled outputs of all records."""
    one = partial(run_record, network)
    return jax.vmap(one)(drive.v, drive.x, drive.measured, anchor)


@program
def states(
    network: Network, drive: RunInputs, anchor: Bool[Array, "records time"]
) -> Float[Array, "records time states"]:
    """All that the loop of a run carries, for all records; see `run_states`."""
    one = partial(run_states, network)
    return jax.vmap(one)(drive.v, drive.x, drive.measured, anchor)


@program
def run_parallel(
    network: Network, drive: RunInputs, anchor: Bool[Array, "records time"]
) -> tuple[Float[Array, "records time outputs"], Bool[Array, " records"]]:
    """Scaled outputs of all records, parallel in time, and where that has succeeded.

    See `jaxnarx.arrays.time_parallel.parallel_run`; records go one after the other.
    """

    def one(record):
        v, x, measured, anchor = record
        bounds = widened(network, network.lower), widened(network, network.upper)
        inputs, start = recursion(network, v, x), widened(network, measured)
        lags = depth(network)
        y, converged = parallel_run(*inputs, start, anchor, *bounds, depth=lags)
        return y[:, : len(network.models)], converged

    return jax.lax.map(one, (drive.v, drive.x, drive.measured, anchor))


@program
def run_steps(
    network: Network, drive: RunInputs, k: Int[Array, ""]
) -> tuple[Float[Array, "records time outputs"], Bool[Array, "records time outputs"]]:
    """Scaled k-step-ahead prediction of every sample; `k` may be traced.

    All starting points advance together: the history of sample t holds measurements up
    to t - k and predictions after that. The bound is one of the feedback: it holds the
    predictions on the way, and says where it did, but not the last one, which nothing
    is computed from.
    """
    lower, upper = (widened(network, b) for b in (network.lower, network.upper))

    def one(v, x, measured):
        measured = widened(network, measured)
        past = jnp.moveaxis(history_of(measured, depth(network)), 0, -1)
        past = jnp.roll(past, k - 1, axis=-1)

        def one_on(j, carry):
            past, _, held = carry
            shift = k - 1 - j
            inputs = jax.tree.map(lambda a: jnp.roll(a, shift, axis=-1), (v, x))
            y = advance(network, inputs[0], inputs[1], past)
            fed = jnp.clip(y, lower[:, None], upper[:, None])
            held |= (shift > 0) & ((fed <= lower[:, None]) | (fed >= upper[:, None]))
            return jnp.concatenate([fed[:, None], past[:, :-1]], axis=1), y, held

        start = past, past[:, 0], jnp.zeros(past[:, 0].shape, bool)
        _, y, held = jax.lax.fori_loop(0, k, one_on, start)
        outputs = len(network.models)
        return y[:outputs].T, held[:outputs].T

    return jax.lax.map(lambda a: one(*a), (drive.v, drive.x, drive.measured))
