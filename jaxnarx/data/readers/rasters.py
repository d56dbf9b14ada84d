"""Channels with rasters of their own, brought to one.

A grid of the wanted sample time begins where the last of the channels has begun and
ends where the first one ends. Onto it come

- labels, whole numbers of few levels and flags (`Signal.steps`): held, never between
  two of their values;
- channels that are sampled more often: through the anti-aliasing filter of
  `preparation.resample.interpolate_on_grid`;
- channels that are sampled less often: by the monotone interpolation of the same.

Samples that the file calls invalid stay invalid, and so is what lies in a gap of a
channel's raster. Where all channels have one raster, which keeps the wanted sample
time, nothing is changed.
"""

import dataclasses
import functools
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Shaped

from jaxnarx.data.preparation.resample import interpolate_on_grid
from jaxnarx.data.readers.columns import Table
from jaxnarx.data.record import RowSource
from jaxnarx.data.sampling import GAP_FACTOR
from jaxnarx.errors import DataError

MOST_LEVELS = 32
"""Most different whole numbers of a channel that counts as one of steps."""
RASTER_TOLERANCE = 0.01
"""Largest difference of rasters that are one, in shares of the sample time."""


@dataclasses.dataclass(frozen=True, eq=False)
class Signal:
    """One channel of a file: stamps [s], values, which of them are valid (`None`: all),
    and the unit.

    `labels` names the values of an enumeration.
    """

    name: str
    time: Float[np.ndarray, " time"]
    values: Shaped[np.ndarray, " time"]
    valid: Bool[np.ndarray, " time"] | None
    unit: str = ""
    labels: tuple[str, ...] = ()

    @functools.cached_property
    def step(self) -> float:
        """Median distance of its stamps [s]; infinite for one sample."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else np.inf

    @functools.cached_property
    def steps(self) -> bool:
        """Whether it moves in steps: an enumeration, or whole numbers of few levels."""
        if self.labels:
            return True
        known = self.values if self.valid is None else self.values[self.valid]
        if not len(known) or np.any(known[:1000] != np.round(known[:1000])):
            return False
        if np.any(known != np.round(known)):
            return False
        return len(np.unique(known)) <= MOST_LEVELS


def one_raster(
    signals: Sequence[Signal], place: RowSource, sample_time: float | None
) -> Table:
    """The signals as columns over one time, and notes of what was done for it.

    Without `sample_time` their rasters must be one; DataError lists them otherwise, and
    where a channel is empty, or where no time is common to all.
    """
    for signal in {id(s.time): s for s in reversed(signals)}.values():
        _require_increasing(signal, place)
    first = signals[0]
    step = first.step if sample_time is None else sample_time
    if all(_same(first.time, other.time, step) for other in signals[1:]) and (
        sample_time is None or _keeps(first.time, sample_time)
    ):
        return as_table(
            [(s.name, s.unit, s.values, s.valid) for s in signals], first.time, place
        )
    if sample_time is None:
        told = ", ".join(f"{s.name} every {s.step:.4g} s" for s in signals[:8])
        raise DataError(
            f"{place.lead}the channels have different rasters ({told}). State the "
            "sample_time that they are to be brought to.",
            channel=signals[0].name,
        )
    start = max(float(s.time[0]) for s in signals)
    stop = min(float(s.time[-1]) for s in signals)
    count = int((stop - start) / sample_time + 1e-6) + 1
    if stop <= start:
        late = max(signals, key=lambda s: s.time[0])
        early = min(signals, key=lambda s: s.time[-1])
        raise DataError(
            f"{place.lead}{early.name} ends at {stop:.6g} s, before {late.name} begins "
            f"at {start:.6g} s. Leave one of them out.",
            channel=early.name,
        )
    grid = start + sample_time * np.arange(count)
    parts = [
        (s.name, s.unit, *_resample_signal(s, grid, sample_time, place))
        for s in signals
    ]
    return as_table(parts, grid, place, _notes(signals, start, sample_time, place))


def _require_increasing(signal: Signal, place: RowSource) -> None:
    if not len(signal.time):
        raise DataError(
            f"{place.lead}{signal.name} has no sample.", channel=signal.name
        )
    back = np.flatnonzero(~(np.diff(signal.time) > 0))
    if back.size or not np.all(np.isfinite(signal.time)):
        i = int(back[0]) if back.size else int(np.argmin(np.isfinite(signal.time)))
        raise DataError(
            f"{place.lead}the time of {signal.name} does not increase after "
            f"{signal.time[i]:.9g} s (sample {i + 1}); {max(back.size, 1)} such "
            "place(s). Repair the file, or leave the channel out.",
            channel=signal.name,
            row=i,
        )


def _same(a: np.ndarray, b: np.ndarray, step: float) -> bool:
    """Whether two rasters are one."""
    if a is b:
        return True
    return len(a) == len(b) and bool(np.all(np.abs(a - b) <= RASTER_TOLERANCE * step))


def _keeps(time: np.ndarray, step: float) -> bool:
    """Whether stamps keep to a grid of the step; gaps are the reader's to judge."""
    steps = np.diff(time)
    return (
        bool(len(steps))
        and abs(float(np.median(steps)) - step) <= RASTER_TOLERANCE * step
    )


def _lies_on(time: np.ndarray, start: float, step: float) -> bool:
    """Whether stamps are those of a grid of the step through `start`."""
    at = (time - start) / step
    return _keeps(time, step) and bool(
        np.all(np.abs(at - np.round(at)) <= RASTER_TOLERANCE)
    )


def _resample_signal(
    signal: Signal, grid: np.ndarray, step: float, place: RowSource
) -> tuple[np.ndarray, np.ndarray]:
    """Values and validity on the grid."""
    t, own = signal.time, signal.step
    left = np.clip(np.searchsorted(t, grid + 1e-6 * step, side="right") - 1, 0, None)
    right = np.minimum(left + 1, len(t) - 1)
    gap = (t[right] - t[left] > GAP_FACTOR * max(own, step)) & (grid > t[left] + own)
    valid = np.ones(len(t), bool) if signal.valid is None else signal.valid
    if signal.steps or not valid.any() or len(t) < 2:
        return np.asarray(signal.values, float)[left], valid[left] & ~gap
    found = interpolate_on_grid(
        *(t, np.asarray(signal.values, float)[:, None], valid[:, None]),
        **{"step": step, "start": float(grid[0]), "name": place.lead + signal.name},
    )
    values, known = (part[: len(grid), 0] for part in found)
    return values, known & ~gap


def _notes(
    signals: Sequence[Signal], start: float, step: float, place: RowSource
) -> tuple[str, ...]:
    """Notes on which channels were changed; those that lie on the grid stay as they
    are."""
    how = {"held": [], "filtered against aliasing": [], "interpolated": []}
    for signal in signals:
        if _lies_on(signal.time, start, step):
            continue
        if signal.steps:
            how["held"].append(signal.name)
        elif signal.step < (1 - RASTER_TOLERANCE) * step:
            how["filtered against aliasing"].append(signal.name)
        else:
            how["interpolated"].append(signal.name)
    told = [f"{', '.join(names)} {what}" for what, names in how.items() if names]
    if not told:
        return ()
    return (f"{place.lead}brought to {step:g} s: {'; '.join(told)}",)


def as_table(
    parts: Iterable[tuple[str, str, np.ndarray, np.ndarray | None]],
    time: Float[np.ndarray, " time"] | None,
    place: RowSource,
    notes: tuple[str, ...] = (),
) -> Table:
    """Columns of (name, unit, values, which are valid, `None` for all); invalid ones
    are counted."""
    import pyarrow as pa

    columns, units, bad = {}, {}, []
    for name, unit, values, valid in parts:
        units[name] = unit
        if valid is None or np.all(valid):
            columns[name] = pa.array(np.asarray(values, float))
            continue
        columns[name] = pa.array(np.where(valid, values, np.nan))
        invalid = int(np.sum(~np.asarray(valid)))
        if invalid:
            bad.append(f"{invalid} of {name}")
    if bad:
        notes = (*notes, f"{place.lead}invalid samples: {', '.join(bad)}")
    return Table(columns, place, units, time=time, notes=notes)
