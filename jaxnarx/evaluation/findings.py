"""The package's own findings of a report as sections, for its text and its page.

`report.json` has them under keys of their own (`distributions`, `cost`, `stability`,
`coverage`, `verdict`).
"""

from collections.abc import Iterator
from typing import Any

from jaxnarx.evaluation.charts import Chart, Curve, Mark, Picture, StraightLine
from jaxnarx.evaluation.error_distribution import ErrorDistribution
from jaxnarx.evaluation.section import Cell, Section
from jaxnarx.evaluation.table import name_data


def findings(report: Any) -> dict[str, Section]:
    """The sections of a `Report` by name, those that have something to say."""
    made = {
        "errors": error_sizes,
        "coverage": interval_coverage,
        "cost": sample_cost,
        "rules": verdict_rules,
        "stability": pole_table,
    }
    found = {name: make(report) for name, make in made.items()}
    return {name: one for name, one in found.items() if one is not None}


def error_sizes(report: Any) -> Section | None:
    """How large free-run errors are: 95 % of them, the largest, and the curve."""
    known: tuple[ErrorDistribution, ...] = report.distributions
    if not known:
        return None
    header = "output", "samples", "95 % up to", "largest"
    limit = known[0].tolerance
    if limit is not None:
        header += (f"within {limit:g}, %",)
    rows = []
    for one in known:
        row: tuple[Cell, ...] = (_label(one), one.samples, one.most, one.largest)
        if limit is not None:
            row += (None if one.within is None else 100 * one.within,)
        rows.append(row)
    return Section(
        "How large the errors are",
        (f"Free run on {name_data(report.main)}, records that stayed bounded.",),
        header,
        tuple(rows),
        tuple(map(_cumulated_errors, known)),
        "Of the samples, the share whose error is at most as large; dashed: 95 %.",
    )


def _cumulated_errors(one: ErrorDistribution) -> Picture:
    """Share of the samples over the size of their error; a line marks 95 %, another
    the tolerance."""
    unit = f" [{one.unit}]" if one.unit else ""
    marks: list[Mark] = [Curve("", one.size, 100 * one.share, "blue")]
    marks.append(Curve("", [one.most] * 2, [0.0, 95.0], "ink", "dashed", 0.8))
    if one.tolerance is not None and one.tolerance <= one.largest:
        marks.append(StraightLine(one.tolerance, colour="orange", width=1.2))
    chart = Chart(
        tuple(marks),
        "size of the error" + unit,
        "samples up to it [%]",
        one.output,
        x_range=(0.0, one.largest or 1.0),
        y_range=(0.0, 101.0),
    )
    return Picture((chart,), height=2.6)


def interval_coverage(report: Any) -> Section | None:
    """The share of every part's samples that prediction intervals hold."""
    if not report.coverage:
        return None
    level = 100 * report.coverage[0].level
    rows, marked = [], []
    for n, one in enumerate(report.coverage):
        rows.append(
            (one.part, _label(one), 100 * one.held, one.half, one.rmse, one.samples)
        )
        if one.is_narrow:
            marked.append((n, 2))
    return Section(
        f"What {level:g} % prediction intervals hold",
        (),
        ("data", "output", "held %", "± in the mean", "RMSE", "samples"),
        tuple(rows),
        note=f"They should hold {level:g} %. Marked: fewer, beyond what chance over "
        "records explains. On training data they hold more, for errors are smaller.",
        marked=tuple(marked),
    )


def sample_cost(report: Any) -> Section | None:
    """Sizes of the model and operations of one sample."""
    if not report.cost:
        return None
    names = tuple(next(iter(report.cost.values())))
    rows = [(output, *row.values()) for output, row in report.cost.items()]
    return Section(
        "What a sample costs",
        (),
        ("output", *names),
        tuple(rows),
        note="Operations of exported code at each sample, without the domain index; "
        "what outputs have in common counts once in the sum.",
    )


def verdict_rules(report: Any) -> Section | None:
    """The rules that the verdict comes from, with values and limits."""
    rows, marked = [], []
    for n, rule in enumerate(report.verdict.rules):
        passed = {None: "no value", True: "yes", False: "no"}[rule.passed]
        place = rule.name, rule.output, rule.where
        rows.append((*place, rule.value, rule.sense, rule.limit, passed))
        if rule.passed is False:
            marked.append((n, 3))
    if not rows:
        return None
    return Section(
        "Rules of the verdict",
        (),
        ("rule", "output", "on", "value", "must be", "limit", "passed"),
        tuple(rows),
        note="Errors are NRMSE in free run where nothing else is said. `jaxnarx report "
        "--junit PATH` writes these rows as test cases.",
        marked=tuple(marked),
    )


def pole_table(report: Any) -> Section | None:
    """Poles of the local models and of the network along its run."""
    if report.stability is None:
        return None
    rows = tuple(_pole_row(one) for one in report.stability.poles)
    marked = [
        (n, 5) for n, one in enumerate(report.stability.poles) if one.largest >= 1
    ]
    return Section(
        "Stability",
        (report.stability.summary,),
        (
            *("output", "model", "samples", "median", "95 %", "largest"),
            *("unstable %", "time constant [s]"),
        ),
        rows,
        note="Largest modulus of the poles, per sample: below 1 the past is forgotten. "
        "Local models alone where they lead, at measured samples; the network along "
        "its free run.",
        marked=tuple(marked),
    )


def _pole_row(one: Any) -> tuple[Cell, ...]:
    model = "network" if one.model is None else str(one.model)
    sizes = one.median, one.high, one.largest
    return (
        *(one.output, model, one.samples, *sizes),
        *(100 * one.unstable, one.time_constant),
    )


def _label(one: Any) -> str:
    return f"{one.output} [{one.unit}]" if one.unit else one.output


def finding_lines(report: Any) -> Iterator[str]:
    """Findings that the text of a report shows, behind its scores."""
    section = error_sizes(report)
    if section is not None:
        yield ""
        yield from section.lines()
