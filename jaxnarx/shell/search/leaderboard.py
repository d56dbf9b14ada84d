"""Candidates of a search as lines of text: one as it finishes, and the table."""

import dataclasses
from typing import Any

from jaxnarx.identification import Contender, Leaderboard, described, figure
from jaxnarx.shown import aligned

TOP = 10
"""Candidates that the end of a search shows of every output."""
LINEAR = 2
"""Linear ones that it shows in any case."""
HEAD = (
    "rank number family free_run worst_group one_step operations parameters s name"
).split()
LEFT = {"family", "name", "worst_group"}
WIDEST = 76
"""Characters of the last cell."""


def live_head() -> str:
    """The line above those of `live_line`."""
    return _live("", "output", "family", "free run", "operations", "s", "", "")


def live_line(row: Contender, best: bool) -> str:
    """One candidate as it finishes; the best of its output so far has a star."""
    operations = "" if row.operations is None else str(row.operations)
    cells = (str(row.number), row.output, row.family, figure(row), operations)
    return _live(*cells, f"{row.seconds:.1f}", "*" * best, _name(row))


def _live(number, output, family, error, operations, seconds, star, name) -> str:
    words = f"{number:>4} {_cut(output, 10):10} {_cut(family, 23):23}"
    figures = f"{error:>17} {operations:>10} {seconds:>6}"
    return f"  {words} {figures} {star:1} {_cut(name, WIDEST)}".rstrip()


def _name(row: Contender) -> str:
    """The name, and why there is no figure."""
    return f"{row.name} ({row.detail})" if row.detail else row.name


def table(board: Leaderboard, output: str, *, top: int | None = None) -> str:
    """The candidates of an output, best first; the one in use has a star.

    With `top` only so many of the first, the one in use and the best linear ones.
    """
    rows = described(board, output)["rows"]
    linear = [r["rank"] for r in rows if r["linear"]][:LINEAR]
    shown = [
        r
        for r in rows
        if top is None or r["rank"] <= top or r["used"] or r["rank"] in linear
    ]
    text = aligned([HEAD, *map(_cells, shown)], [name in LEFT for name in HEAD])
    text[0] = text[0].replace("_", " ")
    marks = [" ", *("*" if r["used"] else " " for r in shown)]
    left = len(rows) - len(shown)
    more = [f"  and {left} more"] if left else []
    return "\n".join(
        [f"{m} {line}" for m, line in zip(marks, text, strict=True)] + more
    )


def _cells(table: dict[str, Any]) -> list[str]:
    row = Contender.from_dict(
        {k: v for k, v in table.items() if k in _FIELDS} | {"groups": ()}
    )
    worst = table["worst_group"]
    if worst and table["worst_group_error"] is not None:
        worst = f"{_cut(worst, 20)} {table['worst_group_error']:.3g}"
    numbers = (row.operations, row.parameters)
    return [
        str(table["rank"]),
        str(row.number),
        _cut(row.family, 23),
        figure(row),
        worst,
        "" if row.one_step is None else f"{row.one_step:.3g}",
        *("" if n is None else str(n) for n in numbers),
        f"{row.seconds:.1f}",
        _cut(_name(row), WIDEST),
    ]


_FIELDS = {field.name for field in dataclasses.fields(Contender)}


def _cut(text: str, width: int) -> str:
    line = "".join(c if c.isprintable() else " " for c in text)
    return line if len(line) <= width else line[: width - 1] + "…"
