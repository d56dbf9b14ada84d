"""One data file of any kind, checked before it is read."""

from collections.abc import Sequence
from pathlib import Path

from jaxnarx.data.columns import Table
from jaxnarx.data.csv_table import CsvLayout, read_csv
from jaxnarx.data.place import Place
from jaxnarx.errors import DataFileError, suggest

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


def read_table(
    path: Path, wanted: Sequence[str], layout: CsvLayout, *, max_bytes: float = 4e9
) -> Table:
    """The `wanted` columns of a `.csv`, `.txt` or `.parquet` file.

    Archives and files that would take more than `max_bytes` are refused unread.
    """
    _require_plain(path)
    kind = path.suffix.lower()
    wanted = list(dict.fromkeys(wanted))
    if kind in (".csv", ".txt"):
        return read_csv(path, wanted, layout, max_bytes=max_bytes)
    if kind == ".parquet":
        return _read_parquet(path, wanted, max_bytes=max_bytes)
    raise DataFileError(
        f"{path}: files of kind {kind or 'without a suffix'!r} cannot be read; known "
        "are .csv, .txt and .parquet.",
        path=path,
    )


def _require_plain(path: Path):
    try:
        with path.open("rb") as file:
            begin = file.read(8)
    except OSError as error:
        raise DataFileError(
            f"{path}: cannot be opened ({error.strerror or error}).", path=path
        ) from error
    if not begin:
        raise DataFileError(f"{path}: the file is empty.", path=path)
    for mark, name in _ARCHIVES.items():
        if begin.startswith(mark):
            raise DataFileError(
                f"{path}: this is a {name} archive, which is not opened because its "
                "expanded size is unknown. Unpack it first.",
                path=path,
            )


def _read_parquet(path: Path, wanted: list[str], *, max_bytes: float) -> Table:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    try:
        with parquet.ParquetFile(path) as file:
            names = list(file.schema_arrow.names)
            for name in wanted:
                if names.count(name) != 1:
                    raise DataFileError(
                        f"{path}: there is no single column {name!r}. "
                        f"{suggest(name, names)}",
                        path=path,
                    )
            _require_parquet_size(path, file.metadata, wanted, max_bytes)
            table = file.read(columns=wanted)
    except (pa.ArrowException, OSError) as error:
        raise DataFileError(
            f"{path}: cannot be read as Parquet ({error}).", path=path
        ) from error
    if not table.num_rows:
        raise DataFileError(f"{path}: the file has no data rows.", path=path)
    columns = {name: table.column(name) for name in wanted}
    return Table(columns, Place(str(path), 1, ", counted from 1"))


def _require_parquet_size(path, metadata, wanted, max_bytes):
    chunks = (
        metadata.row_group(i).column(j)
        for i in range(metadata.num_row_groups)
        for j in range(metadata.num_columns)
    )
    stored = sum(
        c.total_uncompressed_size
        for c in chunks
        if c.path_in_schema.split(".")[0] in wanted
    )
    expanded = max(stored, 8 * len(wanted) * metadata.num_rows)
    if expanded > max_bytes:
        raise DataFileError(
            f"{path}: about {expanded / 1e9:.3g} GB when read, over the limit of "
            f"{max_bytes / 1e9:.3g} GB. Read fewer files or channels, or raise "
            "max_bytes.",
            path=path,
        )
