"""Zero-phase low-pass filtering."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.data.check_samples import signals
from jaxnarx.data.dataset import Dataset, Record
from jaxnarx.data.preparation.samples import (
    bridged,
    chosen,
    mapped,
    present,
    rebuilt,
    require_valid,
)
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep, cannot_undo
from jaxnarx.errors import DataError, SpecError

SHARE = 0.1
"""Largest share of a filter's absolute weight that may fall on masked samples."""

_SMALL = 1e-8
"""The impulse response is followed until it has decayed to this."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LowPass(AbstractStep, AbstractFitted):
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

    cutoff: float | int
    order: int = 4
    channels: tuple[str, ...] | None = None

    def __post_init__(self):
        if not 0 < self.cutoff < np.inf:
            raise SpecError(
                f"cutoff must be a positive frequency in Hz, got {self.cutoff}",
                field="cutoff",
            )
        if not 1 <= self.order <= 20:
            raise SpecError(
                f"order must lie between 1 and 20, got {self.order}", field="order"
            )

    def fit(self, data: Dataset) -> "LowPass":
        """This step, its channels and its cut-off checked."""
        chosen(data.channels, self.channels)
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
        return mapped(data, lambda r: self._filtered(r, data, sos, weights))

    def _filtered(self, record: Record, data: Dataset, sos, weights) -> Record:
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
        x, valid = signals(record).astype(np.float64), record.valid.copy()
        pad = min(len(weights) // 2, len(record) - 1)
        smooth = bridged(x, valid)[:, j]
        x[:, j] = sosfiltfilt(sos, smooth, axis=0, padlen=pad)
        valid[:, j] &= masked_share(valid[:, j], weights) <= SHARE
        row = record.start_row
        return rebuilt(record, x, valid, data.channels, start_row=row)

    def undo(self, data: Dataset) -> Dataset:
        """Refused: high frequencies are gone."""
        raise cannot_undo("LowPass", "what lies above the cut-off is lost")

    def describe(self) -> str:
        """Cut-off [Hz], order and channels."""
        of = "all channels" if self.channels is None else ", ".join(self.channels)
        return (
            f"low-pass without phase, half amplitude at {self.cutoff:g} Hz "
            f"(Butterworth, order {self.order}, both ways): {of}"
        )


def _weights(sos: np.ndarray) -> Float[np.ndarray, " taps"]:
    """Impulse response forwards and backwards, as long as it matters; odd length."""
    from scipy.signal import correlate, sos2zpk, sosfilt

    poles = np.asarray(sos2zpk(sos)[1])
    slowest = float(np.max(np.abs(poles), initial=0.0))
    length = 2 + int(np.ceil(np.log(_SMALL) / np.log(max(slowest, 1e-2))))
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
    masked = mirrored((~valid).astype(np.float64), len(weights) // 2, odd=False)
    return convolved(masked, np.abs(weights)) / np.abs(weights).sum()


def mirrored(
    x: Float[np.ndarray, "time signals"], pad: int, *, odd: bool
) -> Float[np.ndarray, "padded signals"]:
    """`x` continued at both ends by `pad` samples, mirrored there.

    `odd` mirrors through the end point, which keeps its value and slope.
    """
    kind = "odd" if odd else "even"
    return np.pad(x, ((pad, pad), (0, 0)), "reflect", reflect_type=kind)


def convolved(
    x: Float[np.ndarray, "padded signals"], weights: Float[np.ndarray, " taps"]
) -> Float[np.ndarray, "time signals"]:
    """Convolution of every column where the weights overlap `x` fully."""
    from scipy.signal import oaconvolve

    return oaconvolve(x, weights[:, None], mode="valid", axes=0)
