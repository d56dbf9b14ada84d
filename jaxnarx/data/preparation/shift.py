"""Channels aligned in time by known delays."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from jaxnarx.data.check_samples import signals
from jaxnarx.data.dataset import Dataset, Record
from jaxnarx.data.preparation.grid import LEAST
from jaxnarx.data.preparation.samples import chosen, mapped, rebuilt
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep
from jaxnarx.errors import DataError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Shift(AbstractStep, AbstractFitted):
    """Move channels earlier by whole samples: new(t) = old(t + samples).

    An output that shows everything `n` samples late is aligned by `{name: n}`; an input
    that acts late, by `{name: -n}`. Rows at both ends that lack a channel are cut off.
    """

    samples: Mapping[str, int]

    def fit(self, data: Dataset) -> "Shift":
        """This step, its channels checked."""
        chosen(data.channels, self.samples)
        return self

    def apply(self, data: Dataset) -> Dataset:
        """Shift and cut."""
        return self._moved(data, 1)

    def undo(self, data: Dataset) -> Dataset:
        """Shift back; what was cut off does not return, and as much is cut again."""
        return self._moved(data, -1)

    def _moved(self, data: Dataset, sign: int) -> Dataset:
        ahead = [sign * self.samples.get(n, 0) for n in data.channels.names]
        first, last = max(0, -min(ahead)), max(0, max(ahead))

        def one(record: Record) -> Record:
            kept = len(record) - first - last
            if kept < LEAST:
                raise DataError(
                    f"{record.name}: of {len(record)} rows {max(kept, 0)} would be "
                    f"left after the shift, at least {LEAST} are needed. Leave out "
                    "the record."
                )
            rows = first + np.arange(kept)[:, None] + np.array(ahead)[None]
            x, valid = (
                np.take_along_axis(a, rows, axis=0)
                for a in (signals(record), record.valid)
            )
            row = record.start_row + first
            return rebuilt(record, x, valid, data.channels, start_row=row)

        return mapped(data, one)

    def describe(self) -> str:
        """Samples by channel."""
        parts = [f"{n} by {k} sample(s)" for n, k in self.samples.items()]
        return "moved earlier: " + (", ".join(parts) or "nothing")
