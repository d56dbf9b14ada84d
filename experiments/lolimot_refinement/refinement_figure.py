"""Figure of the refinements: every member of every problem, by what was done."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnarx.shell.figures.style import BLUE, GREY, INK_COLOUR, RED, canvas, use_style

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fleets"))
from drawing import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    plain_ticks,
)


def draw(rows: list[dict[str, Any]], start: str) -> Figure:
    """A panel a problem, with the fewest local models tried: test free runs, a dot for
    a member, a bar for their median, in red the number that diverge."""
    models = min(r["models"] for r in rows)
    own = [r for r in rows if r["models"] == models]
    problems = list(dict.fromkeys(r["problem"] for r in own))
    ways = sorted({r["how"] for r in own}, key=lambda how: (how != start, _way(how)))
    columns = min(3, len(problems))
    deep = -(-len(problems) // columns)
    with use_style():
        size = (max(4.0, 1.2 + 2.7 * columns), 0.5 + (0.6 + 0.16 * len(ways)) * deep)
        figure, axes = canvas(*size, rows=deep, columns=columns, sharey=True)
        for ax, problem in zip(axes, problems, strict=False):
            panel(ax, [r for r in own if r["problem"] == problem], ways, start)
            ax.set_title(problem)
        axes[0].invert_yaxis()
        for ax in axes[len(problems) :]:
            ax.set_axis_off()
        text = f"free-run NRMSE, test, {models} local models; red: diverged"
        figure.supxlabel(text, fontsize=9)
    return figure


def _way(how: str) -> tuple[str, str]:
    moved, _, schedule = how.partition(", ")
    return schedule, moved


def panel(ax: Axes, rows: list[dict[str, Any]], ways: list[str], start: str) -> None:
    """Dots, a bar for the median, and the number of members that diverge."""
    for place, how in enumerate(ways):
        values = np.array([r["test_free_run"] for r in rows if r["how"] == how], float)
        held = np.sort(values[np.isfinite(values)])
        shift = (
            np.linspace(-0.2, 0.2, len(held)) if len(held) > 1 else np.zeros(len(held))
        )
        tint = GREY if how == start else BLUE
        ax.plot(held, place + shift, "o", color=tint, ms=2.2, mew=0, alpha=0.7)
        if len(held):
            ax.plot(
                [np.median(held)] * 2, [place - 0.35, place + 0.35], color=INK_COLOUR
            )
        if len(held) < len(values):
            lost = str(len(values) - len(held))
            at = (0.94, place + 0.3)
            ax.annotate(lost, at, xycoords=("axes fraction", "data"), color=RED)
    ax.set_xscale("log")
    plain_ticks(ax.xaxis)
    ax.set_yticks(range(len(ways)), ways, fontsize=7)
