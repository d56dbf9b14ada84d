"""One CSV file: its layout found out and checked, its wanted columns read."""

import codecs
import csv
import dataclasses
import mmap
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from jaxnarx.data.columns import DECIMAL_COMMA, Table
from jaxnarx.data.place import Place
from jaxnarx.errors import DataFileError, SpecError, suggest

_HEAD = 1 << 16
_CHUNK = 1 << 24
_NULLS = ["", "NaN", "nan", "NAN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL"]


@dataclasses.dataclass(frozen=True)
class CsvLayout:
    """How the CSV files of a description are written; `None` and "" are found out.

    `columns` names the columns of files without a header line; `skip_rows` lines stand
    before the header; `unit_row` says that a line of units follows it.
    """

    columns: tuple[str, ...] = ()
    decimal: str = "."
    delimiter: str = ""
    encoding: str = "utf-8"
    skip_rows: int = 0
    unit_row: bool = False


@dataclasses.dataclass(frozen=True)
class _Head:
    """The beginning of a file: its lines, delimiter, column names and data start."""

    path: Path
    lines: list[str]
    delimiter: str
    names: list[str]
    first: int

    def fields(self, line: int) -> list[str]:
        text = self.lines[line] if line < len(self.lines) else ""
        return next(csv.reader([text], delimiter=self.delimiter), [])

    def error(self, what: str) -> DataFileError:
        """`what`, followed by the first lines as they are."""
        shown = "\n".join(f"  {i + 1}: {s[:76]}" for i, s in enumerate(self.lines[:4]))
        return DataFileError(
            f"{self.path}: {what} The file begins:\n{shown}", path=self.path
        )


def read_csv(
    path: Path, wanted: Sequence[str], layout: CsvLayout, *, max_bytes: float
) -> Table:
    """The `wanted` columns of a CSV file.

    Rows are counted as an editor shows them: the first line of the file is 1, header
    included. Raises DataFileError, with the first lines, where the layout is not as
    `layout` says or cannot be made out.
    """
    head = _inspect(path, wanted, layout)
    _require_size(head, len(wanted), max_bytes)
    table = _parse(head, wanted, layout)
    units = {}
    if layout.unit_row:
        fields = head.fields(head.first - 1)
        units = {n: u.strip() for n, u in zip(head.names, fields, strict=False)}
    place = Place(str(path), head.first + 1, ", counted from 1 with the header line")
    if layout.columns:
        place = dataclasses.replace(place, counting=", counted from 1")
    columns = dict(zip(wanted, table.columns, strict=True))
    return Table(columns, place, units)


def _inspect(path: Path, wanted: Sequence[str], layout: CsvLayout) -> _Head:
    lines = _lines(path, layout.encoding)
    body = [s for s in lines[layout.skip_rows :] if s.strip()]
    if not body:
        raise DataFileError(f"{path}: the file is empty.", path=path)
    delimiter = layout.delimiter or _delimiter(body)
    first = layout.skip_rows + (not layout.columns) + layout.unit_row
    head = _Head(path, lines, delimiter, [], first)
    names = list(layout.columns) or [s.strip() for s in head.fields(layout.skip_rows)]
    head = dataclasses.replace(head, names=names)
    _require_header(head, wanted, layout)
    _require_columns(head, wanted)
    if len(lines) <= first or not any(s.strip() for s in lines[first:]):
        raise head.error("the file has no data rows.")
    _require_numbers(head, wanted, layout)
    return head


def _lines(path: Path, encoding: str) -> list[str]:
    with path.open("rb") as file:
        raw = file.read(_HEAD)
        whole = len(raw) < _HEAD
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        if not encoding.lower().replace("_", "-").startswith("utf-16"):
            raise DataFileError(
                f'{path}: the file is UTF-16. State encoding = "utf-16".', path=path
            )
    elif not whole and b"\n" in raw:
        raw = raw[: raw.rindex(b"\n") + 1]
    if raw.startswith(codecs.BOM_UTF8):
        raw = raw[len(codecs.BOM_UTF8) :]
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError as error:
        raise _encoding_error(path, raw, encoding, error.start) from None
    except LookupError:
        raise SpecError(f"unknown encoding {encoding!r}", field="encoding") from None
    if "\0" in text:
        raise DataFileError(f"{path}: binary data, not a CSV file.", path=path)
    return [s.rstrip("\r") for s in text.removesuffix("\n").split("\n")]


def _encoding_error(path, raw, encoding, start) -> DataFileError:
    line = raw[:start].count(b"\n") + 1
    around = (
        raw[max(start - 10, 0) : start + 10].split(b"\n")[0].decode("cp1252", "replace")
    )
    return DataFileError(
        f"{path}: line {line} is not {encoding} (byte 0x{raw[start]:02X}). It looks "
        f"like Windows-1252, where it reads {around.strip()!r}: state "
        'encoding = "cp1252".',
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


def _is_number(text: str, decimal: str = ".") -> bool:
    try:
        float(text.strip().replace(decimal, "."))
    except ValueError:
        return False
    return True


def _require_header(head: _Head, wanted, layout: CsvLayout):
    fields = [s.strip() for s in head.fields(layout.skip_rows)]
    if not layout.columns:
        if all(_is_number(s, layout.decimal) for s in fields if s):
            raise head.error(
                "the first line holds numbers, so there is no header line. Name the "
                "columns in order by columns = [...]."
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
    words = [s for s in top if s.strip() and not _is_number(s, layout.decimal)]
    numeric = all(_is_number(s, layout.decimal) for s in below if s.strip())
    if words and len(words) == sum(bool(s.strip()) for s in top) and numeric:
        raise head.error(
            f"line {head.first + 1} looks like a row of units "
            f"({', '.join(words[:4])}). State unit_row = true."
        )


def _require_size(head: _Head, columns: int, max_bytes: float):
    """Count lines, and refuse the file before it is read if it would not fit."""
    path = head.path
    size = path.stat().st_size
    with path.open("rb") as file, _mapped(file) as m:
        rows = sum(
            m[at : at + _CHUNK].count(b"\n")
            for at in range(0, size if size <= max_bytes else 0, _CHUNK)
        )
        expanded = max(size, 8 * columns * rows)
        if expanded > max_bytes:
            raise DataFileError(
                f"{path}: about {expanded / 1e9:.3g} GB when read, over the limit of "
                f"{max_bytes / 1e9:.3g} GB. Read fewer files or channels, or raise "
                "max_bytes.",
                path=path,
            )
        _require_no_blank(head, m)


def _require_no_blank(head: _Head, m: mmap.mmap):
    """An empty line between rows may be a gap in time, and would shift row numbers."""
    begin = 0
    for _ in range(head.first):
        begin = m.find(b"\n", begin) + 1
    for blank in (b"\n\n", b"\n\r\n"):
        at = m.find(blank, begin)
        if at >= 0 and m[at:].strip():
            line = m[:at].count(b"\n") + 2
            raise DataFileError(
                f"{head.path}: line {line} is empty. Remove it, or, if it separates "
                "two runs, put them in two files.",
                path=head.path,
            )


def _mapped(file: BinaryIO) -> mmap.mmap:
    return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def _parse(head: _Head, wanted: Sequence[str], layout: CsvLayout):
    import pyarrow as pa
    import pyarrow.csv as reader

    keys = [str(i) for i in range(len(head.names))]
    try:
        return reader.read_csv(
            str(head.path),
            reader.ReadOptions(
                column_names=keys, skip_rows=head.first, encoding=layout.encoding
            ),
            reader.ParseOptions(delimiter=head.delimiter),
            reader.ConvertOptions(
                include_columns=[str(head.names.index(n)) for n in wanted],
                decimal_point=layout.decimal,
                null_values=_NULLS,
                strings_can_be_null=True,
            ),
        )
    except (pa.ArrowInvalid, UnicodeDecodeError) as error:
        raise _explain(head, layout, error) from error


def _explain(head: _Head, layout: CsvLayout, error: Exception):
    """Find the line that pyarrow stumbled over; slow, but only on the way out."""
    path, count = head.path, len(head.names)
    raw = path.read_bytes()
    try:
        text = raw.decode(layout.encoding)
    except UnicodeDecodeError as bad:
        return _encoding_error(path, raw, layout.encoding, bad.start)
    rows = csv.reader(text.split("\n"), delimiter=head.delimiter)
    for fields in rows:
        if rows.line_num > head.first and fields and len(fields) != count:
            return DataFileError(
                f"{path}: line {rows.line_num} has {len(fields)} fields, expected "
                f"{count}: {head.delimiter.join(fields)[:60]!r}. Correct or remove "
                "the line (a run that was cut off often ends in half a line).",
                path=path,
            )
    return head.error(f"the file cannot be read as CSV ({error}).")
