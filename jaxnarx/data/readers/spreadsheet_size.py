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

_CHUNK_BYTES = 1 << 20
"""Bytes of a part that are looked at together."""
_TAG_PATTERN = re.compile(rb"<(?:\w+:)?(row|c)(?=[\s/>])([^>]*)>")
_PLACE_PATTERN = re.compile(rb"""\sr\s*=\s*["']([A-Z]{0,3})(\d{1,7})["']""")
_OPEN_PATTERN = re.compile(
    rb"<table:(table|table-row|table-cell|covered-table-cell)(?=[\s/>])([^>]*)>"
)
_ROWS_PATTERN = re.compile(rb"""number-rows-repeated\s*=\s*["'](\d+)""")
_COLUMNS_PATTERN = re.compile(rb"""number-columns-repeated\s*=\s*["'](\d+)""")


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
    """Rows times columns up to the farthest cell of a sheet.

    A row or cell that does not tell its place is the one behind the last.
    """
    row = column = last_row = last_column = 0
    for chunk in _chunks(archive, name):
        for kind, attributes in _TAG_PATTERN.findall(chunk):
            place = _PLACE_PATTERN.search(attributes)
            if kind == b"row":
                row, column = int(place[2]) if place else row + 1, 0
                continue
            if place is None:
                column += 1
            else:
                row, column = int(place[2]), _column_number(place[1])
            last_row, last_column = max(last_row, row), max(last_column, column)
    return last_row * last_column


def _column_number(letters: bytes) -> int:
    number = 0
    for letter in letters:
        number = 26 * number + letter - 64
    return number


def _repeated_rectangles(archive: zipfile.ZipFile, name: str) -> int:
    """Rows times columns up to the farthest cell with a value, over all sheets."""
    total = row = rows = column = last_row = last_column = 0
    for chunk in _chunks(archive, name):
        for kind, attributes in _OPEN_PATTERN.findall(chunk):
            if kind == b"table":
                total += last_row * last_column
                row = rows = last_row = last_column = 0
            elif kind == b"table-row":
                row, rows, column = row + rows, _number(_ROWS_PATTERN, attributes), 0
            else:
                column += _number(_COLUMNS_PATTERN, attributes)
                if b"value-type=" in attributes:
                    last_row, last_column = row + rows, max(last_column, column)
    return total + last_row * last_column


def _number(pattern: re.Pattern[bytes], attributes: bytes) -> int:
    found = pattern.search(attributes)
    return int(found[1]) if found else 1


def _chunks(archive: zipfile.ZipFile, name: str) -> Iterator[bytes]:
    """A part of an archive piece by piece, cut where a tag begins."""
    kept = b""
    with archive.open(name) as part:
        while chunk := part.read(_CHUNK_BYTES):
            chunk = kept + chunk
            cut = max(chunk.rfind(b"<"), 0)
            kept = chunk[cut:]
            yield chunk[:cut]
    yield kept
