"""The candidates of a search: error of the free run over the operations of a sample."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from jaxnarx.evaluation import Chart, Curve, Mark, Picture, Span, uprights
from jaxnarx.shell.figures.palette import shorten

FAMILY_MARKERS = "osD^vP*X"
COST_LABELS = {
    "operations": "operations of a sample (multiplications, divisions, exponentials)",
    "parameters": "parameters, all numbers that are stored",
}
"""What the error stands over."""
LOG_AXIS_RATIO = 4.0
"""Largest over smallest error from which the axis of errors is logarithmic."""

Rows = Sequence[Mapping[str, Any]]


def error_over_operations(
    entry: Mapping[str, Any], *, by: str = "operations"
) -> Picture:
    """Every candidate of one output, its family in colour; the one in use is ringed.

    The line joins those that no other beats at the same cost. Shaded is one
    standard error above the best; bars show that of each. Candidates that
    diverge stand as crosses at the top. `entry` is what
    `jaxnarx.identification.describe` gives; `by="parameters"` shows the error over
    their number instead, without the line.
    """
    rows = [r | {"size": r[by]} for r in entry["rows"] if r[by] is not None]
    fine = [r for r in rows if r["status"] == "ok" and r["free_run"] is not None]
    lost = [r for r in rows if r["status"] == "diverged"]
    families = list(
        dict.fromkeys(r["family"] for r in sorted(rows, key=lambda r: r["number"]))
    )
    marks: list[Mark] = list(_band(fine))
    if by == "operations":
        marks += _front(fine, entry["pareto"])
    for n, family in enumerate(families):
        marks += _points([r for r in fine if r["family"] == family], family, n)
    marks += _ring(fine)
    errors = [r["free_run"] for r in fine if r["free_run"] > 0]
    many = bool(errors) and max(errors) > LOG_AXIS_RATIO * min(errors)
    log = "xy" if many else "x"
    if lost:
        # Above the others, where no error is.
        top = Chart(tuple(marks), log=log).values("y")
        low, high = (top.min(), top.max()) if len(top) else (0.5, 1.0)
        at = high * (high / low) ** 0.08 if many else high + 0.08 * (high - low or 1.0)
        style: dict[str, Any] = {"line": "", "marker": "x", "size": 5}
        places = [_place(r) for r in lost], [float(at)] * len(lost)
        marks.append(Curve("diverges: vetoed", *places, "red", **style))
    chart = Chart(
        tuple(marks),
        COST_LABELS[by],
        "free run on records left out, NRMSE",
        log=log,
        legend="right",
    )
    return Picture((chart,), height=3.9)


def _place(row: Mapping[str, Any]) -> float:
    """Operations or parameters; none at all stands at one."""
    return float(max(row["size"], 1))


def _points(rows: Rows, family: str, n: int) -> Iterator[Curve]:
    x, y = [_place(r) for r in rows], [r["free_run"] for r in rows]
    half = [r["standard_error"] or 0.0 for r in rows]
    ends = (
        [a - h for a, h in zip(y, half, strict=True)],
        [a + h for a, h in zip(y, half, strict=True)],
    )
    yield Curve("", *uprights(x, *ends), n, width=0.8, opacity=0.9)
    marker = FAMILY_MARKERS[n % len(FAMILY_MARKERS)]
    style: dict[str, Any] = {"line": "", "marker": marker, "size": 4.5}
    yield Curve(shorten(family, 24), x, y, n, opacity=0.9, **style)


def _front(rows: Rows, front: Sequence[int]) -> Iterator[Curve]:
    known = {r["number"]: r for r in rows}
    own = [known[n] for n in front if n in known]
    if len(own) > 1:
        x, y = [_place(r) for r in own], [r["free_run"] for r in own]
        yield Curve("no cheaper one is better", x, y, "grey", width=1.0, steps="after")


def _band(rows: Rows) -> Iterator[Span]:
    """From the best up to one standard error."""
    if rows:
        best = min(rows, key=lambda r: r["free_run"])
        top = best["free_run"] + (best["standard_error"] or 0.0)
        yield Span(best["free_run"], top, "y", name="one standard error above")


def _ring(rows: Rows) -> Iterator[Curve]:
    ring: dict[str, Any] = {"line": "", "marker": "o", "size": 13, "hollow": True}
    for row in rows:
        if row["used"]:
            place = [_place(row)], [row["free_run"]]
            yield Curve(f"in use: {row['number']}", *place, "ink", **ring)
