"""The layout of a CSV file, found out: encoding, decimal mark, delimiter, where names,
units and numbers begin.

Test benches write a block of lines about the run, then names, then units, then numbers
(INCA, CANape, AVL, dSPACE), with a comma or a point. The layout with which most of the
lines are rows of as many numbers is taken; the line above them that has as many fields
and names them all differently is the header.
"""

import codecs
import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from jaxnarx.data.readers.columns import CsvLayout, is_number

_HEAD_BYTES = 1 << 18
_ANALYSED_LINES = 400
"""Lines that are looked at."""
_DELIMITER_PAIRS = (
    (";", ","),
    ("\t", ","),
    (";", "."),
    ("\t", "."),
    (",", "."),
    ("|", "."),
)
"""Delimiters and decimal marks; of those that serve as well the first is taken."""
_LEAST_BODY_ROWS = 3
"""Rows of numbers that are needed."""


def find_layout(path: Path) -> CsvLayout | None:
    """The layout of a file; None where no lines of numbers are found.

    Names that two lines could give are those of the upper one, the lower are units.
    """
    with path.open("rb") as file:
        raw = file.read(_HEAD_BYTES)
    encoding, text = _decode(raw)
    lines = text.splitlines()
    if len(raw) == _HEAD_BYTES:
        lines = lines[:-1]
    lines = lines[:_ANALYSED_LINES]
    best: tuple[int, CsvLayout] | None = None
    for delimiter, decimal in _DELIMITER_PAIRS:
        rows = [_fields(line, delimiter) for line in lines]
        found = _body(rows, decimal)
        if found is None:
            continue
        first, width, numbers = found
        if decimal == "," and not any("," in x for row in rows[first:] for x in row):
            continue
        layout = _find_header(rows, first, width, decimal)
        if layout is None:
            continue
        skip, unit_row = layout
        if best is None or numbers > best[0]:
            made = CsvLayout((), decimal, delimiter, encoding, skip, unit_row)
            best = numbers, made
    return None if best is None else best[1]


def _decode(raw: bytes) -> tuple[str, str]:
    """Name of the encoding, and the text without what was cut at its end."""
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16", raw.decode("utf-16", "ignore")
    try:
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(raw, False)
        return "utf-8", text
    except UnicodeDecodeError:
        return "cp1252", raw.decode("cp1252", "replace")


def _fields(line: str, delimiter: str) -> list[str]:
    try:
        fields = next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return []
    return [field.strip() for field in fields]


def _body(rows: Sequence[Sequence[str]], decimal: str) -> tuple[int, int, int] | None:
    """First row, number of fields and number of numbers of the rows at the end that
    hold as many fields, of which one is a number at least."""
    last = len(rows)
    while last and not any(rows[last - 1]):
        last -= 1
    if not last:
        return None
    width = len(rows[last - 1])
    first, numbers = last, 0
    for k in range(last - 1, -1, -1):
        count = sum(_is_number(x, decimal) for x in rows[k])
        filled = sum(bool(x) for x in rows[k])
        if len(rows[k]) != width or 2 * count < filled or not count:
            break
        first, numbers = k, numbers + count
    if last - first < _LEAST_BODY_ROWS:
        return None
    return first, width, numbers


def _is_number(text: str, decimal: str) -> bool:
    if decimal == "," and "." in text:
        return False
    return is_number(text, decimal) and text.lower() not in ("nan", "inf", "-inf")


def _find_header(
    rows: Sequence[Sequence[str]], first: int, width: int, decimal: str
) -> tuple[int, bool] | None:
    """Lines before the header, and whether units are between it and the numbers."""

    def names(fields: Iterable[str]) -> bool:
        fields = list(fields)
        given = [x for x in fields if x]
        return (
            len(fields) == width
            and len(given) >= max(1, width - 1)
            and len(set(given)) == len(given)
            and not any(_is_number(x, decimal) for x in given)
        )

    if first >= 2 and names(rows[first - 2]):
        units = rows[first - 1]
        if len(units) == width and not any(_is_number(x, decimal) for x in units if x):
            return first - 2, True
    if first >= 1 and names(rows[first - 1]):
        return first - 1, False
    return None
