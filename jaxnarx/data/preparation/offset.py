"""Offset removal: signals as deviations from a level (thesis 2.1.2, item 1)."""

import dataclasses
from collections.abc import Mapping
from typing import Literal

import numpy as np

from jaxnarx.data.check_samples import signals
from jaxnarx.data.dataset import Dataset, Record
from jaxnarx.data.preparation.samples import (
    chosen,
    mapped,
    measured,
    number,
    rebuilt,
    units_of,
)
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep
from jaxnarx.errors import SpecError


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
        if self.kind not in ("mean", "first", "given"):
            raise SpecError(
                f"kind must be 'mean', 'first' or 'given', got {self.kind!r}",
                field="kind",
            )
        if (self.kind == "given") != bool(self.values):
            raise SpecError(
                f"kind={self.kind!r} with values for {len(self.values)} channel(s): "
                "values belong to kind='given', and only to it",
                field="values",
            )
        if not all(np.isfinite(v) for v in self.values.values()):
            raise SpecError(
                f"values must be finite numbers, got {dict(self.values)}",
                field="values",
            )

    def fit(self, data: Dataset) -> "OffsetRemoved":
        """The levels, from valid samples only."""
        names = tuple(self.values) if self.kind == "given" else self.channels
        indices = chosen(data.channels, names)
        offset = {data.channels.names[j]: self._level(data, j) for j in indices}
        return OffsetRemoved(offset=offset, units=units_of(data.channels, indices))

    def _level(self, data: Dataset, j: int) -> float:
        if self.kind == "given":
            return float(self.values[data.channels.names[j]])
        x = measured(data, j)
        return float(x[0] if self.kind == "first" else x.mean())


@dataclasses.dataclass(frozen=True, kw_only=True)
class OffsetRemoved(AbstractFitted):
    """x - offset, channel by channel; offsets and `units` by name."""

    offset: Mapping[str, float]
    units: Mapping[str, str]

    def apply(self, data: Dataset) -> Dataset:
        """Subtract the offsets."""
        return self._moved(data, -1.0)

    def undo(self, data: Dataset) -> Dataset:
        """Add the offsets."""
        return self._moved(data, 1.0)

    def _moved(self, data: Dataset, sign: float) -> Dataset:
        names = data.channels.names
        shift = sign * np.array([self.offset.get(n, 0.0) for n in names])

        def move(record: Record) -> Record:
            x = signals(record) + shift[None]
            row = record.start_row
            return rebuilt(record, x, record.valid, data.channels, start_row=row)

        return mapped(data, move)

    def describe(self) -> str:
        """The offsets with units."""
        parts = [f"{n} {number(v, self.units[n])}" for n, v in self.offset.items()]
        return "offset removed: " + ", ".join(parts)
