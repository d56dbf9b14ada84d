"""A report's values as aligned text, pooled figures first, and as strict JSON."""

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxnarx.evaluation.rows import FREE_RUN, POOLED_NAME, Row
from jaxnarx.formatting import ratio_text

TABLE_HEADER = (
    "record",
    "mode",
    "RMSE",
    "NRMSE",
    "R2",
    "fit %",
    "NMSE",
    "total %",
    "samples",
    "limited",
)
FIGURE_COLUMNS = slice(2, 8)
"""Columns of figures; a status stands in the first, and may run over the others."""
MISSING_FIGURES = ("",) * 5


def name_data(part: str) -> str:
    """`test data`; of a part without a name of its own `data`."""
    return part if part == "data" else f"{part} data"


def number(value: float | None, style: str = ".4g") -> str:
    """A figure for people: four significant digits, `inf` as such, `None` as a dash."""
    if value is None:
        return "-"
    return format(value, style) if math.isfinite(value) else str(float(value))


SHOWN_RECORDS = 3
"""Records of an output that a table shows."""


def text_table(rows: Iterable[Row], main: str) -> str:
    """One block per part and output, `main` first: all records together, and of `main`
    the worst. A diverged row says so instead of figures."""
    blocks: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        blocks.setdefault((row.part, row.output), []).append(row)
    order = sorted(blocks, key=lambda key: key[0] != main)
    return "\n\n".join(
        _block(_rows_to_show(blocks[key], SHOWN_RECORDS if key[0] == main else 0))
        for key in order
    )


def _rows_to_show(rows: list[Row], most: int) -> list[Row]:
    """Pooled rows, then the records with the largest errors in free run."""
    pooled = [r for r in rows if r.record == POOLED_NAME]
    single = [r for r in rows if r.record != POOLED_NAME]
    errors = {r.record: _size(r) for r in single if r.mode == FREE_RUN}
    worst = sorted(errors, key=lambda name: -errors[name])
    if len(worst) < 2:
        return pooled
    chosen = worst[:most]
    return pooled + [r for name in chosen for r in single if r.record == name]


def _size(row: Row) -> float:
    if row.diverged:
        return math.inf
    return -1.0 if row.rmse is None else row.rmse


def rows_beside(report: Any) -> list[tuple[str, list[Row | None]]]:
    """This model and those beside it: (name, pooled free-run row of every output)."""
    own = [report.pooled_row(c.name) for c in report.outputs]
    found = {"this model": own, **report.beside}
    return [
        (name, [{r.output: r for r in rows}.get(c.name) for c in report.outputs])
        for name, rows in found.items()
    ]


def comparison_lines(report: Any) -> list[str]:
    """NRMSE of the free run on the main part, this model and those beside it."""
    if not report.beside:
        return []
    lines = [("", *(c.name for c in report.outputs))]
    lines += [(name, *map(_nrmse, rows)) for name, rows in rows_beside(report)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    out = [
        "  ".join(
            [line[0].ljust(widths[0])]
            + [c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True)]
        )
        for line in lines
    ]
    return [
        "",
        f"free run beside other models, NRMSE on {name_data(report.main)}",
        *out,
        "",
    ]


def _nrmse(row: Row | None) -> str:
    if row is None:
        return "-"
    if row.diverged or row.nrmse is None:
        return row.status
    text = number(row.nrmse)
    return ratio_text(row.nrmse) if text.isdigit() else text


def _block(rows: list[Row]) -> str:
    first = rows[0]
    label = f"{first.output} [{first.unit}]" if first.unit else first.output
    by_record: dict[str, list[Row]] = {}
    for row in rows:
        by_record.setdefault(row.record, []).append(row)
    lines: list[tuple[str, ...]] = [TABLE_HEADER]
    for record, group in by_record.items():
        for i, row in enumerate(group):
            lines.append((_short(record) if i == 0 else "", row.mode, *_cells(row)))
    return f"{label}, {name_data(first.part)}\n" + _align(lines)


def _cells(row: Row) -> tuple[str, ...]:
    counts = (str(row.samples), str(row.limited) if row.limited else "")
    if row.diverged:
        return (row.status, *MISSING_FIGURES, *counts)
    figures = (row.rmse, row.nrmse, row.r2)
    return (
        *map(number, figures),
        number(row.fit, ".1f"),
        number(row.nmse),
        number(row.total_error, "+.2f"),
        *counts,
    )


def _align(lines: list[tuple[str, ...]]) -> str:
    """Text left, figures right; a status may run over the empty cells beside it."""
    spilling = [cells[FIGURE_COLUMNS][1:] == MISSING_FIGURES for cells in lines]
    widths = [
        max(
            len(cells[i])
            for cells, spills in zip(lines, spilling, strict=True)
            if not (spills and i == 2)
        )
        for i in range(len(TABLE_HEADER))
    ]
    free = sum(widths[FIGURE_COLUMNS]) + 2 * len(MISSING_FIGURES)
    out = []
    for cells, spills in zip(lines, spilling, strict=True):
        left = [c.ljust(w) for c, w in zip(cells[:2], widths[:2], strict=True)]
        right = [c.rjust(w) for c, w in zip(cells, widths, strict=True)]
        middle = [cells[2].rjust(free)] if spills else right[FIGURE_COLUMNS]
        out.append("  ".join(left + middle + right[FIGURE_COLUMNS.stop :]).rstrip())
    rule = "-" * max(map(len, out))
    return "\n".join([rule, out[0], rule, *out[1:], rule])


def _short(name: str, width: int = 24) -> str:
    printable = "".join(c if c.isprintable() else " " for c in name)
    return printable if len(printable) <= width else printable[: width - 1] + "…"


def strict(value: Any) -> Any:
    """`value` in lists, dicts, text, numbers and None; `inf` as text, NaN as None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {f.name: strict(getattr(value, f.name)) for f in fields}
    if isinstance(value, Mapping):
        return {str(key): strict(item) for key, item in value.items()}
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return _real(float(value))
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, Sequence | set | frozenset):
        return [strict(item) for item in value]
    if isinstance(value, np.ndarray | jax.Array):
        return strict(np.asarray(value).tolist())
    return str(value)


def _real(value: float) -> float | str | None:
    if math.isnan(value):
        return None
    return value if math.isfinite(value) else ("inf" if value > 0 else "-inf")
