"""The rows of a sweep as a value."""

import dataclasses
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Shaped

from jaxnarx.errors import SpecError, suggest
from jaxnarx.formatting import align_columns, brief, page, some
from jaxnarx.solution import OKAY_STATUSES, STATUS_NAMES

LINE_WIDTH = 100
"""Characters of a printed line."""


@dataclasses.dataclass(frozen=True, repr=False)
class SweepTable:
    """One row per member of a sweep: index, labels, status, scores, seconds, message.

    `arrow` is the table as it is kept in `folder`; `where` and `take` make smaller
    ones. A score that a failed member does not have is null there and NaN in `column`.
    """

    arrow: pa.Table
    folder: Path | None = None

    @classmethod
    def from_rows(cls, rows: Sequence[dict[str, Any]]) -> "SweepTable":
        """A table of dictionaries; keys that a row lacks are null there."""
        from jaxnarx.sweep.folder.chunks import arrow_table

        return cls(arrow_table(rows))

    def __str__(self) -> str:
        """Columns as far as a line holds them, and the names of the others."""
        columns = [
            [name, *map(_cell, self.arrow.column(name).to_pylist())]
            for name in self.names
        ]
        ends = np.cumsum([2 + max(map(len, column)) for column in columns])
        shown = max(1, int(np.searchsorted(ends, LINE_WIDTH + 2, side="right")))
        place = f" in {self.folder}" if self.folder else ""
        lines = [f"SweepTable: {len(self)} rows{place}"]
        if columns:
            lines += some(align_columns(zip(*columns[:shown], strict=True)), 24)
        if rest := self.names[shown:]:
            lines += textwrap.wrap(f"  and {', '.join(rest)}", LINE_WIDTH)
        return "\n".join(lines)

    __repr__, _repr_html_ = brief, page

    def __len__(self) -> int:
        """Number of rows."""
        return self.arrow.num_rows

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self.arrow.column_names)

    def column(self, name: str) -> Shaped[np.ndarray, " rows"]:
        """A column as an array; numbers that are not there are NaN, lists objects."""
        if name not in self.names:
            raise SpecError(
                f"the table has no column {name!r}. {suggest(name, self.names)}",
                field="name",
            )
        column = self.arrow.column(name)
        if pa.types.is_nested(column.type):
            values = np.empty(len(self), object)
            values[:] = column.to_pylist()
            return values
        if pa.types.is_null(column.type):
            return np.full(len(self), np.nan)
        return column.to_numpy(zero_copy_only=False)

    def numbers(self, name: str) -> Shaped[np.ndarray, " rows"]:
        """A column as float64; SpecError where it is not of numbers."""
        values = self.column(name)
        if values.dtype.kind in "biuf":
            return values.astype(float)
        if not any(isinstance(v, str | list) for v in values):
            return np.array([np.nan if v is None else float(v) for v in values])
        raise SpecError(f"column {name!r} does not hold numbers", field="name")

    def rows(self) -> Iterator[dict[str, Any]]:
        """The rows as dictionaries."""
        return iter(self.arrow.to_pylist())

    def take(self, which: Shaped[np.ndarray, " chosen"]) -> "SweepTable":
        """The rows a mask or array of positions picks."""
        if which.dtype.kind == "b" and len(which) != len(self):
            raise SpecError(
                f"a mask of {len(which)} for {len(self)} rows", field="which"
            )
        kept = np.flatnonzero(which) if which.dtype.kind == "b" else which
        return SweepTable(self.arrow.take(pa.array(kept, pa.int64())), self.folder)

    def where(self, **labels: Any) -> "SweepTable":
        """The rows whose columns have these values, or one of them for a list."""
        mask = np.ones(len(self), bool)
        for name, wanted in labels.items():
            choice = wanted if isinstance(wanted, list | tuple | set) else [wanted]
            mask &= np.array([value in choice for value in self.column(name)], bool)
        return self.take(mask)

    @property
    def okay(self) -> Bool[np.ndarray, " rows"]:
        """The rows whose status is an informative end rather than a failure."""
        return np.array(
            [s in STATUS_NAMES[:OKAY_STATUSES] for s in self.column("status")], bool
        )

    def to_pandas(self) -> Any:
        """The table as a pandas frame; pandas must be installed."""
        try:
            return self.arrow.to_pandas()
        except ImportError as error:
            raise ImportError(
                "to_pandas needs pandas: pip install pandas, or use column and rows"
            ) from error


def _cell(value: Any) -> str:
    if value is None:
        return ""
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text.splitlines()[0][:60] if text else ""
