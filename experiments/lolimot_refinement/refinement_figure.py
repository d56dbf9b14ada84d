"""Figure of the refinements: every member of every problem, by what was done."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnarx.shell.style import BLUE, GREY, INK, RED, canvas, styled

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fleets"))
from ticks import plain_ticks  # noqa: E402 # pyright: ignore[reportMissingImports]


def draw(rows: list[dict[str, Any]], start: str) -> Figure:
    """One panel a problem and number of models: test free runs, a dot for a member."""
    places = sorted(dict.fromkeys((r["models"], r["problem"]) for r in rows))
    columns = min(3, len(places))
    deep = -(-len(places) // columns)
    with styled():
        size = (3.7 * columns, 0.5 + 2.6 * deep)
        figure, axes = canvas(*size, rows=deep, columns=columns)
        for ax, (models, problem) in zip(axes, places, strict=False):
            own = [r for r in rows if (r["models"], r["problem"]) == (models, problem)]
            panel(ax, own, start)
            ax.set_title(f"{problem}, {models} local models")
        for ax in axes[len(places) :]:
            ax.set_axis_off()
        figure.supxlabel(
            "free-run NRMSE of the test record; in red: diverged", fontsize=9
        )
    return figure


def panel(ax: Axes, rows: list[dict[str, Any]], start: str) -> None:
    """Dots, a bar for the median, and the number of members that diverge."""
    ways = list(dict.fromkeys(r["how"] for r in rows))
    for place, how in enumerate(ways):
        values = np.array([r["test_free_run"] for r in rows if r["how"] == how], float)
        held = np.sort(values[np.isfinite(values)])
        shift = np.linspace(-0.25, 0.25, len(held)) if len(held) > 1 else 0
        tint = GREY if how == start else BLUE
        ax.plot(held, place + shift, "o", color=tint, ms=2.5, mew=0, alpha=0.7)
        if len(held):
            ax.plot([np.median(held)] * 2, [place - 0.35, place + 0.35], color=INK)
        if len(held) < len(values):
            lost = str(len(values) - len(held))
            ax.annotate(lost, (1, place), xycoords=("axes fraction", "data"), color=RED)
    ax.set_xscale("log")
    plain_ticks(ax.xaxis)
    ax.set_yticks(range(len(ways)), ways, fontsize=7)
    ax.invert_yaxis()
