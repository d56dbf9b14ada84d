"""Offsets, scales and drifts: what is subtracted from channels and divides them."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float

from jaxnarx.checks import choice, finite, positive, require
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.preparation.step import (
    AbstractFitted,
    AbstractLossy,
    AbstractStep,
    choose_channels,
    list_channels,
    map_same_rows,
    number,
    present,
    units_by_name,
    valid_samples,
    with_units,
)
from jaxnarx.data.record import Record
from jaxnarx.data.scaling import scaling_unit
from jaxnarx.errors import DataError, SpecError


@dataclasses.dataclass(frozen=True, kw_only=True)
class RemoveOffset(AbstractStep):
    """Subtract from every channel one level, the same in all records.

    `kind` is "mean", over all valid training samples; "first", the first valid sample
    of the training data; or "given", the numbers in `values`, by channel in its unit.
    `channels` are names, None for all; with `values` they are those that it names.

    Products of signals change their meaning with an offset: a polynomial model of
    deviations is another model than one of the signals themselves.
    """

    kind: Literal["mean", "first", "given"] = "mean"
    values: Mapping[str, float | int] = dataclasses.field(default_factory=dict)
    channels: tuple[str, ...] | None = None

    def __post_init__(self):
        choice(self.kind, ("mean", "first", "given"), "kind")
        require(
            (self.kind == "given") == bool(self.values),
            "values",
            f"kind={self.kind!r} with values for {len(self.values)} channel(s): "
            "values belong to kind='given', and only to it",
        )
        for value in self.values.values():
            finite(value, "values")

    def fit(self, data: Dataset) -> "OffsetRemoved":
        """The levels, from valid samples only."""
        names = tuple(self.values) if self.kind == "given" else self.channels
        indices = choose_channels(data.channels, names)
        offset = {data.channels.names[j]: self._level(data, j) for j in indices}
        return OffsetRemoved(offset=offset, units=units_by_name(data.channels, indices))

    def _level(self, data: Dataset, j: int) -> float:
        if self.kind == "given":
            return float(self.values[data.channels.names[j]])
        x = valid_samples(data, j)
        return float(x[0] if self.kind == "first" else x.mean())


@dataclasses.dataclass(frozen=True, kw_only=True)
class OffsetRemoved(AbstractFitted):
    """x - offset, channel by channel; offsets and `units` by name."""

    offset: Mapping[str, float]
    units: Mapping[str, str]

    def apply(self, data: Dataset) -> Dataset:
        """Subtract the offsets."""
        return self._shift(data, -1.0)

    def undo(self, data: Dataset) -> Dataset:
        """Add the offsets."""
        return self._shift(data, 1.0)

    def _shift(self, data: Dataset, sign: float) -> Dataset:
        names = data.channels.names
        shift = sign * np.array([self.offset.get(n, 0.0) for n in names])
        return map_same_rows(data, lambda r: (r.signals + shift[None], r.valid))

    def describe(self) -> str:
        """The offsets with units."""
        parts = [f"{n} {number(v, self.units[n])}" for n, v in self.offset.items()]
        return "offset removed: " + ", ".join(parts)


Kind = Literal["min-max", "mean", "standard"]
_SCALING_KINDS = ("min-max", "mean", "standard")
_NEAR_ZERO = 0.01
"""A mean below this share of the root mean square is no measure of size."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scale(AbstractStep):
    """z = (x - offset) / gain for every channel; z is dimensionless, its unit "-".

    kind       offset   gain
    min-max    minimum  maximum - minimum, so that z is in [0, 1]: thesis (6.7)
    mean       0        magnitude of the mean, so that z is about 1: thesis 4.2.3
    standard   mean     standard deviation

    All over valid training samples. Where the mean is below 1 % of the root mean
    square, that takes its place. A constant channel is only moved ("min-max",
    "standard": gain 1), and so is one that is zero throughout ("mean").

    The networks of this package scale on their own; this is for what leaves it, and to
    repeat what the thesis did.
    """

    kind: Kind = "min-max"
    channels: tuple[str, ...] | None = None

    def __post_init__(self):
        choice(self.kind, _SCALING_KINDS, "kind")

    def fit(self, data: Dataset) -> "Scaled":
        """Offsets and gains, from valid samples only."""
        indices = choose_channels(data.channels, self.channels)
        found = {
            data.channels.names[j]: self._offset_and_gain(valid_samples(data, j))
            for j in indices
        }
        return Scaled(
            scaling=self.kind,
            offset={name: offset for name, (offset, _) in found.items()},
            gain={name: gain for name, (_, gain) in found.items()},
            units=units_by_name(data.channels, indices),
        )

    def _offset_and_gain(self, x: Float[np.ndarray, " samples"]) -> tuple[float, float]:
        low, high, unit = float(x.min()), float(x.max()), scaling_unit(x)
        mean = float((x / unit).mean() * unit)
        if self.kind == "mean":
            size = float(unit * np.sqrt(np.mean((x / unit) ** 2)))
            gain = size if abs(mean) < _NEAR_ZERO * size else abs(mean)
            return 0.0, gain or 1.0
        if low == high:
            # the mean of equal numbers is rounded, and would leave a remainder
            return low, 1.0
        return (
            (low, high - low)
            if self.kind == "min-max"
            else (mean, float((x / unit).std() * unit))
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scaled(AbstractFitted):
    """(x - offset) / gain by channel name, in the `units` before scaling."""

    scaling: Kind
    offset: Mapping[str, float]
    gain: Mapping[str, float]
    units: Mapping[str, str]

    def __post_init__(self):
        choice(self.scaling, _SCALING_KINDS, "kind")
        for gain in self.gain.values():
            positive(gain, "gain")

    def apply(self, data: Dataset) -> Dataset:
        """Scale; a scaled channel's unit is "-"."""
        offset, gain = self._numbers(data)
        units = dict.fromkeys(self.gain, "-")
        return self._rescale(data, units, lambda x: (x - offset) / gain)

    def undo(self, data: Dataset) -> Dataset:
        """Back to physical units."""
        offset, gain = self._numbers(data)
        return self._rescale(data, self.units, lambda z: z * gain + offset)

    def _numbers(self, data: Dataset):
        names = data.channels.names
        offset = np.array([self.offset.get(n, 0.0) for n in names])
        return offset[None], np.array([self.gain.get(n, 1.0) for n in names])[None]

    def _rescale(self, data: Dataset, units: Mapping[str, str], change) -> Dataset:
        return map_same_rows(
            data,
            lambda r: (change(r.signals.astype(np.float64)), r.valid),
            channels=with_units(data.channels, units),
        )

    def describe(self) -> str:
        """Offset and gain of every channel with its unit."""
        parts = []
        for name, gain in self.gain.items():
            unit = self.units[name]
            offset = self.offset[name]
            sign = "-" if offset >= 0 else "+"
            moved = f"{name} {sign} {number(abs(offset), unit)}"
            if self.scaling == "mean":
                moved = name
            scaled = f"({moved}) / {number(gain, unit)}"
            parts.append(f"{moved} (only moved)" if gain == 1.0 else scaled)
        return f"{self.scaling} scaling: " + ", ".join(parts)


Lines = Mapping[str, Mapping[str, tuple[float, float]]]
"""Record name, then channel name: value at the record's first sample, slope per s."""

_LEAST_SAMPLES = 3
"""Valid samples that a line needs, so that it does not fit them by necessity."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Detrend(AbstractStep, AbstractLossy):
    """Subtract from every record its own line of least squares over valid samples.

    With `keep_level` the mean over the valid samples stays and only the drift goes:
    levels tell operating points apart. Without it the whole line is subtracted.
    Nothing is learned from training data; the lines of given data are `lines(data)`,
    and with them `restore` undoes the step for these records, and for no others.

    Ljung 1999, System Identification, section 14.1; thesis 2.1.2, item 1.
    """

    irreversible: ClassVar[str] = (
        "Detrend cannot be undone: every record has a line of its own. Keep "
        "Detrend.lines(data) before applying it, and add them with "
        "Detrend.restore(data, lines)."
    )
    keep_level: bool = True
    channels: tuple[str, ...] | None = None

    def fit(self, data: Dataset) -> "Detrend":
        """This step, its channels checked."""
        choose_channels(data.channels, self.channels)
        return self

    def lines(self, data: Dataset) -> Lines:
        """The lines that `apply` subtracts from `data`, in its channels' units."""
        names = data.channels.names
        indices = present(data.channels, self.channels)
        return {
            record.name: {names[j]: self._line(data, record, j) for j in indices}
            for record in data
        }

    def _line(self, data: Dataset, record: Record, j: int) -> tuple[float, float]:
        known = record.valid[:, j]
        if known.sum() < _LEAST_SAMPLES:
            name = data.channels.names[j]
            raise DataError(
                f"{record.name}: {name} has {known.sum()} valid sample(s), a trend "
                f"needs {_LEAST_SAMPLES}. Leave out the channel or the record.",
                channel=name,
            )
        t = (np.arange(len(record)) * data.sample_time)[known]
        x = record.signals[known, j].astype(np.float64)
        middle, level = t.mean(), x.mean()
        slope = float((t - middle) @ (x - level) / ((t - middle) @ (t - middle)))
        start = -slope * middle + (0.0 if self.keep_level else level)
        return float(start), slope

    def apply(self, data: Dataset) -> Dataset:
        """Subtract each record's lines."""
        return _add(data, self.lines(data), -1.0)

    def restore(self, data: Dataset, lines: Lines) -> Dataset:
        """Add the lines that `lines` took down before `apply`, by record name."""
        for record in data:
            if record.name not in lines:
                raise SpecError(
                    f"lines has no record {record.name!r}; give the lines of the data "
                    "as they were before detrending",
                    field="lines",
                )
        return _add(data, lines, 1.0)

    def describe(self) -> str:
        """Offsets that are subtracted, by channel."""
        what = "drift (level kept)" if self.keep_level else "line"
        return f"linear {what} of each record removed: {list_channels(self.channels)}"


def _add(data: Dataset, lines: Lines, sign: float) -> Dataset:
    names = data.channels.names

    def one(record: Record):
        own = lines[record.name]
        line: Float[np.ndarray, "signals 2"]
        line = np.array([own.get(n, (0.0, 0.0)) for n in names])
        t = np.arange(len(record)) * data.sample_time
        x = record.signals + sign * (line[None, :, 0] + t[:, None] * line[None, :, 1])
        return x, record.valid

    return map_same_rows(data, one)
