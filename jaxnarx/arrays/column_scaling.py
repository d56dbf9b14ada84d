"""Column scales of a least-squares problem, and powers of two that round nothing."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

NEAR_ZERO = 0.01
"""A mean below this share of the root mean square does not tell a column's size."""


def column_norm(a: Float[Array, "time terms"]) -> Float[Array, " terms"]:
    """Euclidean norm of every column, without overflow or underflow of the squares."""
    largest = jnp.max(jnp.abs(a), axis=0)
    safe = jnp.where(largest > 0, largest, 1.0)
    return largest * jnp.sqrt(jnp.sum((a / safe[None]) ** 2, axis=0))


def column_scale(
    a: Float[Array, "time terms"], root: Float[Array, " time"], scaling: str
) -> Float[Array, " terms"]:
    """The divisor of each column; one for a column of zeros.

    `a` are columns times `root`, the square roots of the weights. `"norm"`: the norm of
    the column of `a`. `"mean"`: the magnitude of the weighted mean (thesis section
    4.2.3), or, where that is below 0.01 of the weighted root mean square, the latter:
    dividing by a mean near zero would blow the column up. `"none"`: one.
    """
    if scaling == "none":
        return jnp.ones(a.shape[1], a.dtype)
    norm = column_norm(a)
    if scaling == "mean":
        total = jnp.sum(root**2)
        safe = jnp.where(total > 0, total, 1.0)
        mean = jnp.abs(jnp.sum(a * root[:, None], axis=0)) / safe
        size = norm / jnp.sqrt(safe)
        norm = jnp.where(mean > NEAR_ZERO * size, mean, size)
    elif scaling != "norm":
        raise ValueError(f'scaling must be "norm", "mean" or "none", got {scaling!r}')
    return jnp.where(norm > 0, norm, 1.0)


def power_of_two(scale: Float[Array, "*axes"]) -> Float[Array, "*axes"]:
    """The power of two nearest to each positive scale; dividing by it is exact."""
    bits = jnp.finfo(scale.dtype).nexp
    return jax.lax.reduce_precision(jax.lax.stop_gradient(scale), bits, 0)
