"""Power spectra of signals: which frequencies a record excites, and how much."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Float

from jaxnarx.data.excitation.require import Number, positive, whole
from jaxnarx.errors import DataError, SpecError

# Of records of different lengths, which one axis name would not allow.
Signals = Float[Array, "_ inputs"] | Float[np.ndarray, "_ inputs"]

_SHORTEST, _LONGEST = 64, 8192


@dataclasses.dataclass(frozen=True, eq=False)
class Spectrum:
    """One-sided power spectral density of each signal.

    `frequency` in Hz, from 0 to the Nyquist frequency in equal steps; `power` in
    squared units of the signal per Hz: its sum times the step is the variance.
    """

    frequency: Float[np.ndarray, " frequencies"]
    power: Float[np.ndarray, "frequencies inputs"]


def spectrum(
    signals: Signals | Sequence[Signals],
    sample_time: Number,
    *,
    segment: int | None = None,
) -> Spectrum:
    """Welch's estimate, pooled over records, each with its own mean taken out.

    `signals` is an array of time by signals, or a list of such records, which are
    weighted by their lengths; `sample_time` in s. Segments of `segment` samples with a
    Hann window, overlapping by half: the step in frequency is one over their duration.
    Without it, an eighth of the longest record, cut to a power of two, from 64 to 8192.
    A record shorter than a segment is one segment, padded with zeros: no segment ever
    crosses from one record into the next. Drifts slower than a segment appear at 0 Hz.

    Reference: P. D. Welch, IEEE Trans. Audio and Electroacoustics 15, 1967.
    """
    from scipy.signal import welch

    sample_time = positive(sample_time, "sample_time")
    records = _records(signals)
    longest = max(len(r) for r in records)
    size = _segment(longest) if segment is None else whole(segment, "segment")
    frequency, total = np.fft.rfftfreq(size, sample_time), 0.0
    for record in records:
        x = record - record.mean(axis=0)
        length = min(size, len(x))
        options = {"nperseg": length, "nfft": size, "detrend": False, "axis": 0}
        total = total + len(x) * welch(x, 1 / sample_time, **options)[1]
    return Spectrum(frequency, np.asarray(total) / sum(len(r) for r in records))


def bandwidth(spectrum: Spectrum, share: Number = 0.95) -> Float[np.ndarray, " inputs"]:
    """Frequency in Hz below which `share` of the power lies, per signal.

    Power is taken as constant over each step in frequency. A constant signal has 0 Hz.
    """
    if not 0 < share < 1:
        raise SpecError(f"share must be between 0 and 1, got {share}", field="share")
    if len(spectrum.frequency) < 2:
        return np.zeros(spectrum.power.shape[1])
    last = spectrum.frequency[-1]
    edges = np.minimum(spectrum.frequency + spectrum.frequency[1] / 2, last)
    edges = np.concatenate([[0.0], edges])
    below = np.cumsum(spectrum.power * np.diff(edges)[:, None], axis=0)
    below = np.concatenate([np.zeros((1, below.shape[1])), below])
    return np.array(
        [np.interp(share * b[-1], b, edges) if b[-1] > 0 else 0.0 for b in below.T]
    )


def _segment(longest: int) -> int:
    eighth = 1 << max((longest // 8).bit_length() - 1, 0)
    return min(longest, max(_SHORTEST, min(eighth, _LONGEST)))


def _records(signals: Signals | Sequence[Signals]) -> list[np.ndarray]:
    given = list(signals) if isinstance(signals, list | tuple) else [signals]
    records = [np.asarray(r, float) for r in given]
    if not records:
        raise SpecError("spectrum needs at least one record", field="signals")
    for i, record in enumerate(records):
        if record.ndim != 2 or not record.size:
            raise SpecError(
                f"record {i} must be an array of time by signals, neither empty, got "
                f"shape {record.shape}; make one signal a column with x[:, None]",
                field="signals",
            )
        if not np.all(np.isfinite(record)):
            row = int(np.argmin(np.all(np.isfinite(record), axis=1)))
            raise DataError(
                f"record {i} is not finite in row {row}; hold or cut such samples",
                row=row,
            )
    return records
