"""Runs of a network over records, k steps ahead or free: pure array functions."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import past_outputs, program
from jaxnarx.data import Batch
from jaxnarx.models import (
    LINEAR,
    Network,
    advance,
    depth,
    hold_signals,
    run_record,
    run_states,
    widen,
)
from jaxnarx.regressors import batch_columns


class RunInputs(eqx.Module):
    """The arrays that a run needs of the measurements, computed once per dataset.

    `v`: a leading one and the scaled lagged variables; `x`: scheduling variables of
    every output in physical units; `measured`: scaled outputs, and zeros for hidden
    channels, in whose place `jaxnarx.models.observer` puts what they start from;
    `known`: where an output was measured.
    """

    v: Float[Array, "records vars time"]
    x: tuple[Float[Array, "records _ time"], ...]
    measured: Float[Array, "records time outputs"]
    known: Bool[Array, "records time outputs"]


def make_drive(network: Network, batch: Batch) -> RunInputs:
    """Lagged and scheduling variables of every record, computed on the host.

    `drive_from_signals` is the same inside of a program; here other lags, terms or
    regions compile nothing.
    """
    given, valid = np.asarray(batch.signals), np.asarray(batch.valid)
    if network.hidden:
        room = [(0, 0), (0, 0), (0, network.hidden)]
        given, valid = np.pad(given, room), np.pad(valid, room)
    seen, table = hold_signals(network, given), network.variables
    step, linear = float(network.sample_time), network.outside == LINEAR
    with np.errstate(all="ignore"):  # values may be far beyond all others, gains absurd
        unit = 1 / np.asarray(network.gain)
        scaled = seen * unit
        measured = scaled if network.plain else given * unit
        beyond = (given - seen) * unit if linear else None
    v = batch_columns(scaled, valid, table, step, ones=1)
    if beyond is not None:
        v = np.concatenate([v, batch_columns(beyond, valid, table, step)], axis=1)
    x = [batch_columns(seen, valid, m.scheduling, step) for m in network.models]
    own = np.array(network.signals)
    drive = v, tuple(x), measured[..., own], valid[..., own]
    return RunInputs(*jax.device_put(drive))


def drive_from_signals(
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
def run_steps(
    network: Network, drive: RunInputs, k: Int[Array, ""]
) -> tuple[Float[Array, "records time outputs"], Bool[Array, "records time outputs"]]:
    """Scaled k-step-ahead prediction of every sample; `k` may be traced.

    All starting points advance together: the history of sample t holds measurements up
    to t - k and predictions after that. The bound is one of the feedback: it holds the
    predictions on the way, and says where it did, but not the last one, which nothing
    is computed from.
    """
    lower, upper = (widen(network, b) for b in (network.lower, network.upper))

    def one(v, x, measured):
        measured = widen(network, measured)
        past = jnp.moveaxis(past_outputs(measured, depth(network)), 0, -1)
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
