"""The value of a report: one-step, k-step and free-run figures of a network, and where
it can be trusted."""

import dataclasses
import os
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from jaxnarx.data import Channel
from jaxnarx.deprecation import old_method
from jaxnarx.errors import SpecError
from jaxnarx.evaluation._error_map import ErrorMap
from jaxnarx.evaluation._region_errors import RegionError
from jaxnarx.evaluation.coverage import IntervalCoverage
from jaxnarx.evaluation.domain_errors import DomainErrors
from jaxnarx.evaluation.effect_sizes import Effect
from jaxnarx.evaluation.error_distribution import ErrorDistribution
from jaxnarx.evaluation.extrapolation import Outside
from jaxnarx.evaluation.findings import finding_lines, findings
from jaxnarx.evaluation.gain_signs import GainFinding
from jaxnarx.evaluation.page_records import ShownRecord
from jaxnarx.evaluation.remarks import stability_values
from jaxnarx.evaluation.residual_tests import Diagnostics
from jaxnarx.evaluation.rows import FREE_RUN, POOLED_NAME, Row
from jaxnarx.evaluation.rules import judge
from jaxnarx.evaluation.section import Section
from jaxnarx.evaluation.summary import Summary, summary
from jaxnarx.evaluation.table import comparison_lines, strict, text_table
from jaxnarx.evaluation.traces import Residuals, Trace
from jaxnarx.evaluation.verdict import Verdict
from jaxnarx.evaluation.worst_segments import ErrorStretch
from jaxnarx.formatting import page
from jaxnarx.models import Network, describe_policies


@dataclasses.dataclass(frozen=True, eq=False)
class Report:
    """The quality of a network, over all records and by region, as host values; `print`
    shows the table.

    `main` names the part the verdict rests on: `"test"` when there is one, else the
    last part. `traces`, `residuals`, `maps` and `beside` belong to it. `verdict` sums
    up what the model is good for, by the rules of `jaxnarx.evaluation.rules`.

    `outside` tells which inputs leave their trained range, and how far; `regions` which
    local model carries the free-run error of the main part, `domain` how often the
    parts leave what the network knows and how its error grows there, `worst` where in
    time the main part's error is largest and what was unusual there, `coverage` what
    prediction intervals hold of every part; `beside` holds the pooled free-run rows of
    other models by their name, among them a linear model of the same lags where
    training data are at hand, and `effects` what the model is worth beside them.
    `gains` are steady-state gains that change sign over the main part, or jump,
    `distributions` the sizes of its free-run errors.
    `limits` is the margin by which reported outputs may leave their trained range, None
    where nothing holds them. `network` and `records` are what the page runs and shows:
    all records of the main part, then of the others.

    Optional, shown when present; attach them with the arguments of `report` or with
    `dataclasses.replace(report, history=...)`:

    - `leaderboard`: by output name, the candidates of the search that this model comes
      from, in the form that `jaxnarx.identification.describe` gives;
    - `selection`: by output name (or flat, for one), a dict of `names`, `err` and
      `cumulative` lists in order of choice, and `criteria`: name -> values by size;
    - `history`: one dict per refinement iteration with `iteration`, `stage`, `horizon`
      [samples], `loss`, and where known `validation` and `damping`;
    - `partition`: by output name (or flat), where each local model is valid, in the
      form that `describe_partition` gives;
    - `cost`: by output, sizes of the model and operations of one sample, as
      `Cost.to_dict` gives them;
    - `stability`: the value of the verb `stability` on the main part: poles and a
      contraction bound;
    - `diagnostics`: the value of the verb `diagnose` on the main part: whether the
      one-step residuals are what a right model leaves;
    - `provenance`: anything worth stating; versions and data hashes are filled in;
    - `next_command`: what to type next, for the page.

    `sections` are the findings of `jaxnarx.evaluation.ANALYSES`, by name.
    """

    outputs: tuple[Channel, ...]
    main: str
    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    traces: tuple[Trace, ...]
    residuals: tuple[Residuals, ...]
    equations: tuple[dict[str, Any], ...] = ()
    selection: Mapping[str, Any] | None = None
    history: Sequence[Mapping[str, Any]] | None = None
    partition: Mapping[str, Any] | None = None
    cost: Mapping[str, Mapping[str, int]] | None = None
    stability: Any = None
    diagnostics: Diagnostics | None = None
    provenance: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    outside: tuple[Outside, ...] = ()
    limits: float | None = None
    beside: Mapping[str, tuple[Row, ...]] = dataclasses.field(default_factory=dict)
    maps: tuple[ErrorMap, ...] = ()
    regions: tuple[RegionError, ...] = ()
    leaderboard: Mapping[str, Any] | None = None
    domain: DomainErrors | None = None
    worst: tuple[ErrorStretch, ...] = ()
    coverage: tuple[IntervalCoverage, ...] = ()
    effects: tuple[Effect, ...] = ()
    gains: tuple[GainFinding, ...] = ()
    distributions: tuple[ErrorDistribution, ...] = ()
    network: Any = None
    records: tuple[ShownRecord, ...] = ()
    next_command: str = ""
    sections: Mapping[str, Section] = dataclasses.field(default_factory=dict)

    @property
    def verdict(self) -> Verdict:
        """Good, usable with limits, or not usable, and why."""
        return judge(self)

    @property
    def summary(self) -> Summary:
        """Whether it may be used, where, why, and what helps."""
        return summary(self)

    @property
    def findings(self) -> dict[str, Section]:
        """Its errors, intervals, cost, rules and poles as sections."""
        return findings(self)

    @property
    def policies(self) -> tuple[str, ...]:
        """The model's behaviour beyond its training, as sentences made from it."""
        network = self.network
        return describe_policies(network) if isinstance(network, Network) else ()

    @property
    def modes(self) -> tuple[str, ...]:
        """`one step`, ..., `free run` in the order shown."""
        return tuple(dict.fromkeys(row.mode for row in self.rows))

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the datasets scored, in the order given."""
        return tuple(dict.fromkeys(row.part for row in self.rows))

    def pooled_row(
        self, output: str, *, part: str | None = None, mode: str = FREE_RUN
    ) -> Row:
        """The row of all records of a part (default: `main`) together."""
        for row in self.rows:
            key = (row.output, row.part, row.mode, row.record)
            if key == (output, part or self.main, mode, POOLED_NAME):
                return row
        raise SpecError(f"no scores of {output!r}, {part or self.main!r}, {mode!r}")

    pooled = old_method("pooled", "pooled_row")

    @property
    def table(self) -> str:
        """Verdict, where the error is largest, scores as aligned text of 80 to 100
        columns with what they are worth, and notes."""
        notes = [f"note: {note}" for note in self.notes]
        lines = [*self.summary.lines(), "", text_table(self.rows, self.main)]
        told = [
            line
            for effect in self.effects
            for line in textwrap.wrap(
                f"{self.main}, {effect}", 88, subsequent_indent="  "
            )
        ]
        own = [line for one in self.sections.values() for line in ("", *one.lines())]
        sizes = finding_lines(self)
        return "\n".join([*lines, *comparison_lines(self), *told, *notes, *sizes, *own])

    def __str__(self) -> str:
        return self.table

    _repr_html_ = page

    def to_dict(self) -> dict[str, Any]:
        """Everything but the traces' samples, as strict JSON values.

        A diverged row has null metrics and says so in `status`; an infinite figure is
        the text `"inf"` or `"-inf"`.
        """
        left_out = {"traces", "residuals", "partition", "stability", "diagnostics"}
        left_out |= {"maps", "network", "records", "sections"}
        fields = [f.name for f in dataclasses.fields(self) if f.name not in left_out]
        values: dict[str, Any] = {"verdict": self.verdict.to_dict()}
        values["summary"] = strict(self.summary)
        values["policies"] = list(self.policies)
        values |= {name: strict(getattr(self, name)) for name in fields}
        values["traces"] = [
            {"output": t.output.name, "record": t.record, "rank": t.rank}
            | {"rmse": strict(t.rmse)}
            for t in self.traces
        ]
        values["residuals"] = [
            {k: v for k, v in strict(r).items() if k not in ("measured", "simulated")}
            for r in self.residuals
        ]
        values["sections"] = {k: one.to_dict() for k, one in self.sections.items()}
        values["partition"] = strict(_without_points(self.partition))
        values["stability"] = strict(stability_values(self.stability))
        told = self.diagnostics
        values["diagnostics"] = None if told is None else told.to_dict()
        return values

    def to_html(self, path: str | os.PathLike[str]) -> None:
        """Write one self-contained offline HTML file, atomically."""
        # The one import of this floor that points up: a report that shows itself is
        # worth it, and inside the function jinja2 is not loaded before somebody asks
        # for a page.
        from jaxnarx.shell.report.html import write_report

        write_report(self, path)


def _without_points(partition: Mapping[str, Any] | None) -> Any:
    """A partition without the arrays that only figures need."""
    if partition is None:
        return None
    return {
        key: _without_points(item) if isinstance(item, Mapping) else item
        for key, item in partition.items()
        if key not in ("cloud", "weights")
    }
