"""Cells of Excel and OpenDocument files, by python-calamine; see `spreadsheet`.

Runs in a process of its own: a damaged file may abort the reader.
"""

import dataclasses
import datetime
import zipfile
from pathlib import Path
from typing import Any

from jaxnarx.data.readers.columns import (
    MOST_TIMES,
    SMALL_BYTES,
    Asked,
    CsvLayout,
    is_number,
    require_limit,
    require_size,
)
from jaxnarx.data.readers.spreadsheet_size import count_cells
from jaxnarx.errors import DataFileError, suggest

_MAX_EXPANSION = 200
"""A file that unfolds to more times its size is taken for a bomb."""
_CELL_BYTES = 64
"""Bytes of a cell in memory while a sheet is read."""
_CELL_TEXT_BYTES = 40
"""Bytes of a number as text in a sheet, with its place."""


def contents(path: Path, folder: Path, **given: Any) -> list[dict[str, Any]]:
    """Columns as keyword arguments of `Column`: all that are named, of every sheet."""
    asked = _read_settings(given)
    found = []
    for sheet, rows in _sheets(path, asked):
        names, units, body = _parts(path, sheet, rows, asked)
        for k, name in enumerate(names):
            if name:
                text = any(isinstance(row[k], str) and row[k] for row in body[:100])
                column = {"name": name, "unit": units.get(name, "")}
                column |= {"rows": len(body), "table": sheet, "text": text}
                found.append(column)
    return found


def columns(
    path: Path, folder: Path, *, wanted: list[str], **given: Any
) -> dict[str, Any]:
    """The `wanted` columns of one sheet, as `cells.arrow` in the folder.

    Empty cells and errors are missing samples.
    """
    import pyarrow as pa

    asked = _read_settings(given)
    every = _sheets(path, asked)
    sheets = [(n, rows) for n, rows in every if rows and asked.table in ("", n)]
    if not sheets:
        names = [sheet for sheet, rows in every if rows]
        raise DataFileError(
            f"{path}: there is no sheet {asked.table!r} with cells. "
            f"{suggest(asked.table, names)}",
            path=path,
        )
    parts = [(sheet, *_parts(path, sheet, rows, asked)) for sheet, rows in sheets]
    having = [part for part in parts if set(wanted) <= set(part[1])]
    sheet, names, units, body = (having or parts)[0]
    if len(having) > 1:
        raise DataFileError(
            f"{path}: the sheets {', '.join(repr(p[0]) for p in having)} hold these "
            "columns. Say which by table = ... under [data].",
            path=path,
        )
    found: dict[str, Any] = {}
    for name in wanted:
        if names.count(name) != 1:
            what = f"there is no single column {name!r} in sheet {sheet!r}"
            raise DataFileError(
                f"{path}: {what}. {suggest(name, [n for n in names if n])}", path=path
            )
        k = names.index(name)
        found[name] = pa.array(_column([row[k] for row in body]))
    if not body:
        raise DataFileError(f"{path}: sheet {sheet!r} has no data rows.", path=path)
    first = asked.layout.skip_rows + (not asked.layout.columns) + bool(units) + 1
    table = pa.table(found)
    with pa.OSFile(str(folder / "cells.arrow"), "wb") as file:
        with pa.ipc.new_file(file, table.schema) as writer:
            writer.write_table(table)
    return {"sheet": sheet, "first": first, "units": units}


def _read_settings(given: dict[str, Any]) -> Asked:
    """The settings of the description, as they arrive here."""
    words: dict[str, Any] = given["layout"] | {
        "columns": tuple(given["layout"]["columns"])
    }
    layout = CsvLayout(**words)
    return dataclasses.replace(Asked(**given), layout=layout)


def _sheets(path: Path, asked: Asked) -> list[tuple[str, list[list[Any]]]]:
    """Name and rows of every sheet of cells."""
    import python_calamine as calamine

    _require_size(path, asked.max_bytes)
    try:
        with calamine.CalamineWorkbook.from_path(str(path)) as book:
            return [
                (name, book.get_sheet_by_name(name).to_python(skip_empty_area=False))
                for name in book.sheet_names
            ]
    except calamine.PasswordError:
        raise DataFileError(
            f"{path}: the file is protected by a password. Save it without one.",
            path=path,
        ) from None
    except (calamine.CalamineError, OSError, ValueError) as error:
        raise DataFileError(
            f"{path}: cannot be read as a spreadsheet ({error}). Save it anew.",
            path=path,
        ) from error


def _require_size(path: Path, max_bytes: float) -> None:
    """Refuse by what the archive says of itself, before it is unfolded."""
    size = path.stat().st_size
    expanded = size
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            expanded = sum(part.file_size for part in archive.infolist())
    require_limit(path, expanded / _CELL_TEXT_BYTES * 8, max_bytes)
    require_size(path, expanded, float("inf"), _MAX_EXPANSION)
    cells = count_cells(path)
    most = max(SMALL_BYTES, MOST_TIMES * size)
    if 8 * cells > max_bytes or _CELL_BYTES * cells > most:
        raise DataFileError(
            f"{path}: the sheets span {cells:,} cells, far more than a file of "
            f"{size:,} bytes can fill. Delete the cells that lie far from the data, or "
            "write it as CSV.",
            path=path,
        )


def _parts(
    path: Path, sheet: str, rows: list[list[Any]], asked: Asked
) -> tuple[list[str], dict[str, str], list[list[Any]]]:
    """Names, units by name, and the rows below; trailing empty rows are left out."""
    layout = asked.layout
    rows = rows[layout.skip_rows :]
    while rows and not any(_is_filled(x) for x in rows[-1]):
        rows.pop()
    if not rows:
        return [], {}, []
    if layout.columns:
        names = list(layout.columns)
        if len(rows[0]) < len(names):
            raise DataFileError(
                f"{path}, sheet {sheet}: rows have {len(rows[0])} cells, but columns = "
                f"[...] names {len(names)}.",
                path=path,
            )
    else:
        names, rows = [str(x).strip() for x in rows[0]], rows[1:]
    units = {}
    if rows and (layout.unit_row or _is_unit_row(rows)):
        units = {n: str(x).strip() for n, x in zip(names, rows[0], strict=False) if n}
        rows = rows[1:]
    return names, units, rows


def _is_filled(cell: Any) -> bool:
    return cell is not None and cell != ""


def _is_unit_row(rows: list[list[Any]]) -> bool:
    """Whether all that fills the first row is text, and numbers are below it."""
    if len(rows) < 2:
        return False
    top = [(k, x) for k, x in enumerate(rows[0]) if _is_filled(x)]
    texts = [(k, x) for k, x in top if isinstance(x, str) and not is_number(x)]
    numeric = [k for k, _ in texts if isinstance(rows[1][k], int | float)]
    return bool(texts) and len(texts) == len(top) and len(numeric) >= len(texts) / 2


def _column(cells: list[Any]) -> list[Any]:
    """Numbers, or where a cell is something else, what the cells say as one kind."""
    cells = [x if _is_filled(x) and not _is_error(x) else None for x in cells]
    known = [x for x in cells if x is not None]
    if all(isinstance(x, int | float) for x in known):
        return [None if x is None else float(x) for x in cells]
    kinds = {type(x) for x in known}
    moments = (datetime.datetime, datetime.date, datetime.time, datetime.timedelta)
    if len(kinds) == 1 and issubclass(kinds.pop(), moments):
        return cells
    return [None if x is None else str(x) for x in cells]


def _is_error(cell: Any) -> bool:
    """`#N/A` and its like."""
    return (
        isinstance(cell, str) and cell.startswith("#") and cell.rstrip("!?").isupper()
    )
