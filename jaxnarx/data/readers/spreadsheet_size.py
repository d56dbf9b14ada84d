"""Cells that a spreadsheet would take in memory, counted before it is unfolded.

A reader makes the whole rectangle up to the farthest cell, so one cell in XFD1048576
would allocate 549 GB from 5 kB of file; OpenDocument repeats rows and cells by a
number. Binary workbooks (`xls`, `xlsb`) are not looked into: the reader's own process
bounds them.
"""

import re
import zipfile
from collections.abc import Iterator
from pathlib import Path

_CHUNK, _OVERLAP = 1 << 20, 4096
"""Bytes of a part that are looked at together, and those looked at twice."""
_PLACE = re.compile(rb'<(?:\w+:)?c [^>]*?r="([A-Z]{1,3})(\d{1,7})"')
_OPEN = re.compile(
    rb"<table:(table|table-row|table-cell|covered-table-cell)(?=[\s/>])([^>]*)>"
)
_ROWS = re.compile(rb'number-rows-repeated="(\d+)"')
_COLUMNS = re.compile(rb'number-columns-repeated="(\d+)"')


def count_cells(path: Path) -> int:
    """Cells of the rectangles of all sheets; 0 where that is not known."""
    if not zipfile.is_zipfile(path):
        return 0
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        if "content.xml" in names:
            return _repeated_rectangles(archive, "content.xml")
        return sum(
            _rectangle(archive, name)
            for name in names
            if re.fullmatch(r"xl/worksheets/[^/]*\.xml", name)
        )


def _rectangle(archive: zipfile.ZipFile, name: str) -> int:
    """Rows times columns up to the farthest cell of a sheet."""
    columns: set[bytes] = set()
    rows: set[bytes] = {b"0"}
    for chunk in _chunks(archive, name):
        places = _PLACE.findall(chunk)
        columns |= {letters for letters, _ in places}
        rows |= {row for _, row in places}
    return max(map(int, rows)) * max(map(_column_number, columns), default=0)


def _column_number(letters: bytes) -> int:
    number = 0
    for letter in letters:
        number = 26 * number + letter - 64
    return number


def _repeated_rectangles(archive: zipfile.ZipFile, name: str) -> int:
    """Rows times columns up to the farthest cell with a value, over all sheets."""
    total = row = rows = column = last_row = last_column = 0
    for chunk in _chunks(archive, name, overlap=0):
        for kind, attributes in _OPEN.findall(chunk):
            if kind == b"table":
                total += last_row * last_column
                row = rows = last_row = last_column = 0
            elif kind == b"table-row":
                row, rows, column = row + rows, _number(_ROWS, attributes), 0
            else:
                column += _number(_COLUMNS, attributes)
                if b"value-type=" in attributes:
                    last_row, last_column = row + rows, max(last_column, column)
    return total + last_row * last_column


def _number(pattern: re.Pattern[bytes], attributes: bytes) -> int:
    found = pattern.search(attributes)
    return int(found[1]) if found else 1


def _chunks(
    archive: zipfile.ZipFile, name: str, overlap: int = _OVERLAP
) -> Iterator[bytes]:
    """A part of an archive piece by piece; without overlap, cut where a tag begins."""
    kept = b""
    with archive.open(name) as part:
        while chunk := part.read(_CHUNK):
            chunk = kept + chunk
            cut = len(chunk) - overlap if overlap else chunk.rfind(b"<")
            kept = chunk[max(cut, 0) :]
            yield chunk if overlap else chunk[: max(cut, 0)]
    yield kept
