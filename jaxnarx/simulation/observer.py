"""Runs of networks with hidden channels: what these start from, record by record."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from jaxnarx.arrays import program
from jaxnarx.models import Network, depth, hidden_start, with_hidden_start
from jaxnarx.simulation.runs import RunInputs

WINDOWS_AT_ONCE = 256
"""Windows estimated together."""


def begin_hidden(
    network: Network, drive: RunInputs, start: Int[Array, " records"]
) -> RunInputs:
    """Set the hidden channels' values before the sample at which each record begins.

    Records without such a sample (`start` is their length) keep zeros.
    """
    if not network.hidden:
        return drive
    measured = _begin(network, drive, start, exact=_is_traced(network, drive))
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
    network: Network, drive: RunInputs, start: Int[Array, " records"], *, exact: bool
) -> Float[Array, "records time outputs"]:
    def one(record):
        return with_hidden_start(network, *record, exact=exact)

    each = drive.v, drive.x, drive.measured, drive.known, start
    return jax.lax.map(one, each)


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
