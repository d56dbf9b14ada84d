"""Figures of the residual analysis: correlations with bounds, and operating points."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxnarx.evaluation import (
    LAG_TEST_TITLES,
    Band,
    Chart,
    Curve,
    FreeRunResiduals,
    LagTest,
    Mark,
    OperatingPoint,
    OutputDiagnostics,
    Picture,
    StraightLine,
    uprights,
)
from jaxnarx.shell.figures.palette import shorten

MAX_INPUTS = 4
"""Inputs drawn; the ones that speak loudest."""
PANELS_PER_ROW = 3


def correlations(one: OutputDiagnostics) -> Picture:
    """Correlations of one output's residual, a row for itself and for every input.

    Shaded: the bounds of each lag alone; dashed: of all lags together; red: outside
    those. Grey lags are made zero by the fit or shown only. The third panel of an input
    is the one of its other tests with the least p.
    """
    rows = [_tests_without_inputs(one), *_inputs(one)]
    charts = [
        _panel(test, named=row is rows[-1], first=test is row[0])
        for row in rows
        for test in row
    ]
    return Picture(
        tuple(charts), PANELS_PER_ROW, height=1.75 * len(rows) + 0.3, small=True
    )


def free_run(one: FreeRunResiduals) -> Picture:
    """Correlations of one output's free-run residual: its own, and with every input.

    Bounds as in `correlations`, for residuals of their own colour; negative lags are
    shown only. At most five inputs, those that speak loudest.
    """
    loud = sorted(one.inputs, key=lambda t: t.p)[: 2 * PANELS_PER_ROW - 1]
    tests = [one.autocorrelation, *(t for t in one.inputs if any(t is k for k in loud))]
    columns = min(len(tests), PANELS_PER_ROW)
    charts = [
        _panel(
            test,
            first=n % columns == 0,
            title="" if n else "free-run residual, its colour",
        )
        for n, test in enumerate(tests)
    ]
    height = 1.9 * -(-len(tests) // columns) + 0.3
    return Picture(tuple(charts), columns, height=height, small=True)


def operating_points(one: OutputDiagnostics) -> Picture | None:
    """Mean of the residual in bins of each variable; None without any.

    Bars: twice the standard error of the mean; shaded: the standard deviation.
    """
    points = one.operating_points[: 2 * PANELS_PER_ROW]
    if not points:
        return None
    columns = min(len(points), PANELS_PER_ROW)
    unit = f" [{one.output.unit}]" if one.output.unit else ""
    return Picture(
        tuple(_bins(point, "residual" + unit) for point in points),
        columns,
        height=2.3 * -(-len(points) // columns),
        shared="y",
        small=True,
    )


def _tests_without_inputs(one: OutputDiagnostics) -> list[LagTest]:
    names = ("autocorrelation", "variance", "product, residual")
    return [one.test(name) for name in names]


def _inputs(one: OutputDiagnostics) -> list[list[LagTest]]:
    """Draw the correlation of every input, that of its square, and the worst rest."""
    rows = []
    for name in dict.fromkeys(t.signal for t in one.lag_tests if t.signal):
        tests = [t for t in one.lag_tests if t.signal == name]
        first = [one.test("input", name), one.test("squared input", name)]
        rest = [t for t in tests if t.name not in ("input", "squared input")]
        rows.append([*first, min(rest, key=lambda t: t.p)])
    loudest = sorted(rows, key=lambda row: min(t.p for t in row))[:MAX_INPUTS]
    return [row for row in rows if any(row is kept for kept in loudest)]


def _panel(test: LagTest, *, first: bool, named: bool = True, title: str = "") -> Chart:
    """The correlations of one test; `named` has its lags below, the `first` of a row
    its name at the left."""
    where = test.lags.astype(float)
    marks: list[Mark] = [Band(where, test.low, test.high, steps="middle")]
    for edge in (test.joint_low, test.joint_high):
        line = np.where(test.tested, edge, np.nan)
        style: dict[str, Any] = {"line": "dashed", "width": 0.9, "steps": "middle"}
        marks.append(Curve("", where, line, "blue", **style))
    out = np.isin(test.lags, test.outside)
    for chosen, colour in (
        (~test.tested, "grey"),
        (test.tested & ~out, "ink"),
        (out, "red"),
    ):
        if not chosen.any():
            continue
        at, value = where[chosen], test.value[chosen]
        marks.append(Curve("", *uprights(at, 0.0, value), colour, width=1.0))
        dots: dict[str, Any] = {"line": "", "marker": "o", "size": 2.6}
        marks.append(Curve("", at, value, colour, **dots))
    marks.append(StraightLine(0.0, "y", width=0.6))
    own = LAG_TEST_TITLES[test.name] + (f", {test.signal}" if test.signal else "")
    edges = (test.value, test.joint_low, test.joint_high)
    reach = 1.15 * max(float(np.max(np.abs(e), initial=0.0)) for e in edges)
    return Chart(
        tuple(marks),
        "lag [samples]" if named else "",
        "correlation" if first else "",
        title or f"{shorten(own, 34)}: p = {test.p:.1g}",
        x_range=(float(where.min()) - 0.5, float(where.max()) + 0.5),
        y_range=(-reach or -1.0, reach or 1.0),
        whole="x",
    )


def _bins(point: OperatingPoint, label: str) -> Chart:
    middle = 0.5 * (point.edges[:-1] + point.edges[1:])
    low, high = -point.deviation, point.deviation
    marks: list[Mark] = [Band(point.edges, low, high, opacity=0.13, steps="after")]
    off = np.abs(point.mean) > 2 * point.error
    for chosen, colour in ((~off, "ink"), (off, "red")):
        if not chosen.any():
            continue
        at, mean = middle[chosen], point.mean[chosen]
        half = 2 * point.error[chosen]
        ends = uprights(at, mean - half, mean + half)
        marks.append(Curve("", *ends, colour, width=1.1))
        dots: dict[str, Any] = {"line": "", "marker": "o", "size": 3.5}
        marks.append(Curve("", at, mean, colour, **dots))
    marks.append(StraightLine(0.0, "y", width=0.6))
    unit = f" [{point.unit}]" if point.unit not in ("", "-") else ""
    title = f"equal means: p = {point.p:.2g}"
    return Chart(tuple(marks), point.variable + unit, label, title)


def figures(
    outputs: Sequence[OutputDiagnostics],
) -> list[tuple[str, Picture]]:
    """Both figures of every output with their titles."""
    drawn: list[tuple[str, Picture]] = []
    for one in outputs:
        drawn.append((f"{one.output.name}: correlations", correlations(one)))
        points = operating_points(one)
        if points is not None:
            drawn.append((f"{one.output.name}: by operating point", points))
    return drawn
