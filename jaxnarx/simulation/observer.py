"""Runs of networks with hidden channels: what these start from, record by record."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from jaxnarx.arrays import program
from jaxnarx.models import (
    Network,
    depth,
    hidden_start,
    start_of_window,
    window_size,
    with_hidden_start,
)
from jaxnarx.simulation.runs import RunInputs

WINDOWS_AT_ONCE = 256
"""Windows estimated together."""


def begin_hidden(
    network: Network, drive: RunInputs, start: Int[Array, " records"]
) -> RunInputs:
    """Set the hidden channels' values before the sample at which each record begins.

    Records without such a sample (`start` is their length) keep zeros. Outside of a
    program the windows are cut out first: one program then serves records of any number
    and length.
    """
    if not network.hidden:
        return drive
    if _is_traced(network, drive, start):
        measured = _begin(network, drive, start)
    else:
        measured = _begin_on_host(network, drive, np.asarray(start))
    return eqx.tree_at(lambda d: d.measured, drive, measured)


def observe_hidden(network: Network, drive: RunInputs) -> RunInputs:
    """Estimate the hidden channels' values at every sample, from the window that ends
    there."""
    if not network.hidden:
        return drive
    measured = _observe(network, drive, exact=_is_traced(network, drive))
    return eqx.tree_at(lambda d: d.measured, drive, measured)


def _is_traced(*trees: Any) -> bool:
    """Whether derivatives may be asked for: programs without them compile faster."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


@program
def _begin(
    network: Network, drive: RunInputs, start: Int[Array, " records"]
) -> Float[Array, "records time outputs"]:
    def one(record):
        return with_hidden_start(network, *record)

    each = drive.v, drive.x, drive.measured, drive.known, start
    return jax.lax.map(one, each)


def _begin_on_host(
    network: Network, drive: RunInputs, start: Int[np.ndarray, " records"]
) -> Float[Array, "records time outputs"]:
    """`_begin` without derivatives."""
    measured = np.array(drive.measured)
    records, time = measured.shape[:2]
    size, lags = window_size(network, time), depth(network)
    row = np.clip(start - lags, 0, time - size)
    at = row[:, None] + np.arange(size)

    def cut(a: Any, axis: int) -> np.ndarray:
        """The windows, and copies of the first that fill up a power of two."""
        a, index = np.asarray(a), np.expand_dims(at, 3 - axis)
        own = np.take_along_axis(a, index, axis)
        return np.concatenate([own, np.repeat(own[:1], _spare(records), axis=0)])

    along = cut(drive.v, 2), tuple(cut(x, 2) for x in drive.x)
    windows = *along, cut(measured, 1), cut(drive.known, 1)
    found = np.asarray(_starts_of_windows(network, *jax.device_put(windows)))
    found = np.where((start < time)[:, None, None], found[:records], 0.0)
    row = np.clip(start - lags, 0, time - lags)
    rows = row[:, None] + np.arange(lags)
    measured[np.arange(records)[:, None], rows, len(network.modelled) :] = found
    return jax.device_put(measured)


def _spare(count: int) -> int:
    """How many are missing to the next power of two, of four at least."""
    return max(4, 1 << max(count - 1, 0).bit_length()) - count


@program
def _starts_of_windows(network: Network, *windows: Any) -> Float[Array, "r lags own"]:
    def one(window):
        return start_of_window(network, *window, exact=False)[0]

    return jax.lax.map(one, windows)


@program
def _observe(
    network: Network, drive: RunInputs, *, exact: bool
) -> Float[Array, "records time outputs"]:
    time, count = drive.measured.shape[1], len(network.modelled)

    def one(record):
        v, x, measured, known = record

        def start_at(end):
            first = end - network.window
            return hidden_start(network, v, x, measured, known, first, exact=exact)[1]

        ends = 1 + jnp.arange(time)
        hidden = jax.lax.map(start_at, ends, batch_size=min(WINDOWS_AT_ONCE, time))
        early = ends - network.window < depth(network)
        return measured.at[:, count:].set(jnp.where(early[:, None], 0.0, hidden))

    return jax.lax.map(one, (drive.v, drive.x, drive.measured, drive.known))
