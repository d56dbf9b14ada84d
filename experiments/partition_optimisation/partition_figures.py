"""Figures of the partitions: error over models, and every start beside the best."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnarx.shell.figures.style import (
    BLUE,
    GREEN,
    GREY,
    INK_COLOUR,
    ORANGE,
    RED,
    canvas,
    use_style,
)

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fleets"))
from drawing import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    plain_ticks,
)

LINES = {
    ("lolimot", "none"): (GREY, ":"),
    ("lolimot", "coefficients"): (BLUE, "--"),
    ("lolimot", "staged"): (BLUE, "-"),
    ("tree", "none"): (ORANGE, ":"),
    ("tree", "coefficients"): (ORANGE, "--"),
    ("tree", "staged"): (ORANGE, "-"),
}
WORDS = {
    "none": "as grown",
    "coefficients": "coefficients refined",
    "staged": "all refined",
    "lolimot": "LOLIMOT",
    "tree": "sigmoid tree",
}
KINDS = ("lolimot", "tree", "scattered", "random", "cluster")


def draw_curves(curves: list[dict[str, Any]]) -> Figure:
    """Median test free run over the number of models, a panel for every problem."""
    problems = list(dict.fromkeys(c["problem"] for c in curves))
    with use_style():
        figure, axes = _panels(problems)
        for ax, problem in zip(axes, problems, strict=False):
            for (partition, train), (color, line) in LINES.items():
                own = [
                    c
                    for c in curves
                    if (c["problem"], c["partition"], c["train"])
                    == (problem, partition, train)
                    and "median" in c["free_run"]
                ]
                own.sort(key=lambda c: c["models"])
                text = f"{WORDS[partition]}, {WORDS[train]}"
                x = [c["models"] for c in own]
                y = [c["free_run"]["median"] for c in own]
                ax.plot(x, y, line, color=color, marker="o", ms=2, lw=0.9, label=text)
            ax.set_title(problem)
            ax.set_yscale("log")
            plain_ticks(ax.yaxis)
            ax.set_xticks(sorted({c["models"] for c in curves}))
            ax.set_xlabel("local models")
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=3)
        figure.supylabel("free-run NRMSE, test, median", fontsize=8)
    return figure


def draw_starts(rows: list[dict[str, Any]], best: str) -> Figure:
    """Every refined start of every member with as many models; a ring for the start
    that validation chooses, a bar for the median of a kind."""
    sizes = {r["models"] for r in rows if r["partition"] == "random"}
    own = [r for r in rows if r["train"] == "staged" and r["models"] in sizes]
    problems = list(dict.fromkeys(r["problem"] for r in own))
    with use_style():
        figure, axes = _panels(problems, sharey=True)
        for ax, problem in zip(axes, problems, strict=False):
            here = [r for r in own if r["problem"] == problem]
            for place, kind in enumerate(KINDS):
                _dots(ax, place, [r for r in here if r["partition"] == kind])
            for r in (r for r in here if r["partition"] == best):
                at = (r["test_free_run"], KINDS.index(r["from"]))
                ax.plot(*at, "o", ms=7, mfc="none", mec=GREEN, mew=1.2)
            ax.set_yticks(range(len(KINDS)), [WORDS.get(k, k) for k in KINDS])
            ax.set_title(problem)
            ax.set_xscale("log")
            plain_ticks(ax.xaxis)
        axes[0].invert_yaxis()
        text = "free-run NRMSE, test; ring: chosen by validation; red: diverged"
        figure.supxlabel(text, fontsize=8)
    return figure


def _dots(ax: Axes, place: int, rows: list[dict[str, Any]]) -> None:
    values = np.array([r["test_free_run"] for r in rows], float)
    held = np.sort(values[np.isfinite(values)])
    ax.plot(held, np.full(len(held), place), "o", color=BLUE, ms=3, mew=0, alpha=0.5)
    if len(held):
        ax.plot([np.median(held)] * 2, [place - 0.3, place + 0.3], color=INK_COLOUR)
    if len(held) < len(values):
        lost = str(len(values) - len(held))
        ax.annotate(lost, (1, place), xycoords=("axes fraction", "data"), color=RED)


def _panels(problems: list[str], **grid: Any) -> tuple[Figure, list[Axes]]:
    columns = min(4, len(problems))
    deep = -(-len(problems) // columns)
    size = (max(6.0, 2.2 * columns), 1.0 + 1.7 * deep)
    figure, axes = canvas(*size, rows=deep, columns=columns, **grid)
    for ax in axes[len(problems) :]:
        ax.set_axis_off()
    return figure, axes
