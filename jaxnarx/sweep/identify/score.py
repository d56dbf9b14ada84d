"""Figures of a network on one part of a member's records, inside the program."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxnarx import metrics
from jaxnarx.models import Network
from jaxnarx.simulation import (
    RunInputs,
    first_anchor,
    has_diverged,
    limited_samples,
    run,
)
from jaxnarx.sweep.identify.engine_data import Part


class Score(eqx.Module):
    """Pooled NRMSE, infinite where a record has diverged, and whether one has."""

    nrmse: Float[Array, "*rows"]
    diverged: Bool[Array, "*rows"]


def count_samples(part: Part) -> Bool[Array, "records time"]:
    """Samples by which a free run is judged: from its start to the record's end."""
    at = jnp.arange(part.anchors.shape[1])[None]
    start, end = jnp.asarray(part.start), jnp.asarray(part.end)
    return (at >= start[:, None]) & (at < end[:, None])


def score(
    network: Network, drive: RunInputs, part: Part, free: Bool[Array, ""]
) -> Score:
    """NRMSE of the free run, or of one step from measured history.

    One step counts the samples with a complete measured history alone, and as nothing
    is fed back no bound acts.
    """
    network = dataclasses.replace(
        network,
        lower=jnp.where(free, network.lower, -jnp.inf),
        upper=jnp.where(free, network.upper, jnp.inf),
    )
    ready, scored = jnp.asarray(part.anchors), jnp.asarray(part.scored)
    anchor = jnp.where(free, first_anchor(part), True)
    y = run(network, drive, anchor)
    mask = jnp.where(free, scored, scored & ready[..., None])
    flat = (drive.measured, y, mask)
    value = metrics.nrmse(*(a.reshape(-1, 1) for a in flat))[0]
    lost = jnp.any(
        has_diverged(limited_samples(network, y)[..., 0], count_samples(part))
    )
    return Score(jnp.where(lost, jnp.inf, value), lost)
