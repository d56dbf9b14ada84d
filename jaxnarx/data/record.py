"""One run of measurements, and where its rows come from."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.formatting import brief, page


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Record:
    """One uninterrupted run at a constant sample time.

    `u` and `y` are in physical units and finite everywhere: where a sample was missing,
    `valid` is False and the value is held from its neighbour, so that arithmetic stays
    finite; nothing is ever fitted to or scored on such a sample. `start_row` is the
    record's first row in its source, so that messages can name rows as the user sees
    them.

    `scored` marks the rows whose error counts, None stands for all: in a record of
    which one block is scored, the rest is measured history (`jaxnarx.data.groups`).
    `group` is the group of records that are held out together in cross-validation;
    empty where groups are to be detected.
    """

    u: Float[np.ndarray, "time inputs"]
    y: Float[np.ndarray, "time outputs"]
    valid: Bool[np.ndarray, "time signals"]
    name: str
    start_row: int = 0
    scored: Bool[np.ndarray, " time"] | None = None
    group: str = ""

    def __str__(self) -> str:
        missing = int((~self.valid).any(axis=1).sum())
        return (
            f"Record {self.name}: {len(self)} samples of {self.u.shape[1]} inputs and "
            f"{self.y.shape[1]} outputs"
            + (f", {missing} with something missing" if missing else "")
        )

    __repr__, _repr_html_ = brief, page

    def __len__(self) -> int:
        return self.u.shape[0]

    @property
    def signals(self) -> Float[np.ndarray, "time signals"]:
        """Inputs, then outputs, as columns of one array."""
        return np.concatenate([self.u, self.y], axis=1)

    def part(self, first: int, stop: int | None) -> "Record":
        """Rows from `first` on and before `stop`, under the same name."""
        rows = slice(first, stop)
        return dataclasses.replace(
            self,
            u=self.u[rows],
            y=self.y[rows],
            valid=self.valid[rows],
            scored=None if self.scored is None else self.scored[rows],
            start_row=self.start_row + first,
        )

    def signal(self, j: int) -> Float[np.ndarray, " time"]:
        """One of the signals, without a copy."""
        inputs = self.u.shape[1]
        return self.u[:, j] if j < inputs else self.y[:, j - inputs]


@dataclasses.dataclass(frozen=True)
class RowSource:
    """A source of rows: `name` leads a message, `start_row` is the first row's number.

    `counting` says how rows are counted (", counted from 1 with the header line"); it
    is empty for arrays and frames, whose rows count from 0 as in Python.
    """

    name: str = ""
    start_row: int = 0
    counting: str = ""

    @property
    def lead(self) -> str:
        """The beginning of a message, `"run1.csv: "`, or nothing without a name."""
        return f"{self.name}: " if self.name else ""

    def row(self, index: int | np.integer) -> str:
        """Data row `index` (from 0) as the user finds it in the source."""
        return f"row {self.start_row + int(index)}{self.counting}"

    def rows(self, first: int | np.integer, second: int | np.integer) -> str:
        """Two data rows (from 0) as the user finds them in the source."""
        start = self.start_row
        return f"rows {start + int(first)} and {start + int(second)}{self.counting}"
