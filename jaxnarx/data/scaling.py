"""Gains that bring every signal to unit size; never an offset."""

import numpy as np
from jaxtyping import Float

from jaxnarx.data.dataset import Dataset


def scaling_unit(*parts: Float[np.ndarray, "*axes _"]) -> Float[np.ndarray, "*axes"]:
    """The power of two below the largest magnitude along the last axis of all `parts`.

    Dividing by it is exact, and leaves numbers whose powers neither overflow nor
    vanish. One for zeros.
    """
    peak = np.max([np.abs(x).max(axis=-1, initial=0.0) for x in parts], axis=0)
    return np.where(peak > 0, np.ldexp(0.5, np.frexp(peak)[1]), 1.0)


def gains(data: Dataset) -> Float[np.ndarray, " signals"]:
    """Root mean square of each signal over its valid samples, in its physical unit.

    Dividing by it keeps polynomial terms near one without changing which terms are
    true, as centring before the products would. A signal that is zero throughout gets
    gain 1.
    """
    columns = np.concatenate([r.signals for r in data])
    valid = np.concatenate([r.valid for r in data])
    magnitude = np.where(valid, np.abs(columns), 0.0)
    peak = magnitude.max(axis=0, initial=0.0)
    safe = np.where(peak > 0, peak, 1.0)
    count = np.maximum(valid.sum(axis=0), 1)
    rms = safe * np.sqrt(np.sum((magnitude / safe) ** 2, axis=0) / count)
    return np.where(peak > 0, rms, 1.0).astype(columns.dtype)
