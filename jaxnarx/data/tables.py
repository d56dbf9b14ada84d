"""One data file of any kind, checked before it is read."""

from collections.abc import Sequence
from pathlib import Path

from jaxnarx.data.columns import Table, is_readable, is_text
from jaxnarx.data.csv_table import CsvLayout, read_csv
from jaxnarx.data.record import RowSource
from jaxnarx.errors import DataFileError, reading, suggest

_ARCHIVES = {
    b"PK\x03\x04": "zip",
    b"\x1f\x8b": "gzip",
    b"BZh": "bzip2",
    b"\xfd7zXZ\x00": "xz",
    b"\x28\xb5\x2f\xfd": "zstandard",
    b"7z\xbc\xaf": "7z",
    b"\x1f\x9d": "compress",
    b"\x04\x22\x4d\x18": "lz4",
}


_FEW, _TIMES = 64e6, 1000
"""A Parquet file that grows to more bytes, and by more times, is taken for a bomb."""
_SPREADSHEETS = (".xlsx", ".xlsm", ".xls", ".ods")


def read_table(
    path: Path, wanted: Sequence[str], layout: CsvLayout, *, max_bytes: float = 4e9
) -> Table:
    """The `wanted` columns of a `.csv`, `.txt` or `.parquet` file.

    Archives and files that would take more than `max_bytes` are refused unread; what
    cannot be read is a DataFileError.
    """
    kind = path.suffix.lower()
    wanted = list(dict.fromkeys(wanted))
    with reading(path, "Parquet" if kind == ".parquet" else "CSV"):
        _require_plain(path)
        if kind in (".csv", ".txt"):
            return read_csv(path, wanted, layout, max_bytes=max_bytes)
        if kind == ".parquet":
            return _read_parquet(path, wanted, max_bytes=max_bytes)
        raise DataFileError(
            f"{path}: files of kind {kind or 'without a suffix'!r} cannot be read; "
            "known are .csv, .txt and .parquet.",
            path=path,
        )


def _require_plain(path: Path):
    with path.open("rb") as file:
        begin = file.read(64)
    if not begin:
        raise DataFileError(f"{path}: the file is empty.", path=path)
    if path.suffix.lower() in _SPREADSHEETS or b"[Content_Types].xml" in begin:
        raise DataFileError(
            f"{path}: this is a spreadsheet. Save each sheet as CSV (in Excel: File, "
            "Save As, CSV UTF-8), and name the CSV files instead.",
            path=path,
        )
    for mark, name in _ARCHIVES.items():
        if begin.startswith(mark):
            raise DataFileError(
                f"{path}: this is a {name} archive, which is not opened because its "
                "expanded size is unknown. Unpack it first.",
                path=path,
            )


def _read_parquet(path: Path, wanted: list[str], *, max_bytes: float) -> Table:
    import pyarrow.parquet as parquet

    with parquet.ParquetFile(path) as file:
        schema = file.schema_arrow
        texts = _require_columns(path, schema, wanted)
        _require_parquet_size(path, file.metadata, wanted, texts, max_bytes)
    # every text once: repeated ones would take more than the file lets expect
    with parquet.ParquetFile(path, read_dictionary=texts) as file:
        table = file.read(columns=wanted)
    if not table.num_rows:
        raise DataFileError(f"{path}: the file has no data rows.", path=path)
    columns = {name: table.column(name) for name in wanted}
    return Table(columns, RowSource(str(path), 1, ", counted from 1"))


def _require_columns(path: Path, schema, wanted: Sequence[str]) -> list[str]:
    """One column a name with a single value a row; returns the columns of text."""
    for name in wanted:
        if schema.names.count(name) != 1:
            raise DataFileError(
                f"{path}: there is no single column {name!r}. "
                f"{suggest(name, schema.names)}",
                path=path,
            )
        if not is_readable(schema.field(name).type):
            raise DataFileError(
                f"{path}: column {name!r} holds {schema.field(name).type} values, not "
                "one number a row. Leave it out, or write its parts as columns.",
                path=path,
            )
    return [name for name in wanted if is_text(schema.field(name).type)]


def _require_parquet_size(path, metadata, wanted, texts, max_bytes):
    """Refuse by the file's own account of its values, before any is read.

    Every value takes 8 bytes at least, however few the file needs for it. Texts that
    are written as differences may grow beyond any account.
    """
    chunks = [
        chunk
        for i in range(metadata.num_row_groups)
        for j in range(metadata.num_columns)
        if (chunk := metadata.row_group(i).column(j)).path_in_schema in wanted
    ]
    for chunk in chunks:
        if chunk.path_in_schema in texts and "DELTA_BYTE_ARRAY" in chunk.encodings:
            raise DataFileError(
                f"{path}: column {chunk.path_in_schema!r} holds text, written as "
                "differences. Choose a numeric column, or write it another way.",
                path=path,
            )
    values = max(len(wanted) * metadata.num_rows, sum(c.num_values for c in chunks))
    expanded = max(8 * values, sum(c.total_uncompressed_size for c in chunks))
    if expanded > max_bytes:
        raise DataFileError(
            f"{path}: about {expanded / 1e9:.3g} GB when read, over the limit of "
            f"{max_bytes / 1e9:.3g} GB. Read fewer files or channels, or raise "
            "max_bytes.",
            path=path,
        )
    if expanded > max(_FEW, _TIMES * path.stat().st_size):
        raise DataFileError(
            f"{path}: {expanded / 1e9:.3g} GB when read, more than {_TIMES:,} times "
            "the size of the file. Measurements are not as uniform as that, so it is "
            "not read; write it as CSV if they are.",
            path=path,
        )
