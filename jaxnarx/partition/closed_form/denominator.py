"""Stable feedback A(q) = 1 + a_1 q^-1 + ... + a_n q^-n, and its coordinates.

Reflection coefficients k_1 ... k_n within (-1, 1) are every stable A and no other
(Schur; Levinson's recursion), real and complex poles alike.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

NEAREST = 1e-6
"""Distance of a reflection coefficient from one that still counts as stable."""


def of_times(times: Sequence[float], sample_time: float) -> Float[np.ndarray, " _"]:
    """A(q) with real poles of these time constants [s], its leading one included."""
    poles = np.exp(-sample_time / np.asarray(times, float))
    return np.atleast_1d(np.poly(poles))


def reflections(a: Float[np.ndarray, " _"]) -> Float[np.ndarray, " order"]:
    """Reflection coefficients, by stepping the order down; NaN where |k| is one."""
    row, out = np.asarray(a, float), []
    while len(row) > 1:
        k = row[-1]
        out.append(k)
        with np.errstate(all="ignore"):
            row = ((row - k * row[::-1]) / (1 - k * k))[:-1]
    return np.array(out[::-1])


def is_stable(a: Float[np.ndarray, " _"]) -> bool:
    """Whether all poles are inside the unit circle."""
    return bool(np.all(np.abs(reflections(a)) < 1 - NEAREST))
