"""One CSV file: its layout found out and checked, its wanted columns read."""

import codecs
import csv
import dataclasses
import itertools
import mmap
import re
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from jaxnarx.data.readers.columns import (
    DECIMAL_COMMA,
    Asked,
    Column,
    CsvLayout,
    Table,
    is_number,
    require_limit,
)
from jaxnarx.data.record import RowSource
from jaxnarx.errors import DataFileError, suggest

_HEAD_BYTES = 1 << 17  # fields of more characters are beyond what the csv module cuts
_BLOCK_BYTES = 1 << 20
_CHUNK_BYTES = 1 << 24
_LINE_END = re.compile(r"\r*\n|\r")
"""Line ends of any system, mixed ones too; \\r\\r\\n is one line end that was converted
twice."""
_LINE_ENDS = re.compile(rb"\r*\n|\r")
_EMPTY_LINE = re.compile(rb"\n[\r\n]|\r\r+(?!\r*\n)")
_NULL_WORDS = [
    "",
    "NaN",
    "nan",
    "NAN",
    "-nan",
    "NA",
    "N/A",
    "n/a",
    "#N/A",
    "null",
    "NULL",
]


@dataclasses.dataclass(frozen=True)
class _Head:
    """The beginning of a file: its lines, delimiter, column names, first data line, and
    how many lines pyarrow has to skip for it.
    """

    path: Path
    lines: list[str]
    delimiter: str
    names: list[str]
    first: int
    skip: int

    def fields(self, line: int) -> list[str]:
        """The fields of a line, counted from 0; none beyond the head's lines."""
        return self.cut(line, self.lines[line]) if line < len(self.lines) else []

    def cut(self, line: int, text: str) -> list[str]:
        try:
            return next(csv.reader([text], delimiter=self.delimiter), [])
        except csv.Error as error:
            raise self.row_error(
                line, f"cannot be cut into fields ({error})", text
            ) from None

    def row_error(self, line: int, what: str, text: str) -> DataFileError:
        return DataFileError(
            f"{self.path}: line {line + 1} {what}: {text[:60]!r}. Correct or remove "
            "the line (a run that was cut off often ends in half a line).",
            path=self.path,
        )

    def error(self, what: str) -> DataFileError:
        """`what`, followed by the first lines as they are."""
        shown = "\n".join(f"  {i + 1}: {s[:76]}" for i, s in enumerate(self.lines[:4]))
        return DataFileError(
            f"{self.path}: {what} The file begins:\n{shown}", path=self.path
        )


def contents(path: Path, asked: Asked) -> list[Column]:
    """Every column of the header, with the unit of a line of units."""
    head = _inspect(path, [], asked.layout)
    units = _units(head, asked.layout)
    with path.open("rb") as file, _map_file(file) as m:
        rows = sum(
            _line_ends(m[at : at + _CHUNK_BYTES])
            for at in range(0, len(m), _CHUNK_BYTES)
        )
    rows = max(rows - head.first, 0)
    return [Column(n, units.get(n, ""), rows=rows) for n in head.names if n]


def read(path: Path, wanted: Sequence[str], asked: Asked) -> Table:
    """The `wanted` columns of a CSV file.

    Rows are counted as an editor shows them: the first line of the file is 1, header
    included. Raises DataFileError, with the first lines, where the layout is not as
    `layout` says or cannot be made out.
    """
    layout = asked.layout
    head = _inspect(path, wanted, layout)
    _require_size(head, len(wanted), asked.max_bytes)
    table = _parse(head, wanted, layout)
    place = RowSource(
        str(path), head.first + 1, ", counted from 1 with the header line"
    )
    if layout.columns:
        place = dataclasses.replace(place, counting=", counted from 1")
    columns = dict(zip(wanted, table.columns, strict=True))
    return Table(columns, place, _units(head, layout))


def _units(head: _Head, layout: CsvLayout) -> dict[str, str]:
    """Units by column, where a line of units follows the header."""
    if not layout.unit_row:
        return {}
    fields = head.fields(head.first - 1)
    return {n: u.strip() for n, u in zip(head.names, fields, strict=False)}


def _inspect(path: Path, wanted: Sequence[str], layout: CsvLayout) -> _Head:
    first = layout.skip_rows + (not layout.columns) + layout.unit_row
    lines, skip = _lines(path, layout.encoding, first)
    body = [s for s in lines[layout.skip_rows :] if s.strip()]
    if not body:
        raise DataFileError(f"{path}: the file is empty.", path=path)
    delimiter = layout.delimiter or _delimiter(body)
    head = _Head(path, lines, delimiter, [], first, skip)
    names = list(layout.columns) or [s.strip() for s in head.fields(layout.skip_rows)]
    head = dataclasses.replace(head, names=names)
    _require_header(head, wanted, layout)
    _require_columns(head, wanted)
    if len(lines) <= first or not any(s.strip() for s in lines[first:]):
        raise head.error("the file has no data rows.")
    _require_numbers(head, wanted, layout)
    return head


def _lines(path: Path, encoding: str, first: int) -> tuple[list[str], int]:
    """The whole lines of the head, and as how many pyarrow counts the first ones."""
    with path.open("rb") as file:
        raw = file.read(_HEAD_BYTES)
        whole = len(raw) < _HEAD_BYTES
    utf16 = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if utf16 and not re.match("utf[-_]?(16|32)", encoding, re.IGNORECASE):
        raise DataFileError(
            f'{path}: the file is UTF-16. State encoding = "utf-16".', path=path
        )
    raw = raw.removeprefix(codecs.BOM_UTF8)
    text = _decode(path, raw, encoding, whole=whole)
    if "\0" in text:
        raise DataFileError(f"{path}: binary data, not a CSV file.", path=path)
    lines = _LINE_END.split(text)
    if not (whole and lines[-1]):
        lines.pop()
    if not whole and len(lines) <= first:
        raise DataFileError(
            f"{path}: no line of data in the first {_HEAD_BYTES:,} bytes; line "
            f"{len(lines) + 1} goes on behind them. Correct skip_rows, or the line "
            "ends of the file.",
            path=path,
        )
    ends = _LINE_END.findall(text)[:first]
    return lines, sum(max(1, end.count("\r")) for end in ends)


def _decode(path: Path, raw: bytes, encoding: str, *, whole: bool = True) -> str:
    """`raw` as text; a character cut in two at the end is left out if not `whole`."""
    try:
        return codecs.getincrementaldecoder(encoding)().decode(raw, whole)
    except UnicodeDecodeError as error:
        raise _encoding_error(path, raw, encoding, error.start) from None
    except UnicodeError as error:
        raise DataFileError(
            f"{path}: the file is not {encoding} ({error}). State the encoding it was "
            "written in.",
            path=path,
        ) from None


def _encoding_error(path, raw, encoding, start) -> DataFileError:
    line = len(_LINE_ENDS.findall(raw, 0, start)) + 1
    around = raw[max(start - 10, 0) : start + 10].split(b"\n")[0].strip()
    advice = "State the encoding it was written in."
    if codecs.lookup(encoding).name == "utf-8":
        advice = (
            "It looks like Windows-1252, where it reads "
            f'{around.decode("cp1252", "replace")!r}: state encoding = "cp1252".'
        )
    return DataFileError(
        f"{path}: line {line} is not {encoding} (byte 0x"
        f"{raw[start : start + 1].hex().upper()}). {advice}",
        path=path,
    )


def _delimiter(body: list[str]) -> str:
    """The character that cuts all first lines into equally many fields."""
    sample = body[1:8] or body
    for mark in (";", "\t"):
        counts = {s.count(mark) for s in sample}
        if len(counts) == 1 and counts != {0}:
            return mark
    return ","


def _require_header(head: _Head, wanted, layout: CsvLayout):
    fields = [s.strip() for s in head.fields(layout.skip_rows)]
    if not layout.columns:
        if all(is_number(s, layout.decimal) for s in fields if s):
            raise head.error(
                "the first line holds numbers, so there is no header line. Name the "
                "columns in order by columns = [...] in the description, or by "
                "--columns of `jaxnarx describe`."
            )
    elif set(fields) & set(wanted):
        raise head.error(
            "the first line is a header, but columns = [...] says there is none. "
            "Leave out columns, or skip the line by skip_rows = 1."
        )
    elif len(fields) != len(layout.columns):
        raise head.error(
            f"line {layout.skip_rows + 1} has {len(fields)} fields at delimiter "
            f"{head.delimiter!r}, but columns = [...] names {len(layout.columns)}."
            + _comma_hint(fields, layout)
        )


def _comma_hint(fields, layout: CsvLayout) -> str:
    if layout.decimal == "." and any(DECIMAL_COMMA.fullmatch(s) for s in fields):
        return ' Numbers seem to have a decimal comma: state decimal = ",".'
    return ""


def _require_columns(head: _Head, wanted: Sequence[str]):
    for name in wanted:
        count = head.names.count(name)
        if count > 1:
            raise head.error(f"{count} columns are named {name!r}. Rename all but one.")
        if not count:
            what = f"there is no column {name!r}. {suggest(name, head.names)}"
            if len(head.names) == 1:
                what += (
                    f" At delimiter {head.delimiter!r} the header is one field; state "
                    "the delimiter."
                )
            raise head.error(what)


def _require_numbers(head: _Head, wanted, layout: CsvLayout):
    """Find a decimal comma, a row of units or ragged rows before reading starts."""
    rows = [
        head.fields(i) for i in range(head.first, min(head.first + 8, len(head.lines)))
    ]
    rows = [r for r in rows if r]
    for fields in rows:
        hint = _comma_hint(fields, layout)
        if hint:
            raise head.error(hint.strip())
        if len(fields) == 2 * len(head.names) and head.delimiter == ",":
            raise head.error(
                f"a row has {len(fields)} fields under {len(head.names)} names. If the "
                "numbers have a decimal comma, export the file with another delimiter, "
                'such as ";", and state decimal = ",".'
            )
    if layout.unit_row or len(rows) < 2:
        return
    at = [head.names.index(n) for n in wanted]
    top, below = ([r[i] for i in at if i < len(r)] for r in rows[:2])
    words = [s for s in top if s.strip() and not is_number(s, layout.decimal)]
    numeric = all(is_number(s, layout.decimal) for s in below if s.strip())
    if words and len(words) == sum(bool(s.strip()) for s in top) and numeric:
        raise head.error(
            f"line {head.first + 1} looks like a row of units "
            f"({', '.join(words[:4])}). State unit_row = true."
        )


def _require_size(head: _Head, columns: int, max_bytes: float):
    """Count lines, and refuse the file before it is read if it would not fit."""
    path = head.path
    size = path.stat().st_size
    with path.open("rb") as file, _map_file(file) as m:
        chunks = range(0, size if size <= max_bytes else 0, _CHUNK_BYTES)
        rows = sum(_line_ends(m[at : at + _CHUNK_BYTES]) for at in chunks)
        require_limit(path, max(size, 8 * columns * rows), max_bytes)
        _require_no_blank(head, m)


def _line_ends(raw: bytes) -> int:
    return raw.count(b"\n") + raw.count(b"\r") - raw.count(b"\r\n")


def _require_no_blank(head: _Head, m: mmap.mmap):
    """An empty line between rows may be a gap in time, and would shift row numbers."""
    ends = itertools.islice(_LINE_ENDS.finditer(m), head.first)
    begin = max((end.end() for end in ends), default=0)
    # these are quick to look for, and the slower look is rarely needed
    if all(m.find(pair, begin) < 0 for pair in (b"\n\n", b"\n\r", b"\r\r")):
        return
    empty = _EMPTY_LINE.search(m, begin)
    if empty and re.compile(rb"\S").search(m, empty.start()):
        line = len(_LINE_ENDS.findall(m, 0, empty.start() + 1)) + 1
        raise DataFileError(
            f"{head.path}: line {line} is empty. Remove it, or, if it separates "
            "two runs, put them in two files.",
            path=head.path,
        )


def _map_file(file: BinaryIO) -> mmap.mmap:
    return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def _parse(head: _Head, wanted: Sequence[str], layout: CsvLayout):
    import pyarrow as pa
    import pyarrow.csv as reader

    keys = [str(i) for i in range(len(head.names))]
    try:
        return reader.read_csv(
            str(head.path),
            reader.ReadOptions(
                column_names=keys,
                skip_rows=head.skip,
                encoding=layout.encoding,
                block_size=_BLOCK_BYTES,
            ),
            reader.ParseOptions(delimiter=head.delimiter),
            reader.ConvertOptions(
                include_columns=[str(head.names.index(n)) for n in wanted],
                decimal_point=layout.decimal,
                null_values=_NULL_WORDS,
                strings_can_be_null=True,
            ),
        )
    except (pa.ArrowInvalid, UnicodeError) as error:
        raise _explain(head, layout, error) from error


def _explain(head: _Head, layout: CsvLayout, error: Exception) -> DataFileError:
    """Find the line that pyarrow stumbled over; slow, but only on the way out."""
    text = _decode(head.path, head.path.read_bytes(), layout.encoding)
    lines = enumerate(_LINE_END.split(text))
    for n, line in itertools.islice(lines, head.first, None):
        fields = head.cut(n, line)
        if fields and len(fields) != len(head.names):
            what = f"has {len(fields)} fields, expected {len(head.names)}"
            return head.row_error(n, what, line)
        if len(line) > _BLOCK_BYTES:
            return head.row_error(n, f"is {len(line):,} characters long", line)
    return head.error(f"the file cannot be read as CSV ({error}).")
