"""Linear detrending, record by record."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from jaxnarx.data.check_samples import signals
from jaxnarx.data.dataset import Dataset, Record
from jaxnarx.data.preparation.samples import chosen, mapped, present, rebuilt
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep, cannot_undo
from jaxnarx.errors import DataError, SpecError

Lines = Mapping[str, Mapping[str, tuple[float, float]]]
"""Record name, then channel name: value at the record's first sample, slope per s."""

_LEAST = 3
"""Valid samples that a line needs, so that it does not fit them by necessity."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Detrend(AbstractStep, AbstractFitted):
    """Subtract from every record its own line of least squares over valid samples.

    With `keep_level` the mean over the valid samples stays and only the drift goes:
    levels tell operating points apart. Without it the whole line is subtracted.
    Nothing is learned from training data; the lines of given data are `lines(data)`,
    and with them `restore` undoes the step for these records, and for no others.

    Ljung 1999, System Identification, section 14.1; thesis 2.1.2, item 1.
    """

    keep_level: bool = True
    channels: tuple[str, ...] | None = None

    def fit(self, data: Dataset) -> "Detrend":
        """This step, its channels checked."""
        chosen(data.channels, self.channels)
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
        if known.sum() < _LEAST:
            name = data.channels.names[j]
            raise DataError(
                f"{record.name}: {name} has {known.sum()} valid sample(s), a trend "
                f"needs {_LEAST}. Leave out the channel or the record.",
                channel=name,
            )
        t = (np.arange(len(record)) * data.sample_time)[known]
        x = signals(record)[known, j].astype(np.float64)
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

    def undo(self, data: Dataset) -> Dataset:
        """Refused: the lines are the records' own."""
        raise cannot_undo(
            "Detrend",
            "every record has a line of its own. Keep Detrend.lines(data) before "
            "applying it, and add them with Detrend.restore(data, lines).",
        )

    def describe(self) -> str:
        """Which channels, and what is subtracted."""
        what = "drift (level kept)" if self.keep_level else "line"
        of = "all channels" if self.channels is None else ", ".join(self.channels)
        return f"linear {what} of each record removed: {of}"


def _add(data: Dataset, lines: Lines, sign: float) -> Dataset:
    names = data.channels.names

    def one(record: Record) -> Record:
        own = lines[record.name]
        line: Float[np.ndarray, "signals 2"]
        line = np.array([own.get(n, (0.0, 0.0)) for n in names])
        t = np.arange(len(record)) * data.sample_time
        x = signals(record) + sign * (line[None, :, 0] + t[:, None] * line[None, :, 1])
        row = record.start_row
        return rebuilt(record, x, record.valid, data.channels, start_row=row)

    return mapped(data, one)
