"""How good an excitation is: spectra, cells visited, both for all records."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.checks import Number, Pair, positive, require_known, span, whole
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.excitation.placement import Box, box, discrepancy
from jaxnarx.formatting import page

# Of records of different lengths, which one axis name would not allow.
Signals = Float[Array, "_ inputs"] | Float[np.ndarray, "_ inputs"]

_SHORTEST_WINDOW, _LONGEST_WINDOW = 64, 8192


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
    return min(longest, max(_SHORTEST_WINDOW, min(eighth, _LONGEST_WINDOW)))


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


Points = Float[Array, "samples inputs"] | Float[np.ndarray, "samples inputs"]


@dataclasses.dataclass(frozen=True, eq=False)
class Coverage:
    """Shares of the operating space that points visit; all from 0 to 1.

    `range_used` is the span of the points in each input's range; `pairs[i, j]` the
    share of the `bins` by `bins` cells of inputs i and j with a point in them (the
    diagonal: of the `bins` cells of one input); `whole` the share of the cells of the
    whole space, cut into `whole_bins` for each input, as many as there can be, up to
    `bins`, without more cells than points; `outside` the share of the points that lie
    outside the space, which visit no cell. `discrepancy` is the centred L2 discrepancy,
    0 for perfectly even points.
    """

    names: tuple[str, ...]
    samples: int
    range_used: Float[np.ndarray, " inputs"]
    pairs: Float[np.ndarray, "inputs inputs"]
    bins: int
    whole: float
    whole_bins: int
    outside: float
    discrepancy: float

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and names, ready for JSON."""
        values = dataclasses.asdict(self)
        return {
            k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()
        } | {"names": list(self.names)}

    def __str__(self) -> str:
        width = max(len(n) for n in self.names)
        lines = [
            f"{name:<{width}}  {used:6.1%} of the range, {self.pairs[i, i]:6.1%} of "
            f"{self.bins} parts of it"
            for i, (name, used) in enumerate(
                zip(self.names, self.range_used, strict=True)
            )
        ]
        lines += [
            f"{a} x {b}: {self.pairs[i, j]:.1%} of {self.bins**2} cells"
            for i, a in enumerate(self.names)
            for j, b in enumerate(self.names[:i])
        ]
        cells = self.whole_bins ** len(self.names)
        lines.append(
            f"whole space: {self.whole:.1%} of {cells} cells, discrepancy "
            f"{self.discrepancy:.3g}, {self.outside:.1%} of {self.samples} samples "
            "outside"
        )
        return "\n".join(lines)

    _repr_html_ = page


def coverage(
    points: Points,
    low: Box,
    high: Box,
    *,
    bins: int = 10,
    names: Sequence[str] | None = None,
) -> Coverage:
    """The coverage of the box from `low` to `high` by `points`, in the units of the
    inputs.

    Cells are equal parts of the box, closed below, the last one above too. Coverage
    grows with the number of points whatever the signal: compare records of about the
    same length.
    """
    low, high = box(low, high)
    bins = whole(bins, "bins")
    x = _points(points, low)
    names = [f"input {i + 1}" for i in range(len(low))] if names is None else names
    inside = np.all((x >= low) & (x <= high), axis=1)
    kept = x[inside]
    cell = cells(kept, low, high, bins)
    coarse = _whole_bins(len(x), len(low), bins)
    clipped = np.clip(x, low, high)
    return Coverage(
        names=tuple(names),
        samples=len(x),
        range_used=(clipped.max(axis=0) - clipped.min(axis=0)) / (high - low),
        pairs=_pairs(cell, bins),
        bins=bins,
        whole=_share(cells(kept, low, high, coarse), coarse),
        whole_bins=coarse,
        outside=float(1 - inside.mean()),
        discrepancy=discrepancy(x, low, high),
    )


def cells(
    points: Float[np.ndarray, "samples inputs"],
    low: Float[np.ndarray, " inputs"],
    high: Float[np.ndarray, " inputs"],
    bins: int,
) -> Int[np.ndarray, "samples inputs"]:
    """Cell along each input, 0 to `bins` - 1; points outside go to the nearest."""
    part = np.floor(bins * (points - low) / (high - low)).astype(int)
    return np.clip(part, 0, bins - 1)


def _pairs(
    cell: Int[np.ndarray, "samples inputs"], bins: int
) -> Float[np.ndarray, "inputs inputs"]:
    n = cell.shape[1]
    share = np.zeros((n, n))
    for i in range(n):
        share[i, i] = _share(cell[:, i : i + 1], bins)
        for j in range(i):
            share[i, j] = share[j, i] = _share(cell[:, [i, j]], bins)
    return share


def _share(cell: Int[np.ndarray, "samples inputs"], bins: int) -> float:
    """Share of the cells that appear."""
    count = bins ** cell.shape[1]
    visited = np.zeros(count, bool)
    visited[cell @ bins ** np.arange(cell.shape[1])] = True
    return float(visited.mean())


def _whole_bins(samples: int, inputs: int, most: int) -> int:
    return max(b for b in range(1, most + 1) if b == 1 or b**inputs <= samples)


def _points(points: Points, low: np.ndarray) -> np.ndarray:
    x = np.asarray(points, float)
    if x.ndim != 2 or x.shape[1] != len(low):
        raise SpecError(
            f"points must be an array of samples by {len(low)} inputs, got shape "
            f"{x.shape}",
            field="points",
        )
    if not len(x) or not np.all(np.isfinite(x)):
        raise DataError(
            "coverage needs one or more points, all finite; leave out missing samples"
        )
    return x


@dataclasses.dataclass(frozen=True, eq=False)
class Assessment:
    """Operating space, its coverage, and the spectra of the inputs.

    `low` and `high` in the units of the inputs; `bandwidth` in Hz, the frequency below
    which `share` of an input's power lies.
    """

    labels: tuple[str, ...]
    low: Float[np.ndarray, " inputs"]
    high: Float[np.ndarray, " inputs"]
    coverage: Coverage
    spectrum: Spectrum
    bandwidth: Float[np.ndarray, " inputs"]
    share: float

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and names, ready for JSON; without the spectra."""
        return {
            "labels": list(self.labels),
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "coverage": self.coverage.to_dict(),
            "bandwidth": self.bandwidth.tolist(),
            "share": self.share,
        }

    def __str__(self) -> str:
        width = max(len(label) for label in self.labels)
        lines = [
            f"{label:<{width}}  {low:g} to {high:g}, {self.share:.0%} of the power "
            f"below {hertz:.3g} Hz"
            for label, low, high, hertz in zip(
                self.labels, self.low, self.high, self.bandwidth, strict=True
            )
        ]
        return "\n".join([*lines, str(self.coverage)])

    _repr_html_ = page


def assess(
    data: Dataset,
    *,
    ranges: Mapping[str, Pair] | None = None,
    bins: int = 10,
    share: Number = 0.95,
) -> Assessment:
    """Coverage and spectra of the inputs of `data`, all records together.

    `ranges` gives the operating space by input name as (low, high) in its unit; an
    input it does not name has the range of its valid samples (a constant one half a
    unit to both sides). Only samples at which all inputs are valid count as visited;
    spectra take the held values of the others.
    """
    names = data.channels.input_names
    if not names:
        raise DataError("the data set has no inputs, so there is no excitation")
    points = visited_rows(data)
    if not len(points):
        raise DataError("the data set has no sample at which all inputs are valid")
    low, high = operating_space(points, names, ranges or {})
    power = spectrum([r.u for r in data], data.sample_time)
    return Assessment(
        labels=tuple(c.label for c in data.channels.inputs),
        low=low,
        high=high,
        coverage=coverage(points, low, high, bins=bins, names=names),
        spectrum=power,
        bandwidth=bandwidth(power, share),
        share=float(share),
    )


def visited_rows(data: Dataset) -> Float[np.ndarray, "samples inputs"]:
    """Rows of the inputs of all records, where all of them are valid."""
    inputs = len(data.channels.inputs)
    rows = [r.u[np.all(r.valid[:, :inputs], axis=1)] for r in data]
    return np.concatenate(rows).astype(float)


def operating_space(
    points: Float[np.ndarray, "samples inputs"],
    names: list[str],
    ranges: Mapping[str, Pair],
) -> tuple[Float[np.ndarray, " inputs"], Float[np.ndarray, " inputs"]]:
    """The given ranges, where there are none those of the points."""
    for name in ranges:
        require_known(
            name, names, "ranges", f"ranges names {name!r}, which is no input"
        )
    low, high = points.min(axis=0), points.max(axis=0)
    for i, name in enumerate(names):
        if name in ranges:
            low[i], high[i] = span(ranges[name], "ranges")
    same = low == high
    return np.where(same, low - 0.5, low), np.where(same, high + 0.5, high)
