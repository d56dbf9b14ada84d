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


def is_stable(a: Float[np.ndarray, " _"]) -> bool:
    """Whether all poles are inside the unit circle."""
    return bool(has_stable_roots(a, STABILITY_MARGIN))
