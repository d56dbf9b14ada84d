"""Polynomials with all roots inside the unit circle."""

import numpy as np
from jaxtyping import Float

LARGEST_RADIUS = 0.99
"""Radius at which a root on the circle is put."""


def radius(polynomial: Float[np.ndarray, " _"]) -> float:
    """Largest modulus of the roots in z; 0 of a constant, inf of what is not finite."""
    if not np.all(np.isfinite(polynomial)):
        return float("inf")
    roots = np.roots(np.trim_zeros(polynomial, "b"))
    return float(np.abs(roots).max(initial=0.0))


def reflect_roots(polynomial: Float[np.ndarray, " _"]) -> Float[np.ndarray, " _"]:
    """The same, with every root outside the unit circle at its mirror image inside.

    1/(q-polynomial) then is stable, with the same amplitude at all frequencies but for
    a factor. Roots within 1 % of the circle go to `LARGEST_RADIUS`.
    """
    if radius(polynomial) < LARGEST_RADIUS:
        return polynomial
    roots = np.roots(np.trim_zeros(polynomial, "b"))
    size = np.abs(roots)
    inside = np.minimum(
        np.where(size > 1, 1 / np.where(size > 0, size, 1), size), LARGEST_RADIUS
    )
    moved = np.poly(roots / np.where(size > 0, size, 1) * inside).real
    return np.concatenate([moved, np.zeros(len(polynomial) - len(moved))])
