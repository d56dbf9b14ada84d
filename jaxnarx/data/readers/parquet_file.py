"""Parquet files, checked by their own account of their values before they are read."""

from collections.abc import Sequence
from pathlib import Path

from jaxnarx.data.readers.columns import (
    Asked,
    Column,
    Table,
    is_readable,
    is_text,
    require_size,
)
from jaxnarx.data.record import RowSource
from jaxnarx.errors import DataFileError, suggest


def contents(path: Path, asked: Asked) -> list[Column]:
    """Every column that may hold one number, time or text a row."""
    import pyarrow.parquet as parquet

    with parquet.ParquetFile(path) as file:
        rows, schema = file.metadata.num_rows, file.schema_arrow
    return [
        Column(field.name, _unit(field), rows, text=is_text(field.type))
        for field in schema
        if is_readable(field.type)
    ]


def read(path: Path, wanted: Sequence[str], asked: Asked) -> Table:
    """The `wanted` columns; more than `asked.max_bytes` are refused unread."""
    import pyarrow.parquet as parquet

    wanted = list(wanted)
    with parquet.ParquetFile(path) as file:
        schema = file.schema_arrow
        texts = _require_columns(path, schema, wanted)
        _require_parquet_size(path, file.metadata, wanted, texts, asked.max_bytes)
    # every text once: repeated ones would take more than the file lets expect
    with parquet.ParquetFile(path, read_dictionary=texts) as file:
        table = file.read(columns=wanted)
    if not table.num_rows:
        raise DataFileError(f"{path}: the file has no data rows.", path=path)
    columns = {name: table.column(name) for name in wanted}
    units = {name: _unit(schema.field(name)) for name in wanted}
    units = {name: unit for name, unit in units.items() if unit}
    return Table(columns, RowSource(str(path), 1, ", counted from 1"), units)


def _unit(field) -> str:
    """The unit that the metadata of the field states."""
    told = field.metadata or {}
    found = next((told[n] for n in (b"unit", b"units") if n in told), b"")
    return found.decode("utf-8", "replace").strip()


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
    require_size(path, expanded, max_bytes)
