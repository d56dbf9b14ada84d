"""Weighted least squares of one local model by its scaled normal equations.

A factorisation of the full columns for every trial would cost the whole growth; columns
are scaled to unit norm and carry a ridge of at least 1e-12.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import ridge_solve

LEAST_NORM_SHARE = 1e-8
"""Candidates whose orthogonal part falls below this share of their own squared norm are
passed over: normal equations hold no more digits."""


NUMBERS_AT_ONCE = 2**16
"""Numbers that several local models' weighted columns may have when they are treated at
once: short loops cost more than their work, long columns more memory."""


def batch_size(p: Float[Array, "terms rows"], most: int) -> int:
    """The number of local models, `most` of them, to treat at once."""
    return max(1, min(most, NUMBERS_AT_ONCE // p.size))


def local_fit(
    p: Float[Array, "terms rows"],
    y: Float[Array, " rows"],
    weight: Float[Array, " rows"],
    *,
    prior: Float[Array, " terms"],
    ridge: Float[Array, ""],
    picks: int | None = None,
    first: int | None = None,
) -> Float[Array, " terms"]:
    """Coefficients of minimal weighted squared error, pulled towards `prior`.

    The pull is `ridge` times each column's own squared norm. With `picks` that many
    terms are chosen by error reduction ratio, the one at `first` before all others; the
    rest are zero, and nothing pulls.
    """
    weighted = p * weight[None]
    gram, moment = weighted @ p.T, weighted @ y
    if picks is None:
        return prior + ridge_solve(gram, moment - gram @ prior, ridge)
    used = pick(gram, moment, picks, first)
    own = used.astype(p.dtype)
    return ridge_solve(gram * own[:, None] * own[None], moment * own)


def fit_models(
    p: Float[Array, "terms rows"],
    y: Float[Array, " rows"],
    phi: Float[Array, "models rows"],
    weight: Float[Array, " rows"],
    active: Bool[Array, " models"],
    ridge: Float[Array, ""],
) -> Float[Array, "models terms"]:
    """Coefficients of all local models, pulled towards those of the global one."""
    start = jnp.zeros(len(p), p.dtype)
    prior = local_fit(p, y, weight, prior=start, ridge=jnp.zeros_like(ridge))
    theta = jax.lax.map(
        lambda w: local_fit(p, y, w, prior=prior, ridge=ridge), phi * weight[None]
    )
    return jnp.where(active[:, None], theta, 0.0)


def pick(
    gram: Float[Array, "terms terms"],
    moment: Float[Array, " terms"],
    picks: int,
    first: int | None,
) -> Bool[Array, " terms"]:
    """Forward choice by error reduction ratio on the normal equations.

    Pivoted Cholesky factorisation: after every choice `b` and `d` hold the products of
    the orthogonalised columns with the output and with themselves. Chen, Billings and
    Luo 1989.
    """
    norm = jnp.diagonal(gram)
    scale = jnp.where(norm > 0, 1.0 / jnp.sqrt(jnp.where(norm > 0, norm, 1.0)), 0.0)
    gram = gram * scale[:, None] * scale[None]
    terms = gram.shape[0]

    def choose(n: Int[Array, ""], s):
        basis, d, b, used = s
        free = ~used & (d > LEAST_NORM_SHARE)
        gain = jnp.where(free, b**2 / jnp.where(free, d, 1.0), -jnp.inf)
        if first is not None:
            gain = gain.at[first].set(jnp.where(n == 0, jnp.inf, gain[first]))
        j = jnp.argmax(gain)
        there = free[j]
        root = jnp.sqrt(jnp.where(there, d[j], 1.0))
        column = jnp.where(there, (gram[j] - basis[:, j] @ basis) / root, 0.0)
        return (
            basis.at[n].set(column),
            d - column**2,
            b - column * (b[j] / root),
            used.at[j].set(used[j] | there),
        )

    start = (
        jnp.zeros((picks, terms), gram.dtype),
        jnp.diagonal(gram),
        moment * scale,
        jnp.zeros(terms, bool),
    )
    return jax.lax.fori_loop(0, picks, choose, start)[3]


def effective(
    p: Float[Array, "terms rows"],
    phi: Float[Array, "models rows"],
    weight: Float[Array, " rows"],
    used: Bool[Array, "models terms"],
    ridge: Float[Array, ""],
) -> Float[Array, ""]:
    """Effective number of parameters: the trace of the local smoothing matrices.

    Models without terms count nothing.
    """

    def one(pair):
        phi_m, used_m = pair
        w = phi_m * weight
        both = used_m[:, None] & used_m[None]
        gram = jnp.where(both, (p * w[None]) @ p.T, 0.0)
        twice = jnp.where(both, (p * (w * phi_m)[None]) @ p.T, 0.0)
        solve = jax.vmap(ridge_solve, in_axes=(None, 1, None), out_axes=1)
        return jnp.trace(solve(gram, twice, ridge))

    return jnp.sum(jax.lax.map(one, (phi, used), batch_size=batch_size(p, len(phi))))
