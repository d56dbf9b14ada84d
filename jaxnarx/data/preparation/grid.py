"""From samples at any increasing positions to a uniform grid, without aliasing."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.data.preparation.filters import SHARE, convolved, masked_share, mirrored
from jaxnarx.data.preparation.samples import bridged
from jaxnarx.errors import DataError, SpecError

LEAST = 10
"""Samples that a record must keep."""

HALF = 10
"""Half the length of the anti-aliasing filter, in samples of the new grid."""

_EDGE = 0.8
"""Its half-amplitude frequency, as a share of the new Nyquist frequency."""

_LARGEST = 200_000_000
"""Numbers of one record on the fine grid: 1.6 GB."""


class Samples(NamedTuple):
    """Signals over a grid and where they are valid."""

    x: Float[np.ndarray, "time signals"]
    valid: Bool[np.ndarray, "time signals"]


def on_grid(
    at: Float[np.ndarray, " time"],
    x: Float[np.ndarray, "time signals"],
    valid: Bool[np.ndarray, "time signals"],
    *,
    step: float | int,
    name: str,
) -> Samples:
    """`x`, known at the increasing positions `at`, at at[0], at[0] + step, ...

    Masked samples are bridged first. A fine grid, of step / m with the least whole m
    that makes it as fine as `at`, is reached by monotone cubic interpolation (Fritsch
    and Carlson 1980), which does not overshoot and keeps steps steps. For m > 1 a
    low-pass of 20 m + 1 weights without phase follows, a Kaiser-windowed sinc with half
    amplitude at 0.8 of the new Nyquist frequency and less than 1/300 above it, and
    every m-th sample is taken.

    A new sample is valid where the fine ones are that bear nine tenths of its weight;
    a fine one, where both neighbours in `at` are. Fewer than 10 new samples are a
    DataError that names the record, `name`.
    """
    spacing = np.diff(at)
    # the shortest hundredth may be outliers, and would set the size of everything
    usual = float(np.quantile(spacing, 0.01)) if spacing.size else float(step)
    m = max(1, int(np.ceil(step / usual - 1e-6)))
    count = int((at[-1] - at[0]) / step * m + 1e-6) + 1
    kept = (count - 1) // m + 1
    if kept < LEAST:
        raise DataError(
            f"{name}: of {len(at)} samples {kept} would be left, at least {LEAST} are "
            "needed. Take shorter steps, or leave out the record."
        )
    if count * x.shape[1] > _LARGEST:
        raise SpecError(
            f"{name}: steps of {step:g} would make {count} samples of {len(at)}. Take "
            "longer steps.",
            field="sample_time",
        )
    fine = at[0] + np.arange(count) * (step / m)
    values, known = _between(at, bridged(x, valid), valid, fine)
    if m == 1:
        return Samples(values, known)
    weights = sinc(_EDGE / m, HALF * m)
    smooth = convolved(mirrored(values, HALF * m, odd=True), weights)
    return Samples(smooth[::m], masked_share(known, weights)[::m] <= SHARE)


def _between(at, x, valid, grid):
    """Values on the grid; the samples themselves where the grid is `at`."""
    close = 1e-6 * (grid[1] - grid[0])
    if len(grid) == len(at) and np.allclose(grid, at, rtol=0, atol=close):
        return x, valid
    from scipy.interpolate import PchipInterpolator

    values = PchipInterpolator(at, x, axis=0)(np.minimum(grid, at[-1]))
    left = np.clip(np.searchsorted(at, grid, side="right") - 1, 0, len(at) - 2)
    # a grid point that meets a sample needs only this one
    needs_left = at[left + 1] - grid > close
    needs_right = grid - at[left] > close
    known = (valid[left] | ~needs_left[:, None]) & (
        valid[left + 1] | ~needs_right[:, None]
    )
    return values, known


def sinc(edge: float, half: int) -> Float[np.ndarray, " taps"]:
    """Low-pass of 2 half + 1 weights with sum one; `edge` is a share of Nyquist.

    A sinc in a Kaiser window with beta 5, whose stop band is about 50 dB down.
    Oppenheim and Schafer 2010, Discrete-Time Signal Processing, section 7.6.
    """
    at = np.arange(-half, half + 1)
    weights = edge * np.sinc(edge * at) * np.kaiser(2 * half + 1, 5.0)
    return weights / weights.sum()
