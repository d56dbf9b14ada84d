"""Levels of a staircase: drawn from a range, or given."""

import math
from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxnarx.data.excitation.require import Number, Pair, finite, member, span
from jaxnarx.errors import SpecError

LevelDistribution = Literal["uniform", "latin", "arcsine"]
LEVEL_DISTRIBUTIONS = ("uniform", "latin", "arcsine")


def drawn_levels(
    key: PRNGKeyArray,
    used: Bool[Array, " segments"],
    amplitude: Pair,
    distribution: LevelDistribution = "uniform",
) -> Float[Array, " segments"]:
    """A level in `amplitude` for every segment; those not `used` have no meaning.

    "uniform": independent, all levels equally likely. "latin": the range is cut into as
    many equal strata as there are used segments, and each is visited once, in random
    order. "arcsine": low + (high - low) sin^2(pi u / 2) with u uniform, the amplitude
    distribution of a sine: a fifth of the levels lie in the lowest tenth of the range
    and a fifth in the highest, where a polynomial is determined worst.
    """
    low, high = span(amplitude, "amplitude")
    member(distribution, LEVEL_DISTRIBUTIONS, "level_distribution")
    if distribution == "uniform":
        return jax.random.uniform(key, used.shape, float, low, high)
    if distribution == "arcsine":
        u = jax.random.uniform(key, used.shape, float)
        return low + (high - low) * jnp.sin(math.pi / 2 * u) ** 2
    order_key, within_key = jax.random.split(key)
    u = jnp.where(used, jax.random.uniform(order_key, used.shape, float), jnp.inf)
    stratum = jnp.argsort(jnp.argsort(u)).astype(u.dtype)
    within = jax.random.uniform(within_key, used.shape, float)
    share = (stratum + within) / jnp.sum(used).astype(u.dtype)
    return low + (high - low) * jnp.minimum(share, 1.0)


def given_levels(
    key: PRNGKeyArray, count: int, levels: Sequence[Number]
) -> Float[Array, " segments"]:
    """`count` of `levels`, in rounds: each once in random order, then each again."""
    if not len(levels):
        raise SpecError("levels must hold at least one number", field="levels")
    values = jnp.asarray([finite(v, "levels") for v in levels], float)
    keys = jax.random.split(key, -(-count // len(values)))
    rounds = jax.vmap(jax.random.permutation, (0, None))(keys, values)
    return rounds.ravel()[:count]
