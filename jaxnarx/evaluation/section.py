"""One finding of a report, shown alike as text, as JSON and on the page.

An analysis is a function of a `FreeRun` that returns a `Section`, or None where it has
nothing to say (`jaxnarx.evaluation.analyses`).
"""

import dataclasses
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Channel, Dataset
from jaxnarx.evaluation.charts import Chart, Picture
from jaxnarx.evaluation.rows import ScoredSamples, collect
from jaxnarx.evaluation.table import number, strict
from jaxnarx.formatting import align_columns, page
from jaxnarx.models import Network
from jaxnarx.simulation import simulate

Cell = str | int | float | None
"""A text stands left, a number right; None is shown as a dash."""


@dataclasses.dataclass(frozen=True)
class Section:
    """A finding under a title: sentences, then a table, then charts, then a small note.

    `header` names the columns of `rows`. `data` are further values for `report.json`.
    `marked` are cells (row, column) that speak against the model; the page colours
    them.
    """

    title: str
    sentences: tuple[str, ...] = ()
    header: tuple[str, ...] = ()
    rows: tuple[tuple[Cell, ...], ...] = ()
    charts: tuple[Chart | Picture, ...] = ()
    note: str = ""
    data: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    marked: tuple[tuple[int, int], ...] = ()

    def __str__(self) -> str:
        return "\n".join(self.lines())

    _repr_html_ = page

    def lines(self, width: int = 88) -> Iterator[str]:
        """The section as text: title, sentences, table; charts are for the page."""
        yield self.title
        for sentence in self.sentences:
            yield from textwrap.wrap(
                sentence, width, initial_indent="  ", subsequent_indent="  "
            )
        if self.rows:
            cells = [[_text(cell) for cell in row] for row in self.rows]
            left = [isinstance(cell, str) for cell in self.rows[0]]
            for line in align_columns([self.header, *cells], left):
                yield f"  {line}"

    def to_dict(self) -> dict[str, Any]:
        """Title, sentences, table and the further values, as strict JSON values."""
        table = [dict(zip(self.header, row, strict=True)) for row in self.rows]
        own = {"title": self.title, "sentences": self.sentences, "table": table}
        return strict(own | dict(self.data))


def _text(cell: Cell) -> str:
    return str(cell) if isinstance(cell, str | int) else number(cell)


@dataclasses.dataclass(frozen=True, eq=False)
class FreeRun:
    """The free run of a network on the main part of a report, as analyses are given it.

    `samples[o][r]` are those of output `outputs[o]` in record r of `data`; `training`
    are the records of the part `"train"`, None where the report has none.
    """

    network: Any
    part: str
    data: Dataset
    outputs: tuple[Channel, ...]
    samples: list[list[ScoredSamples]]
    training: Dataset | None = None

    @classmethod
    def of(cls, network: Network, data: Dataset, part: str = "data") -> "FreeRun":
        """The free run of a network over data."""
        outputs = tuple(network.output_channels)
        samples = collect(data, outputs, simulate(network, data).value)
        return cls(network, part, data, outputs, samples)

    def errors(self, output: int) -> list[Float[np.ndarray, " time"]]:
        """Measured minus simulated of every record that stays bounded, in the output's
        unit; NaN where a sample does not count."""
        return [
            np.where(one.scored, one.measured - one.predicted, np.nan)[:, 0]
            for one in self.samples[output]
            if not one.diverged
        ]
