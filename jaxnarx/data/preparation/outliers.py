"""Outliers masked by Hampel's identifier: nothing is deleted, nothing invented."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.data.check_samples import signals
from jaxnarx.data.dataset import Dataset, Record
from jaxnarx.data.preparation.samples import (
    chosen,
    mapped,
    measured,
    number,
    present,
    rebuilt,
    units_of,
)
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep, cannot_undo
from jaxnarx.errors import DataError, SpecError

_BLOCK = 4_000_000
"""Numbers of all windows that are sorted at a time: 32 MB."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Hampel(AbstractStep):
    """Mask samples far from the median of the 2 half_width + 1 samples around them.

    A sample is an outlier when it differs from the median of its window by more than
    `sigmas` times 1.4826 MAD, the median absolute deviation scaled to the standard
    deviation of normal noise, and by more than `floor` times the channel's range, from
    its 0.5 to its 99.5 percentile in the training data. Where more than half of a
    window is equal, the MAD is zero and 1.2533 times the mean absolute deviation
    stands in, so that a lone spike on a constant is found while a sensor that flickers
    by its last digit is left alone. Masked samples are in no window; a window with at
    most `half_width` valid samples judges nothing.

    Real pulses shorter than half a window look like outliers: choose `channels`, or a
    window shorter than the shortest pulse of an input.

    Hampel 1974; Pearson 2002, "Outliers in process modeling and identification"; for
    the zero MAD Iglewicz and Hoaglin 1993, "How to detect and handle outliers".
    """

    half_width: int = 7
    sigmas: float | int = 5.0
    floor: float | int = 0.05
    channels: tuple[str, ...] | None = None

    def __post_init__(self):
        _require(self.half_width, self.sigmas)
        if not 0 <= self.floor < np.inf:
            raise SpecError(
                f"floor must be a share of the range, 0 or more, got {self.floor}",
                field="floor",
            )

    def fit(self, data: Dataset) -> "OutliersMasked":
        """The smallest deviations that count, from valid samples."""
        least = {}
        indices = chosen(data.channels, self.channels)
        for j in indices:
            low, high = np.percentile(measured(data, j), [0.5, 99.5])
            least[data.channels.names[j]] = float(self.floor * (high - low))
        return OutliersMasked(
            half_width=self.half_width,
            sigmas=float(self.sigmas),
            least=least,
            units=units_of(data.channels, indices),
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutliersMasked(AbstractFitted):
    """Hampel's identifier with `least`, by channel the least deviation that counts."""

    half_width: int
    sigmas: float
    least: Mapping[str, float]
    units: Mapping[str, str]

    def __post_init__(self):
        _require(self.half_width, self.sigmas)

    def apply(self, data: Dataset) -> Dataset:
        """Mask the outliers; the last valid sample is held in their place."""
        return mapped(data, lambda r: self._masked(r, data))

    def _masked(self, record: Record, data: Dataset) -> Record:
        width = 2 * self.half_width + 1
        if width > len(record):
            raise DataError(
                f"{record.name} has {len(record)} rows, the window of the outlier "
                f"search {width} (half_width={self.half_width}). Take a narrower "
                "window, or leave out the record."
            )
        x, valid = signals(record).astype(np.float64), record.valid.copy()
        for j in present(data.channels, self.least):
            least = self.least[data.channels.names[j]]
            valid[:, j] &= ~outliers(
                x[:, j], valid[:, j], self.half_width, self.sigmas, least
            )
        row = record.start_row
        return rebuilt(record, x, valid, data.channels, start_row=row)

    def undo(self, data: Dataset) -> Dataset:
        """Refused: the masked readings are gone."""
        raise cannot_undo("Hampel", "the masked readings are not kept")

    def describe(self) -> str:
        """Window, threshold and the least deviation of every channel."""
        least = [f"{n} {number(v, self.units[n])}" for n, v in self.least.items()]
        return (
            f"outliers masked: further than {self.sigmas:g} sigma from the median of "
            f"{2 * self.half_width + 1} samples, and at least {', '.join(least)}"
        )


def outliers(
    x: Float[np.ndarray, " time"],
    valid: Bool[np.ndarray, " time"],
    half_width: int,
    sigmas: float,
    least: float,
) -> Bool[np.ndarray, " time"]:
    """Where `x` is outlying, see `Hampel`; at the ends the outermost window is used."""
    width, n = 2 * half_width + 1, len(x)
    known = np.where(valid, x, np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(known, width)
    rows = max(1, _BLOCK // width)
    parts = [_centre(windows[i : i + rows]) for i in range(0, len(windows), rows)]
    middle, scale = (np.concatenate(p) for p in zip(*parts, strict=True))
    own = np.clip(np.arange(n) - half_width, 0, n - width)
    off = np.abs(x - middle[own])
    # where a window has too few samples its median is NaN and no comparison holds
    return valid & (off > sigmas * scale[own]) & (off > least)


def _centre(windows):
    """Median and scale of every window; NaN where most of it is masked."""
    middle = _median(windows)
    off = np.abs(windows - middle[:, None])
    scale = 1.4826 * _median(off)
    count = np.maximum(np.isfinite(windows).sum(axis=1), 1)
    spread = 1.2533 * np.where(np.isfinite(off), off, 0.0).sum(axis=1) / count
    return middle, np.where(scale > 0, scale, spread)


def _median(windows):
    """Median of the numbers in every window, NaN where no more than half are."""
    # sorted NaN come last
    ordered = np.sort(windows, axis=1)
    count = np.isfinite(windows).sum(axis=1)
    places = np.stack([(np.maximum(count, 1) - 1) // 2, count // 2], axis=1)
    middle = np.take_along_axis(ordered, places, axis=1).mean(axis=1)
    return np.where(count > windows.shape[1] // 2, middle, np.nan)


def _require(half_width: int, sigmas: float | int) -> None:
    if half_width < 1:
        raise SpecError(
            f"half_width must be at least 1 sample, got {half_width}",
            field="half_width",
        )
    if not 0 < sigmas < np.inf:
        raise SpecError(f"sigmas must be positive, got {sigmas}", field="sigmas")
