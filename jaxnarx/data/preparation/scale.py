"""Scaling of every channel to a common size, with its inverse."""

import dataclasses
from collections.abc import Mapping
from typing import Literal

import numpy as np
from jaxtyping import Float

from jaxnarx.data.check_samples import signals
from jaxnarx.data.dataset import Dataset, Record
from jaxnarx.data.preparation.samples import (
    chosen,
    mapped,
    measured,
    number,
    rebuilt,
    units_of,
    with_units,
)
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep
from jaxnarx.data.scaling import unit_of
from jaxnarx.errors import SpecError

Kind = Literal["min-max", "mean", "standard"]
_KINDS = ("min-max", "mean", "standard")
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
        _require_kind(self.kind)

    def fit(self, data: Dataset) -> "Scaled":
        """Offsets and gains, from valid samples only."""
        indices = chosen(data.channels, self.channels)
        found = {data.channels.names[j]: self._of(measured(data, j)) for j in indices}
        return Scaled(
            scaling=self.kind,
            offset={name: offset for name, (offset, _) in found.items()},
            gain={name: gain for name, (_, gain) in found.items()},
            units=units_of(data.channels, indices),
        )

    def _of(self, x: Float[np.ndarray, " samples"]) -> tuple[float, float]:
        low, high, unit = float(x.min()), float(x.max()), unit_of(x)
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
        _require_kind(self.scaling)
        if not all(g > 0 for g in self.gain.values()):
            raise SpecError(
                f"gains must be positive, got {dict(self.gain)}", field="gain"
            )

    def apply(self, data: Dataset) -> Dataset:
        """Scale; a scaled channel's unit is "-"."""
        offset, gain = self._numbers(data)
        units = dict.fromkeys(self.gain, "-")
        return self._changed(data, units, lambda x: (x - offset) / gain)

    def undo(self, data: Dataset) -> Dataset:
        """Back to physical units."""
        offset, gain = self._numbers(data)
        return self._changed(data, self.units, lambda z: z * gain + offset)

    def _numbers(self, data: Dataset):
        names = data.channels.names
        offset = np.array([self.offset.get(n, 0.0) for n in names])
        return offset[None], np.array([self.gain.get(n, 1.0) for n in names])[None]

    def _changed(self, data: Dataset, units: Mapping[str, str], change) -> Dataset:
        channels = with_units(data.channels, units)

        def one(record: Record) -> Record:
            x, row = change(signals(record).astype(np.float64)), record.start_row
            return rebuilt(record, x, record.valid, channels, start_row=row)

        return mapped(data, one, channels=channels)

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


def _require_kind(kind: str) -> None:
    if kind not in _KINDS:
        raise SpecError(
            f"kind must be one of {', '.join(map(repr, _KINDS))}, got {kind!r}",
            field="kind",
        )
