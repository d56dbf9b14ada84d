"""The run of one record: how a network's recursion is driven along measured inputs."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import free_run, map_blocks
from jaxnarx.models.feedback import (
    collapse,
    collapsed_step,
    collapses,
    depth,
    general_step,
    group_root,
    group_weights,
    widen,
)
from jaxnarx.models.network import Network

BLOCK_SAMPLES = 512
"""Samples of a record collapsed at a time: at 100,000 that took a third of the time."""


def recursion(network: Network, v: Float[Array, "vars time"], x: tuple):
    """The recursion of one record's free run: its step, parameters and drive, as
    `free_run` takes them."""
    if collapses(network):

        def block(columns):
            parts = (collapse(network, *columns),)
            if network.parallel:
                parts = *parts, group_weights(network, columns[1])
            return tuple(jnp.moveaxis(part, -1, 0) for part in parts)

        g = map_blocks(block, (v, x), BLOCK_SAMPLES)
        if not network.parallel:
            return collapsed_step(network), None, g[0]
        return collapsed_step(network), group_root(network), g
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
    """All that the loop of a run carries: the outputs, and those of local models that
    have feedback of their own (`jaxnarx.models.feedback`)."""
    bounds = widen(network, network.lower), widen(network, network.upper)
    inputs, start = recursion(network, v, x), widen(network, measured)
    return free_run(*inputs, start, anchor, *bounds, depth=depth(network))
