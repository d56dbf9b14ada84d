"""Weighted linear least squares by orthogonal factorisation."""

import jax.numpy as jnp
import jax.scipy.linalg
from jaxtyping import Array, Float, Int


def least_squares(
    columns: Float[Array, "terms time"],
    y: Float[Array, " time"],
    weight: Float[Array, " time"],
) -> tuple[Float[Array, " terms"], Int[Array, ""], Float[Array, ""]]:
    """Coefficients minimising `sum_n weight_n (y_n - sum_k theta_k columns_kn)^2`.

    Columns are scaled to unit norm, factorised by Householder QR, and the triangular
    factor by SVD: directions below `N eps` of the largest singular value are left out
    (minimum norm). Returns the coefficients, the numerical rank and the condition
    number of the scaled columns (`inf` when rank-deficient). All-zero columns get a
    zero coefficient.
    """
    root = jnp.sqrt(weight)
    a = (columns * root[None]).T
    norm = jnp.sqrt(jnp.sum(a**2, axis=0))
    scale = jnp.where(norm > 0, norm, 1.0)
    r = jnp.linalg.qr(
        jnp.concatenate([a / scale[None], (y * root)[:, None]], axis=1), mode="r"
    )
    k = columns.shape[0]
    u, s, vt = jnp.linalg.svd(r[:k, :k], full_matrices=False)
    cut = columns.shape[1] * jnp.finfo(s.dtype).eps * s[0]
    inverse = jnp.where(s > cut, 1.0 / jnp.where(s > cut, s, 1.0), 0.0)
    theta = vt.T @ (inverse * (u.T @ r[:k, k]))
    rank = jnp.sum(s > cut)
    full = rank == k
    condition = jnp.where(full, s[0] / jnp.where(full, s[-1], 1.0), jnp.inf)
    return theta / scale, rank, condition


def cholesky_solve(
    gram: Float[Array, "terms terms"],
    moment: Float[Array, " terms"],
    ridge: Float[Array, ""] | float = 0.0,
) -> Float[Array, " terms"]:
    """Solve symmetric positive normal equations, scaled to a unit diagonal.

    For many small problems on the same long columns, where a factorisation of each
    would cost the whole run: the unit diagonal and a ridge of 1e-12 at least keep it
    finite; zero rows (padding) give zero.
    """
    diagonal = jnp.diagonal(gram)
    scale = jnp.where(
        diagonal > 0, jnp.sqrt(jnp.where(diagonal > 0, diagonal, 1.0)), 1.0
    )
    scaled = gram / (scale[:, None] * scale[None])
    more = jnp.where(diagonal > 0, jnp.maximum(ridge, 1e-12), 1.0)
    factor = jax.scipy.linalg.cho_factor(scaled + jnp.diag(more), lower=True)
    return jax.scipy.linalg.cho_solve(factor, moment / scale) / scale
