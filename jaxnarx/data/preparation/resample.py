"""Other rasters: samples at any positions to a grid, decimation, shifts in time."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.checks import require
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.preparation.cleaning import (
    MAX_MASKED_WEIGHT,
    convolve_inside,
    masked_share,
    mirror_ends,
)
from jaxnarx.data.preparation.step import (
    AbstractFitted,
    AbstractLossy,
    AbstractStep,
    bridge_gaps,
    choose_channels,
    map_records,
    rebuilt,
    require_valid,
)
from jaxnarx.data.record import Record
from jaxnarx.data.sampling import positive_sample_time
from jaxnarx.errors import DataError, SpecError

LEAST_SAMPLES = 10
"""Samples that a record must keep."""

HALF_FILTER_LENGTH = 10
"""Half the length of the anti-aliasing filter, in samples of the new grid."""

_HALF_AMPLITUDE = 0.8
"""Its half-amplitude frequency, as a share of the new Nyquist frequency."""

_LARGEST_GRID = 200_000_000
"""Numbers of one record on the fine grid: 1.6 GB."""


class Samples(NamedTuple):
    """Signals over a grid and where they are valid."""

    x: Float[np.ndarray, "time signals"]
    valid: Bool[np.ndarray, "time signals"]


def interpolate_on_grid(
    at: Float[np.ndarray, " time"],
    x: Float[np.ndarray, "time signals"],
    valid: Bool[np.ndarray, "time signals"],
    *,
    step: float | int,
    name: str,
    start: float | None = None,
) -> Samples:
    """`x`, known at the increasing positions `at`, at start, start + step, ...

    `start` is not before at[0], the default.

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
    first = at[0] if start is None else start
    count = int((at[-1] - first) / step * m + 1e-6) + 1
    kept = (count - 1) // m + 1
    if kept < LEAST_SAMPLES:
        raise DataError(
            f"{name}: of {len(at)} samples {kept} would be left, at least "
            f"{LEAST_SAMPLES} are needed. Take shorter steps, or leave out the record."
        )
    if count * x.shape[1] > _LARGEST_GRID:
        raise SpecError(
            f"{name}: steps of {step:g} would make {count} samples of {len(at)}. Take "
            "longer steps.",
            field="sample_time",
        )
    fine = first + np.arange(count) * (step / m)
    values, known = _interpolate(at, bridge_gaps(x, valid), valid, fine)
    if m == 1:
        return Samples(values, known)
    weights = sinc(_HALF_AMPLITUDE / m, HALF_FILTER_LENGTH * m)
    smooth = convolve_inside(
        mirror_ends(values, HALF_FILTER_LENGTH * m, odd=True), weights
    )
    return Samples(smooth[::m], masked_share(known, weights)[::m] <= MAX_MASKED_WEIGHT)


def _interpolate(at, x, valid, grid):
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Resample(AbstractStep, AbstractLossy):
    """All channels at another `sample_time` [s], from each record's first sample on.

    Longer steps come with an anti-aliasing filter, shorter ones with interpolation; see
    `interpolate_on_grid` for both and for what becomes of masked samples. Inputs that
    move in steps ring where they are filtered, by a tenth of the step at most.
    """

    irreversible: ClassVar[str] = (
        "Resample cannot be undone: use Resample with the old sample time to come "
        "near to it"
    )
    sample_time: float | int

    def __post_init__(self):
        positive_sample_time(self.sample_time)

    def fit(self, data: Dataset) -> "Resample":
        """This step."""
        return self

    def apply(self, data: Dataset) -> Dataset:
        """Every record at the new sample time; its rows are no rows of its source."""
        return resample_records(data, float(self.sample_time))

    def describe(self) -> str:
        """The new sample time [s]."""
        return f"resampled to {self.sample_time:g} s, anti-aliased where it is longer"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Decimate(AbstractStep, AbstractLossy):
    """Every `factor`-th sample after an anti-aliasing filter without phase.

    The filter and the rule for masked samples are those of `interpolate_on_grid`. A
    record with fewer than 10 samples left is a DataError.
    """

    irreversible: ClassVar[str] = (
        "Decimate cannot be undone: the samples between are lost"
    )
    factor: int

    def __post_init__(self):
        require(
            self.factor >= 2,
            "factor",
            f"factor must be a whole number from 2 on, got {self.factor}",
        )

    def fit(self, data: Dataset) -> "Decimate":
        """This step."""
        return self

    def apply(self, data: Dataset) -> Dataset:
        """Every record at `factor` times the sample time."""
        return resample_records(data, self.factor * data.sample_time)

    def describe(self) -> str:
        """The factor."""
        return f"one of {self.factor} samples kept, after an anti-aliasing filter"


def resample_records(data: Dataset, sample_time: float) -> Dataset:
    """Every record on a grid of `sample_time` [s]."""

    def one(record: Record) -> Record:
        require_valid(record, data.channels)
        t = np.arange(len(record)) * data.sample_time
        x, valid = interpolate_on_grid(
            t, record.signals, record.valid, step=sample_time, name=record.name
        )
        return rebuilt(record, x, valid, data.channels)

    return map_records(data, one, sample_time=sample_time)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Shift(AbstractStep, AbstractFitted):
    """Move channels earlier by whole samples: new(t) = old(t + samples).

    An output that shows everything `n` samples late is aligned by `{name: n}`; an input
    that acts late, by `{name: -n}`. Rows at both ends that lack a channel are cut off.
    """

    samples: Mapping[str, int]

    def fit(self, data: Dataset) -> "Shift":
        """This step, its channels checked."""
        choose_channels(data.channels, self.samples)
        return self

    def apply(self, data: Dataset) -> Dataset:
        """Shift and cut."""
        return self._shift(data, 1)

    def undo(self, data: Dataset) -> Dataset:
        """Shift back; what was cut off does not return, and as much is cut again."""
        return self._shift(data, -1)

    def _shift(self, data: Dataset, sign: int) -> Dataset:
        ahead = [sign * self.samples.get(n, 0) for n in data.channels.names]
        first, last = max(0, -min(ahead)), max(0, max(ahead))

        def one(record: Record) -> Record:
            kept = len(record) - first - last
            if kept < LEAST_SAMPLES:
                raise DataError(
                    f"{record.name}: of {len(record)} rows {max(kept, 0)} would be "
                    f"left after the shift, at least {LEAST_SAMPLES} are needed. "
                    "Leave out the record."
                )
            rows = first + np.arange(kept)[:, None] + np.array(ahead)[None]
            x, valid = (
                np.take_along_axis(a, rows, axis=0)
                for a in (record.signals, record.valid)
            )
            row = record.start_row + first
            return rebuilt(record, x, valid, data.channels, start_row=row)

        return map_records(data, one)

    def describe(self) -> str:
        """Samples by channel."""
        parts = [f"{n} by {k} sample(s)" for n, k in self.samples.items()]
        return "moved earlier: " + (", ".join(parts) or "nothing")
