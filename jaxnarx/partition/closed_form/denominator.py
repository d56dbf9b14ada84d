"""Stable feedback A(q) = 1 + a_1 q^-1 + ... + a_n q^-n."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import has_stable_roots

STABILITY_MARGIN = 1e-6
"""Distance of a reflection coefficient from one that still counts as stable."""


def denominator_from_times(
    times: Sequence[float], sample_time: float
) -> Float[np.ndarray, " _"]:
    """A(q) with real poles of these time constants [s], its leading one included."""
    poles = np.exp(-sample_time / np.asarray(times, float))
    return np.atleast_1d(np.poly(poles))


def limit_poles(a: Float[np.ndarray, " _"], largest: float) -> Float[np.ndarray, " _"]:
    """A(q) whose poles have at most this modulus: those beyond move there; `a` itself
    where there are none."""
    if not (np.isfinite(largest) and np.isfinite(a).all()):
        return a
    poles = np.roots(a)
    size = np.abs(poles)
    if not np.any(size > largest):
        return a
    held = poles * np.minimum(1.0, largest / np.where(size > 0, size, 1.0))
    return np.atleast_1d(np.real(np.poly(held)))


def is_stable(a: Float[np.ndarray, " _"]) -> bool:
    """Whether all poles are inside the unit circle."""
    return bool(has_stable_roots(a, STABILITY_MARGIN))
