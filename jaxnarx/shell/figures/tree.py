"""A tree of gates as an indented list: what every branch lies above or below."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnarx.shell.figures.style import (
    COLOUR_CYCLE,
    GREY,
    INK_COLOUR,
    canvas,
    plain_text,
    use_style,
)

LINE_HEIGHT_INCHES = 0.21
"""Height of a line [inch]."""


class Branch(NamedTuple):
    """One line of the list: a condition, how deep it stands, and its leaf or -1.

    `parent` is the line it hangs from, -1 for the branches of the root.
    """

    text: str
    depth: int
    parent: int
    leaf: int


def tree(entry: Mapping[str, Any]) -> Figure:
    """The gates of one output's tree, from an entry of `describe_partition`.

    Each gate makes two branches, one below and one above its border; a dot carries the
    number of the local model a branch ends in. Before and after stand side by side
    where both are there.
    """
    sides = [entry[key] for key in ("before", "after") if key in entry]
    titles = ["before refinement", "after refinement"] if len(sides) == 2 else [""]
    lists = [branches(side["gates"], np.asarray(side["path"])) for side in sides]
    height = 0.5 + LINE_HEIGHT_INCHES * max(map(len, lists))
    with use_style():
        figure, axes = canvas(9.0, height, columns=len(sides), sharex=True, sharey=True)
        for ax, title, rows in zip(axes, titles, lists, strict=True):
            _draw(ax, rows)
            ax.set_title(title)
    return figure


def branches(
    gates: Sequence[Mapping[str, Mapping[str, float]]],
    path: Int[np.ndarray, "models gates"],
) -> list[Branch]:
    """The lines of the list, from the root on, the lower branch of a gate first."""
    rows: list[Branch] = []

    def grow(leaves: list[int], used: frozenset[int], depth: int, parent: int) -> None:
        free = [g for g in range(len(gates)) if g not in used]
        common = [g for g in free if np.all(path[leaves, g] != 0)]
        if len(leaves) < 2 or not common:
            return
        gate = common[0]
        ((text, bound),) = gates[gate].items()
        ((opens, level),) = bound.items()
        for word, sign in (("below", "<"), ("above", ">")):
            side = 1 if word == opens else -1
            part = [m for m in leaves if path[m, gate] == side]
            leaf = part[0] if len(part) == 1 else -1
            told = f"{text} {sign} {level:.4g}"
            if text == "share":
                own = level if side > 0 else 1 - level
                told = f"{own:.0%} of {'the sum' if depth == 0 else 'the rest'}"
            rows.append(Branch(told, depth, parent, leaf))
            grow(part, used | {gate}, depth + 1, len(rows) - 1)

    grow(list(range(len(path))), frozenset(), 0, -1)
    return rows


def _draw(axes: Axes, rows: list[Branch]) -> None:
    """One line per branch, elbows from each to the one it hangs from."""
    step = 0.035
    for at, row in enumerate(rows):
        x = step * row.depth
        start = row.parent if row.parent >= 0 else -0.6
        axes.plot([x, x, x + 0.6 * step], [start + 0.3, at, at], color=GREY, lw=0.8)
        place = x + 0.9 * step
        if row.leaf >= 0:
            dot = {
                "marker": "o",
                "ms": 11,
                "color": COLOUR_CYCLE[row.leaf % len(COLOUR_CYCLE)],
            }
            axes.plot(place + 0.006, at, alpha=0.55, mew=0, **dot)
            number: dict[str, Any] = {
                "ha": "center",
                "va": "center_baseline",
                "fontweight": "bold",
            }
            axes.text(place + 0.006, at, str(row.leaf + 1), fontsize=7.5, **number)
            place += 0.03
        axes.text(
            place, at, plain_text(row.text, 60), va="center_baseline", color=INK_COLOUR
        )
    axes.set(xlim=(-0.01, 1), ylim=(max(len(rows), 1) - 0.4, -0.8))
    axes.set_axis_off()
