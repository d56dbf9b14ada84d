"""A tree of gates as an indented list: what every branch lies above or below."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from jaxnarx.evaluation import Chart, Curve, Mark, Picture, Text
from jaxnarx.shell.figures.palette import COLOUR_CYCLE, shorten

LINE_HEIGHT_INCHES = 0.21
"""Height of a line [inch]."""
INDENT = 0.035
"""Share of the width by which a branch stands further in."""


class Branch(NamedTuple):
    """One line of the list: a condition, how deep it stands, and its leaf or -1.

    `parent` is the line it hangs from, -1 for the branches of the root.
    """

    text: str
    depth: int
    parent: int
    leaf: int


def tree(entry: Mapping[str, Any]) -> Picture:
    """The gates of one output's tree, from an entry of `describe_partition`.

    Each gate makes two branches, one below and one above its border; a dot carries the
    number of the local model a branch ends in. Before and after stand side by side
    where both are there.
    """
    sides = [entry[key] for key in ("before", "after") if key in entry]
    titles = ["before refinement", "after refinement"] if len(sides) == 2 else [""]
    lists = [branches(side["gates"], np.asarray(side["path"])) for side in sides]
    longest = max(map(len, lists))
    charts = [
        Chart(
            tuple(_marks(rows)),
            title=title,
            x_range=(-0.01, 1.0),
            y_range=(max(longest, 1) - 0.4, -0.8),
            bare=True,
        )
        for title, rows in zip(titles, lists, strict=True)
    ]
    height = 0.5 + LINE_HEIGHT_INCHES * longest
    return Picture(tuple(charts), len(charts), height=height)


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


def _marks(rows: list[Branch]) -> Iterator[Mark]:
    """One line per branch, elbows from each to the one it hangs from."""
    for at, row in enumerate(rows):
        x = INDENT * row.depth
        start = row.parent if row.parent >= 0 else -0.6
        elbow = [x, x, x + 0.6 * INDENT], [start + 0.3, at, at]
        yield Curve("", *elbow, "grey", width=0.8)
        place = x + 0.9 * INDENT
        if row.leaf >= 0:
            dot: dict[str, Any] = {"line": "", "marker": "o", "size": 11}
            colour = row.leaf % len(COLOUR_CYCLE)
            yield Curve("", [place + 0.006], [at], colour, opacity=0.55, **dot)
            number = str(row.leaf + 1)
            yield Text(place + 0.006, at, number, bold=True, size=7.5)
            place += 0.03
        yield Text(place, at, shorten(row.text, 60), across="left")
