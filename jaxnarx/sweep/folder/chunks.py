"""Files of results: one Parquet file for every chunk of members, and all of them."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from jaxnarx.errors import DataFileError, SpecError, guard_reading
from jaxnarx.sweep.folder.files import put

METADATA_KEY = b"jaxnarx"
FORMAT_VERSION = 2
"""Version of files of results; those of format 1 have no digest."""
DIGEST_MARK = b'"sha256": "'
"""Text before the digest in the mark."""


class Damaged(Exception):
    """A file of results is cut off or changed; the chunk is to be computed again."""


def chunk_name(number: int) -> str:
    """File name of a chunk."""
    return f"{number:05d}.parquet"


def chunk_number(name: str) -> int | None:
    """The chunk whose file has that name; None for other files."""
    stem = name.removesuffix(".parquet")
    number = int(stem) if stem.isascii() and stem.isdigit() and len(stem) < 19 else -1
    return number if chunk_name(number) == name else None


def arrow_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as a table with every key that any of them has; absent ones are null."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: [row.get(name) for row in rows] for name in names}
    return pa.table({name: _column(name, v) for name, v in columns.items()})


def join_tables(tables: Sequence[pa.Table]) -> pa.Table:
    """Tables below one another, their columns united by name."""
    try:
        return pa.concat_tables(tables, promote_options="permissive")
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise Damaged(f"its columns do not fit together: {error}") from error


def write_results(
    path: Path, table: pa.Table, digest: str, *, replace: bool = False
) -> bool:
    """Write a file of results of the sweep with that digest, whole or not at all.

    Its mark holds the SHA-256 of the file in which that very place is filled with
    zeros, so that no bit of it can change unseen.
    """
    mark = json.dumps({"format": FORMAT_VERSION, "sweep": digest, "sha256": "0" * 64})
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, table.schema, compression="zstd") as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({METADATA_KEY: mark.encode()})
    data = sink.getvalue().to_pybytes()
    place = _place(data)
    seal = hashlib.sha256(data).hexdigest().encode()
    return put(path, data[: place.start] + seal + data[place.stop :], replace=replace)


def read_results(path: Path, digest: str, members: Sequence[int]) -> pa.Table:
    """Read the file of results of these members. `Damaged` where it is; DataFileError
    where it is of another sweep.
    """
    if path.is_symlink() or not path.is_file():
        raise Damaged(f"{path}: it is no file of this folder")
    try:
        with guard_reading(path, "results of a sweep"):
            data = path.read_bytes()
            mark, table = _parse(data)
    except DataFileError as error:
        raise Damaged(str(error)) from error
    if mark is None:
        raise _foreign(path, "is no result of a sweep")
    if mark.get("format") not in (1, FORMAT_VERSION):
        raise _foreign(path, f"has format {mark.get('format')}, not {FORMAT_VERSION}")
    if mark != {"format": 1, "sweep": mark.get("sweep")} and not _is_sealed(data):
        raise Damaged(f"{path}: it is not as it was written")
    if mark.get("sweep") != digest:
        raise _foreign(path, "belongs to another sweep than the folder's manifest")
    if not _are_rows_of(table, members):
        raise Damaged(f"{path}: its rows are of other members than its name says")
    return table


def _parse(data: bytes) -> tuple[dict[str, Any] | None, pa.Table]:
    """Mark (None where there is none) and rows of a file.

    In this thread alone: threads of Arrow that still hold the bytes, which are Python's
    own, when Python ends, abort it ("terminate called without an active exception").
    """
    source = pa.BufferReader(data)
    with pq.ParquetFile(source, page_checksum_verification=True) as file:
        try:
            mark = json.loads((file.metadata.metadata or {})[METADATA_KEY])
        except (KeyError, ValueError, RecursionError):
            mark = None
        table = file.read(use_threads=False).replace_schema_metadata(None)
    return mark if isinstance(mark, dict) else None, table


def _is_sealed(data: bytes) -> bool:
    """Whether every bit is as it was written."""
    place = _place(data)
    blank = data[: place.start] + b"0" * 64 + data[place.stop :]
    return hashlib.sha256(blank).hexdigest().encode() == data[place]


def _place(data: bytes) -> slice:
    """The place of the digest: the mark comes after all rows and their statistics."""
    start = data.rfind(DIGEST_MARK) + len(DIGEST_MARK)
    return slice(start, start + 64)


def _are_rows_of(table: pa.Table, members: Sequence[int]) -> bool:
    """Whether these are the rows of those members, in order."""
    if "index" not in table.column_names or len(table) != len(members):
        return False
    return table.column("index").to_pylist() == list(members)


def _foreign(path: Path, what: str) -> DataFileError:
    return DataFileError(
        f"{path} {what}. Move it elsewhere and give the same command again, or begin "
        "anew with new=True (--new-run).",
        path=path,
    )


def _column(name: str, values: list[Any]) -> pa.Array:
    """Values as a column; SpecError where they are of no common kind."""
    try:
        return pa.array(values)
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise SpecError(
            f"{name!r} of a sweep's rows is of different kinds: {error}", field="work"
        ) from error
