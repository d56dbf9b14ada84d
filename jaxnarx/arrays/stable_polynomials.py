"""Stable polynomials 1 + a_1 q^-1 + ... + a_n q^-n by their reflection coefficients.

Reflection coefficients k_1 ... k_n within (-1, 1) are every stable polynomial and no
other (Schur; Levinson's recursion), real and complex poles alike.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

Arrays = Array | np.ndarray


def reflection_coefficients(polynomial: Float[Arrays, " _"]) -> Float[Arrays, " order"]:
    """k_1 ... k_n by the step-down recursion; the leading coefficient is one.

    With k the last coefficient, a_i <- (a_i - k a_(n-i)) / (1 - k^2) is of one order
    less. Past a |k| of one or more the others mean nothing. NumPy in, NumPy out.
    """
    xp = np if isinstance(polynomial, np.ndarray) else jnp
    found = []
    while polynomial.shape[0] > 1:
        k = polynomial[-1]
        found.append(k)
        left = xp.where(xp.abs(k) < 1, 1 - k * k, 1.0)
        with np.errstate(all="ignore"):
            polynomial = ((polynomial - k * polynomial[::-1]) / left)[:-1]
    return xp.stack(found[::-1]) if found else polynomial[:0]


def has_stable_roots(
    polynomial: Float[Arrays, " _"], margin: float = 0.0
) -> Bool[Array, ""] | np.bool_:
    """Whether all roots lie inside the unit circle, and all reflection coefficients at
    least `margin` within (-1, 1)."""
    xp = np if isinstance(polynomial, np.ndarray) else jnp
    inside = xp.abs(reflection_coefficients(polynomial)) < 1 - margin
    return xp.all(inside) & xp.all(xp.isfinite(polynomial))
