"""Candidates of a search as lines of text: one as it finishes, and the table."""

import dataclasses
from typing import Any

from jaxnarx.formatting import align_columns
from jaxnarx.identification import Candidate, Leaderboard, describe, figure

CANDIDATES_SHOWN = 10
"""Candidates that the end of a search shows of every output."""
COLUMN_NAMES = (
    "rank number family free_run nested above_best worst_group one_step operations "
    "parameters s name"
).split()
TABLE_LEGEND = (
    "free run: NRMSE on records left out ± its standard error over groups; nested: of "
    "the chosen one, made again without every group;",
    "above best: difference to the first ± its own standard error, group by group;",
    "operations: one sample of the model alone, without domain index and intervals. "
    "Words of the names: docs, Reference, Leaderboard.",
)
"""Lines under a table."""
LEFT_ALIGNED = {"family", "name", "worst_group"}
LAST_CELL_CHARACTERS = 76
"""Characters of the last cell."""


def live_head() -> str:
    """The line above those of `live_line`."""
    return _format_live("", "output", "family", "free run", "operations", "s", "", "")


def live_line(row: Candidate, best: bool) -> str:
    """One candidate as it finishes; the best of its output so far has a star."""
    operations = "" if row.operations is None else str(row.operations)
    cells = (str(row.number), row.output, row.family, figure(row), operations)
    nested = "" if row.nested is None else f" (nested {row.nested:.3g})"
    return _format_live(*cells, f"{row.seconds:.1f}", "*" * best, _name(row) + nested)


def _format_live(number, output, family, error, operations, seconds, star, name) -> str:
    words = f"{number:>4} {_cut(output, 10):10} {_cut(family, 23):23}"
    figures = f"{error:>17} {operations:>10} {seconds:>6}"
    return f"  {words} {figures} {star:1} {_cut(name, LAST_CELL_CHARACTERS)}".rstrip()


def _name(row: Candidate) -> str:
    """The name, and why there is no figure."""
    return f"{row.name} ({row.detail})" if row.detail else row.name


def table(
    board: Leaderboard, output: str, *, top: int | None = None, command: str = ""
) -> str:
    """The candidates of an output, best first; the one in use has a star.

    With `top` only so many: the first ones, and among them the one in use and the
    best linear one; `command` shows the others.
    """
    rows = describe(board, output)["rows"]
    shown = rows if top is None else _first_rows(rows, top)
    text = align_columns(
        [COLUMN_NAMES, *map(_cells, shown)],
        [name in LEFT_ALIGNED for name in COLUMN_NAMES],
    )
    text[0] = text[0].replace("_", " ")
    marks = [" ", *("*" if r["used"] else " " for r in shown)]
    left = len(rows) - len(shown)
    more = [f"  and {left} more" + (f": {command}" if command else "")] if left else []
    return "\n".join(
        [f"{m} {line}" for m, line in zip(marks, text, strict=True)] + more
    )


def _first_rows(rows: list[dict[str, Any]], top: int) -> list[dict[str, Any]]:
    """So many: the one in use, the best linear one, and the first of the others."""
    kept = [r["rank"] for r in rows if r["used"]]
    kept += [r["rank"] for r in rows if r["linear"]][:1]
    first = [r["rank"] for r in rows if r["rank"] not in kept]
    chosen = {*kept, *first[: top - len(set(kept))]}
    return [r for r in rows if r["rank"] in chosen]


def _cells(table: dict[str, Any]) -> list[str]:
    row = Candidate.from_dict(
        {k: v for k, v in table.items() if k in _CANDIDATE_FIELDS}
        | {"groups": (), "nested_groups": ()}
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
        "" if row.nested is None else f"{row.nested:.3g}",
        _format_difference(table),
        worst,
        "" if row.one_step is None else f"{row.one_step:.3g}",
        *("" if n is None else str(n) for n in numbers),
        f"{row.seconds:.1f}",
        _cut(_name(row), LAST_CELL_CHARACTERS),
    ]


def _format_difference(table: dict[str, Any]) -> str:
    """`0.003 ± 0.002` above the best."""
    if table["above_best"] is None:
        return ""
    return f"{table['above_best']:.2g} ± {table['above_best_standard_error']:.2g}"


_CANDIDATE_FIELDS = {field.name for field in dataclasses.fields(Candidate)}


def _cut(text: str, width: int) -> str:
    line = "".join(c if c.isprintable() else " " for c in text)
    return line if len(line) <= width else line[: width - 1] + "…"
