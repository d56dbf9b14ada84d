"""Noise and outliers: a low-pass without phase, and the identifier of Hampel."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.checks import not_negative, positive, whole
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.preparation.step import (
    AbstractLossy,
    AbstractStep,
    bridge_gaps,
    choose_channels,
    list_channels,
    map_same_rows,
    number,
    present,
    require_valid,
    units_by_name,
    valid_samples,
)
from jaxnarx.data.record import Record
from jaxnarx.errors import DataError, SpecError

MAX_MASKED_WEIGHT = 0.1
"""Largest share of a filter's absolute weight that may fall on masked samples."""

_DECAYED_SHARE = 1e-8
"""The impulse response is followed until it has decayed to this."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LowPass(AbstractStep, AbstractLossy):
    """Butterworth filter of `order`, once forwards and once backwards in time.

    There is no phase and no delay; the gain at frequency f [Hz] is, with sample time T,
    1 / (1 + (tan(pi f T) / tan(pi cutoff T))^(2 order)): one at rest, one half at
    `cutoff` [Hz]. A filtered input acts before it does: a step begins to rise early.
    Filter inputs and outputs alike, or a linear system changes (Ljung 1999, 14.3).

    Gaps: masked samples are bridged by straight lines, filtered and stay masked; a
    valid sample becomes masked when more than a tenth of the absolute weight of the
    filter around it falls on masked ones. Records are continued by their mirror image,
    so a slow movement near an end, over less than 1 / cutoff seconds, is a guess.
    """

    irreversible: ClassVar[str] = (
        "LowPass cannot be undone: what lies above the cut-off is lost"
    )
    cutoff: float | int
    order: int = 4
    channels: tuple[str, ...] | None = None

    def __post_init__(self):
        positive(self.cutoff, "cutoff", "frequency in Hz")
        whole(self.order, "order", most=20)

    def fit(self, data: Dataset) -> "LowPass":
        """This step, its channels and its cut-off checked."""
        choose_channels(data.channels, self.channels)
        self._require_below_nyquist(data.sample_time)
        return self

    def _require_below_nyquist(self, sample_time: float) -> None:
        highest = 0.5 / sample_time
        if self.cutoff >= highest:
            raise SpecError(
                f"cutoff is {self.cutoff:g} Hz, but samples of {sample_time:g} s hold "
                f"frequencies below {highest:g} Hz only. Take a lower cut-off, or "
                "leave the filter out.",
                field="cutoff",
            )

    def apply(self, data: Dataset) -> Dataset:
        """Filter every record by itself."""
        from scipy.signal import butter

        self._require_below_nyquist(data.sample_time)
        rate = 1 / data.sample_time
        sos = np.asarray(butter(self.order, self.cutoff, fs=rate, output="sos"))
        weights = _weights(sos)
        return map_same_rows(data, lambda r: self._filter(r, data, sos, weights))

    def _filter(self, record: Record, data: Dataset, sos, weights):
        from scipy.signal import sosfiltfilt

        length, period = len(record) * data.sample_time, 1 / self.cutoff
        if length < period:
            raise DataError(
                f"{record.name} lasts {length:g} s, less than one period of the "
                f"cut-off, {period:g} s. Take a higher cut-off, or leave out the "
                "record."
            )
        require_valid(record, data.channels)
        j = present(data.channels, self.channels)
        x, valid = record.signals.astype(np.float64), record.valid.copy()
        pad = min(len(weights) // 2, len(record) - 1)
        smooth = bridge_gaps(x, valid)[:, j]
        x[:, j] = sosfiltfilt(sos, smooth, axis=0, padlen=pad)
        valid[:, j] &= masked_share(valid[:, j], weights) <= MAX_MASKED_WEIGHT
        return x, valid

    def describe(self) -> str:
        """Cut-off [Hz], order and channels."""
        return (
            f"low-pass without phase, half amplitude at {self.cutoff:g} Hz "
            f"(Butterworth, order {self.order}, both ways): "
            f"{list_channels(self.channels)}"
        )


def _weights(sos: np.ndarray) -> Float[np.ndarray, " taps"]:
    """Impulse response forwards and backwards, as long as it matters; odd length."""
    from scipy.signal import correlate, sos2zpk, sosfilt

    poles = np.asarray(sos2zpk(sos)[1])
    slowest = float(np.max(np.abs(poles), initial=0.0))
    length = 2 + int(np.ceil(np.log(_DECAYED_SHARE) / np.log(max(slowest, 1e-2))))
    response = sosfilt(sos, np.arange(length) == 0)
    return correlate(response, response)


def masked_share(
    valid: Bool[np.ndarray, "time signals"], weights: Float[np.ndarray, " taps"]
) -> Float[np.ndarray, "time signals"]:
    """Share of the absolute weight around every sample that falls on masked samples.

    The record is continued by its mirror image. `weights` has odd length.
    """
    if valid.all():
        return np.zeros(valid.shape)
    masked = mirror_ends((~valid).astype(np.float64), len(weights) // 2, odd=False)
    return convolve_inside(masked, np.abs(weights)) / np.abs(weights).sum()


def mirror_ends(
    x: Float[np.ndarray, "time signals"], pad: int, *, odd: bool
) -> Float[np.ndarray, "padded signals"]:
    """`x` continued at both ends by `pad` samples, mirrored there.

    `odd` mirrors through the end point, which keeps its value and slope.
    """
    kind = "odd" if odd else "even"
    return np.pad(x, ((pad, pad), (0, 0)), "reflect", reflect_type=kind)


def convolve_inside(
    x: Float[np.ndarray, "padded signals"], weights: Float[np.ndarray, " taps"]
) -> Float[np.ndarray, "time signals"]:
    """Convolution of every column where the weights overlap `x` fully."""
    from scipy.signal import oaconvolve

    return oaconvolve(x, weights[:, None], mode="valid", axes=0)


_SORTED_NUMBERS = 4_000_000
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
        not_negative(self.floor, "floor")

    def fit(self, data: Dataset) -> "OutliersMasked":
        """The smallest deviations that count, from valid samples."""
        least = {}
        indices = choose_channels(data.channels, self.channels)
        for j in indices:
            low, high = np.percentile(valid_samples(data, j), [0.5, 99.5])
            least[data.channels.names[j]] = float(self.floor * (high - low))
        return OutliersMasked(
            half_width=self.half_width,
            sigmas=float(self.sigmas),
            least=least,
            units=units_by_name(data.channels, indices),
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutliersMasked(AbstractLossy):
    """Hampel's identifier with `least`, by channel the least deviation that counts."""

    irreversible: ClassVar[str] = (
        "Hampel cannot be undone: the masked readings are not kept"
    )
    half_width: int
    sigmas: float
    least: Mapping[str, float]
    units: Mapping[str, str]

    def __post_init__(self):
        _require(self.half_width, self.sigmas)

    def apply(self, data: Dataset) -> Dataset:
        """Mask the outliers; the last valid sample is held in their place."""
        return map_same_rows(data, lambda r: self._mask(r, data))

    def _mask(self, record: Record, data: Dataset):
        width = 2 * self.half_width + 1
        if width > len(record):
            raise DataError(
                f"{record.name} has {len(record)} rows, the window of the outlier "
                f"search {width} (half_width={self.half_width}). Take a narrower "
                "window, or leave out the record."
            )
        x, valid = record.signals.astype(np.float64), record.valid.copy()
        for j in present(data.channels, self.least):
            least = self.least[data.channels.names[j]]
            valid[:, j] &= ~outliers(
                x[:, j], valid[:, j], self.half_width, self.sigmas, least
            )
        return x, valid

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
    """The samples at which `x` is outlying, see `Hampel`; at the ends the outermost
    window is used."""
    width, n = 2 * half_width + 1, len(x)
    known = np.where(valid, x, np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(known, width)
    rows = max(1, _SORTED_NUMBERS // width)
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
    whole(half_width, "half_width")
    positive(sigmas, "sigmas")
