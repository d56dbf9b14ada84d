"""Candidates of a search as lines of text: one as it finishes, and the table."""

from collections.abc import Iterable, Sequence
from typing import Any

from jaxnarx.identification import Leaderboard, Row, described, figure

TOP = 10
"""Candidates that the end of a search shows of every output."""
LINEAR = 2
"""Linear ones that it shows in any case."""
HEAD = "rank number family name free_run worst_group one_step operations parameters s"
LEFT = {"family", "name", "worst_group"}
WIDEST = 44
"""Characters of a cell."""


def live_head() -> str:
    """The line above those of `live_line`."""
    return _live("", "output", "family", "name", "free run", "operations", "s", "")


def live_line(row: Row, best: bool) -> str:
    """One candidate as it finishes; the best of its output so far has a star."""
    operations = "" if row.operations is None else str(row.operations)
    star = "  *" if best else ""
    cells = (row.output, row.family, row.name, figure(row), operations)
    return _live(str(row.number), *cells, f"{row.seconds:.1f}", star)


def _live(number, output, family, name, error, operations, seconds, star) -> str:
    words = f"{_cut(output, 10):10} {_cut(family, 15):15} {_cut(name, 31):31}"
    figures = f"{error:>16} {operations:>10} {seconds:>7}{star}"
    return f"  {number:>4} {words} {figures}".rstrip()


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
    text = aligned(
        [HEAD.split(), *map(_cells, shown)], [name in LEFT for name in HEAD.split()]
    )
    text[0] = text[0].replace("_", " ")
    marks = [" ", *("*" if r["used"] else " " for r in shown)]
    left = len(rows) - len(shown)
    more = [f"  and {left} more"] if left else []
    return "\n".join(
        [f"{m} {line}" for m, line in zip(marks, text, strict=True)] + more
    )


def _cells(row: dict[str, Any]) -> list[str]:
    error = figure(Row.from_dict({k: row[k] for k in _FIELDS}))
    worst = row["worst_group"]
    if worst and row["worst_group_error"] is not None:
        worst = f"{_cut(worst, 20)} {row['worst_group_error']:.3g}"
    one = row["one_step"]
    return [
        str(row["rank"]),
        str(row["number"]),
        _cut(row["family"], 20),
        _cut(row["name"], WIDEST),
        error,
        worst,
        "" if one is None else f"{one:.3g}",
        *("" if row[k] is None else str(row[k]) for k in ("operations", "parameters")),
        f"{row['seconds']:.1f}",
    ]


_FIELDS = ("output", "number", "family", "name", "free_run", "standard_error", "status")


def aligned(lines: Iterable[Sequence[str]], left: Sequence[bool]) -> list[str]:
    """Cells in columns; text left, figures right."""
    lines = list(lines)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return [
        "  ".join(
            cell.ljust(w) if at_left else cell.rjust(w)
            for cell, w, at_left in zip(line, widths, left, strict=True)
        ).rstrip()
        for line in lines
    ]


def _cut(text: str, width: int) -> str:
    line = "".join(c if c.isprintable() else " " for c in text)
    return line if len(line) <= width else line[: width - 1] + "…"
