"""Figures of the residual analysis: correlations with bounds, and operating points."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxnarx.evaluation import (
    LAG_TEST_TITLES,
    FreeRunResiduals,
    LagTest,
    OperatingPoint,
    OutputDiagnostics,
)
from jaxnarx.shell.figures.style import (
    BLUE,
    GREY,
    INK_COLOUR,
    RED,
    canvas,
    plain_text,
    use_style,
)

MAX_INPUTS = 4
"""Inputs drawn; the ones that speak loudest."""
PANELS_PER_ROW = 3


def correlations(one: OutputDiagnostics) -> Figure:
    """Correlations of one output's residual, a row for itself and for every input.

    Shaded: the bounds of each lag alone; dashed: of all lags together; red: outside
    those. Grey lags are made zero by the fit or shown only. The third panel of an input
    is the one of its other tests with the least p.
    """
    rows = [_tests_without_inputs(one), *_inputs(one)]
    with use_style():
        height = 1.75 * len(rows) + 0.3
        figure, axes = canvas(9.0, height, rows=len(rows), columns=PANELS_PER_ROW)
        for ax, test in zip(axes, [t for row in rows for t in row], strict=True):
            _panel(ax, test)
        for ax in axes[-PANELS_PER_ROW:]:
            ax.set_xlabel("lag [samples]")
        for ax in axes[::PANELS_PER_ROW]:
            ax.set_ylabel("correlation")
    return figure


def free_run(one: FreeRunResiduals) -> Figure:
    """Correlations of one output's free-run residual: its own, and with every input.

    Bounds as in `correlations`, for residuals of their own colour; negative lags are
    shown only. At most five inputs, those that speak loudest.
    """
    loud = sorted(one.inputs, key=lambda t: t.p)[: 2 * PANELS_PER_ROW - 1]
    tests = [one.autocorrelation, *(t for t in one.inputs if any(t is k for k in loud))]
    columns = min(len(tests), PANELS_PER_ROW)
    rows = -(-len(tests) // columns)
    with use_style():
        figure, axes = canvas(9.0, 1.9 * rows + 0.3, rows=rows, columns=columns)
        for ax, test in zip(axes, tests, strict=False):
            _panel(ax, test)
            ax.set_xlabel("lag [samples]")
        axes[0].set_title("free-run residual, its colour", fontsize=8)
        for ax in axes[len(tests) :]:
            ax.set_axis_off()
        for ax in axes[::columns]:
            ax.set_ylabel("correlation")
    return figure


def operating_points(one: OutputDiagnostics) -> Figure | None:
    """Mean of the residual in bins of each variable; None without any.

    Bars: twice the standard error of the mean; shaded: the standard deviation.
    """
    points = one.operating_points[: 2 * PANELS_PER_ROW]
    if not points:
        return None
    columns = min(len(points), PANELS_PER_ROW)
    rows = -(-len(points) // columns)
    with use_style():
        share = {"sharey": True}
        figure, axes = canvas(9.0, 2.3 * rows, rows=rows, columns=columns, **share)
        for ax, point in zip(axes, points, strict=False):
            _bins(ax, point)
        for ax in axes[len(points) :]:
            ax.set_axis_off()
        unit = f" [{plain_text(one.output.unit)}]" if one.output.unit else ""
        for ax in axes[::columns]:
            ax.set_ylabel("residual" + unit)
    return figure


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


def _panel(axes: Axes, test: LagTest) -> None:
    where = test.lags
    bounds = {"step": "mid", "lw": 0, "color": BLUE}
    axes.fill_between(where, test.low, test.high, alpha=0.18, **bounds)
    line = {"color": BLUE, "lw": 0.9, "ls": (0, (3, 1.5)), "where": "mid"}
    for edge in (test.joint_low, test.joint_high):
        axes.step(where, np.where(test.tested, edge, np.nan), **line)
    out = np.isin(where, test.outside)
    for chosen, colour in (
        (~test.tested, GREY),
        (test.tested & ~out, INK_COLOUR),
        (out, RED),
    ):
        at, value = where[chosen], test.value[chosen]
        axes.vlines(at, 0, value, color=colour, lw=1.0)
        axes.plot(at, value, color=colour, ls="", marker="o", ms=2.6, mew=0)
    axes.axhline(0, color=INK_COLOUR, lw=0.6)
    title = LAG_TEST_TITLES[test.name] + (f", {test.signal}" if test.signal else "")
    axes.set_title(f"{plain_text(title, 34)}: p = {test.p:.1g}", fontsize=8)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6))
    edges = (test.value, test.joint_low, test.joint_high)
    reach = 1.15 * max(float(np.max(np.abs(e), initial=0.0)) for e in edges)
    axes.set_ylim(-reach or -1.0, reach or 1.0)


def _bins(axes: Axes, point: OperatingPoint) -> None:
    middle = 0.5 * (point.edges[:-1] + point.edges[1:])
    band = np.r_[point.deviation, point.deviation[-1:]]
    axes.fill_between(point.edges, -band, band, step="post", color=BLUE, alpha=0.13)
    off = np.abs(point.mean) > 2 * point.error
    look: dict = {"ls": "", "marker": "o", "ms": 3.5, "lw": 1.1, "capsize": 2}
    for chosen, colour in ((~off, INK_COLOUR), (off, RED)):
        values = (middle[chosen], point.mean[chosen], 2 * point.error[chosen])
        axes.errorbar(*values, color=colour, ecolor=colour, **look)
    axes.axhline(0, color=INK_COLOUR, lw=0.6)
    unit = f" [{plain_text(point.unit)}]" if point.unit not in ("", "-") else ""
    axes.set_xlabel(plain_text(point.variable) + unit)
    axes.set_title(f"equal means: p = {point.p:.2g}", fontsize=8.5)


def figures(
    outputs: Sequence[OutputDiagnostics],
) -> list[tuple[str, Figure]]:
    """Both figures of every output with their titles."""
    drawn: list[tuple[str, Figure]] = []
    for one in outputs:
        drawn.append((f"{one.output.name}: correlations", correlations(one)))
        points = operating_points(one)
        if points is not None:
            drawn.append((f"{one.output.name}: by operating point", points))
    return drawn
