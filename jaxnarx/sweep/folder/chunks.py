"""Files of results: one Parquet file for every chunk of members, and all of them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.sweep.folder.files import put
from jaxnarx.sweep.folder.manifest import FORMAT

KEY = b"jaxnarx"


class Damaged(Exception):
    """A file of results is cut off or changed; the chunk is to be computed again."""


def chunk_name(number: int) -> str:
    """File name of a chunk."""
    return f"{number:05d}.parquet"


def arrow_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as a table with every key that any of them has; absent ones are null."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: [row.get(name) for row in rows] for name in names}
    return pa.table({name: _column(name, v) for name, v in columns.items()})


def joined(tables: Sequence[pa.Table]) -> pa.Table:
    """Tables below one another, their columns united by name."""
    return pa.concat_tables(tables, promote_options="permissive")


def write_results(
    path: Path, table: pa.Table, digest: str, *, replace: bool = False
) -> bool:
    """Write a file of results of the sweep with that digest, whole or not at all."""
    mark = json.dumps({"format": FORMAT, "sweep": digest}).encode()
    table = table.replace_schema_metadata({KEY: mark})
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    return put(path, sink.getvalue().to_pybytes(), replace=replace)


def read_results(path: Path, digest: str) -> pa.Table:
    """Read a file of results. `Damaged` where it is; DataFileError where it is of
    another sweep.
    """
    try:
        data = path.read_bytes()
        table = pq.read_table(pa.BufferReader(data), page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        raise Damaged(str(error)) from error
    try:
        mark = json.loads((table.schema.metadata or {})[KEY])
    except (KeyError, ValueError) as error:
        raise _foreign(path, "is no result of a sweep") from error
    if mark.get("format") != FORMAT:
        raise _foreign(path, f"has format {mark.get('format')}, not {FORMAT}")
    if mark.get("sweep") != digest:
        raise _foreign(path, "belongs to another sweep than the folder's manifest")
    return table.replace_schema_metadata(None)


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
