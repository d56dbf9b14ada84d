"""Figures of a network on one part of a member's records, inside the program."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.evaluation import metrics
from jaxnarx.models import Network
from jaxnarx.simulation import IN_A_ROW, SHARE, Drive, run
from jaxnarx.sweep.identify.member import Part


class Score(eqx.Module):
    """Pooled NRMSE, infinite where a record has diverged, and whether one has."""

    nrmse: Float[Array, "*rows"]
    diverged: Bool[Array, "*rows"]


def free_anchors(part: Part) -> Bool[Array, "records time"]:
    """Anchors of a free run, as `jaxnarx.simulation.first_anchor` gives them."""
    at = jnp.arange(part.anchors.shape[1])[None]
    start, end = jnp.asarray(part.start), jnp.asarray(part.end)
    return (at == start[:, None]) | (at >= end[:, None])


def has_diverged(
    limited: Bool[Array, "records time"],
    start: Int[Array, " records"],
    end: Int[Array, " records"],
) -> Bool[Array, ""]:
    """Whether any record counts as diverged between its start and its end.

    More than 5 % of its samples, or 50 in a row, at the feedback bound.
    """
    at = jnp.arange(limited.shape[1])[None]
    limited = limited & (at >= start[:, None]) & (at < end[:, None])
    count = jnp.sum(limited, axis=1)
    length = jnp.maximum(end - start, 0)
    share = count.astype(float) > SHARE * length.astype(float)
    last_free = jax.lax.cummax(jnp.where(limited, -1, at), axis=1)
    in_a_row = jnp.max(jnp.where(limited, at - last_free, 0), axis=1)
    return jnp.any((share & (count > 0)) | (in_a_row >= IN_A_ROW))


def held(network: Network, y: Float[Array, "records time 1"], part: Part):
    """Whether the feedback bound holds a run longer than it may."""
    lower, upper = network.lower[None, None], network.upper[None, None]
    limited = (y <= lower) | (y >= upper)
    return has_diverged(limited[..., 0], jnp.asarray(part.start), jnp.asarray(part.end))


def score(network: Network, drive: Drive, part: Part, free: Bool[Array, ""]) -> Score:
    """NRMSE of the free run, or of one step from measured history.

    One step counts the samples with a complete measured history alone, and as nothing
    is fed back no bound acts.
    """
    network = dataclasses.replace(
        network,
        lower=jnp.where(free, network.lower, -jnp.inf),
        upper=jnp.where(free, network.upper, jnp.inf),
    )
    ready, counted = jnp.asarray(part.anchors), jnp.asarray(part.scored)
    anchor = jnp.where(free, free_anchors(part), True)
    y = run(network, drive, anchor)
    mask = jnp.where(free, counted, counted & ready[..., None])
    flat = (drive.measured, y, mask)
    value = metrics.nrmse(*(a.reshape(-1, 1) for a in flat))[0]
    lost = held(network, y, part)
    return Score(jnp.where(lost, jnp.inf, value), lost)
