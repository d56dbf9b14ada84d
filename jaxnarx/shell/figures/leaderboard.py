"""The candidates of a search: error of the free run over the operations of a sample."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from jaxnarx.shell.figures.style import (
    BLUE,
    GREY,
    INK_COLOUR,
    RED,
    canvas,
    plain_text,
    tone,
    use_style,
)

FAMILY_MARKERS = "osD^vP*X"
COST_LABELS = {
    "operations": "operations of a sample (multiplications, divisions, exponentials)",
    "parameters": "parameters, all numbers that are stored",
}
"""What the error stands over."""
LOG_AXIS_RATIO = 4.0
"""Largest over smallest error from which the axis of errors is logarithmic."""


def error_over_operations(
    entry: Mapping[str, Any], *, by: str = "operations"
) -> Figure:
    """Every candidate of one output, its family in colour; the one in use is ringed.

    The line joins those that no other beats at the same cost. Shaded is one
    standard error above the best; bars show that of each. Candidates that
    diverge stand as crosses at the top. `entry` is what
    `jaxnarx.identification.describe` gives; `by="parameters"` shows the error over
    their number instead, without the line.
    """
    rows = [r | {"size": r[by]} for r in entry["rows"] if r[by] is not None]
    fine = [r for r in rows if r["status"] == "ok" and r["free_run"] is not None]
    with use_style():
        figure, (axes,) = canvas(9.0, 3.9)
        families = list(dict.fromkeys(r["family"] for r in _sort_by_number(rows)))
        for n, family in enumerate(families):
            own = [r for r in fine if r["family"] == family]
            _points(axes, own, family, n)
        if by == "operations":
            _front(axes, fine, entry["pareto"])
        _band(axes, fine)
        _ring(axes, fine)
        _scales(axes, fine)
        _mark_diverged(axes, [r for r in rows if r["status"] == "diverged"])
        axes.set(
            xlabel=COST_LABELS[by],
            ylabel="free run on records left out, NRMSE",
        )
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), borderaxespad=0)
    return figure


def _sort_by_number(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    return sorted(rows, key=lambda r: r["number"])


def _place(row: Mapping[str, Any]) -> float:
    """Operations or parameters; none at all stands at one."""
    return float(max(row["size"], 1))


def _points(axes: Axes, rows: Sequence[Mapping[str, Any]], family: str, n: int):
    style = {
        "color": tone(n),
        "marker": FAMILY_MARKERS[n % len(FAMILY_MARKERS)],
        "ms": 4.5,
    }
    axes.errorbar(
        [_place(r) for r in rows],
        [r["free_run"] for r in rows],
        yerr=[r["standard_error"] or 0.0 for r in rows],
        label=plain_text(family, 24),
        ls="",
        lw=0.8,
        alpha=0.9,
        **style,
    )


def _front(axes: Axes, rows: Sequence[Mapping[str, Any]], front: Sequence[int]):
    known = {r["number"]: r for r in rows}
    own = [known[n] for n in front if n in known]
    if len(own) > 1:
        x, y = [_place(r) for r in own], [r["free_run"] for r in own]
        style = {"where": "post", "color": GREY, "lw": 1.0, "zorder": 1}
        axes.step(x, y, label="no cheaper one is better", **style)


def _band(axes: Axes, rows: Sequence[Mapping[str, Any]]):
    """Draw the band from the best up to one standard error."""
    if not rows:
        return
    best = min(rows, key=lambda r: r["free_run"])
    top = best["free_run"] + (best["standard_error"] or 0.0)
    style = {"color": BLUE, "alpha": 0.12, "lw": 0}
    axes.axhspan(best["free_run"], top, label="one standard error above", **style)


def _ring(axes: Axes, rows: Sequence[Mapping[str, Any]]):
    for row in rows:
        if row["used"]:
            ring = {"ms": 13, "mfc": "none", "mec": INK_COLOUR, "mew": 1.4, "ls": ""}
            at = _place(row), row["free_run"]
            axes.plot(*at, marker="o", label=f"in use: {row['number']}", **ring)


def _scales(axes: Axes, rows: Sequence[Mapping[str, Any]]):
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:,.0f}"))
    errors = np.array([r["free_run"] for r in rows if r["free_run"] > 0])
    if len(errors) and errors.max() > LOG_AXIS_RATIO * errors.min():
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())


def _mark_diverged(axes: Axes, rows: Sequence[Mapping[str, Any]]):
    if rows:
        up = axes.get_xaxis_transform()
        style = {"marker": "x", "ls": "", "ms": 5, "color": RED, "clip_on": False}
        x, y = [_place(r) for r in rows], [0.97] * len(rows)
        axes.plot(x, y, transform=up, label="diverges: vetoed", **style)
