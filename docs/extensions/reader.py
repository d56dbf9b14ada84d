"""A reader: files of kind .sig, a line of names and then doubles, row by row."""

import sys

import numpy as np
import pyarrow as pa

from jaxnarx.data.readers import KINDS, Column, Kind, RowSource, Table, require_limit
from jaxnarx.errors import DataFileError


def _head(path):
    with path.open("rb") as file:
        names = file.readline(100_000).decode("utf-8").split()
        return names, file.tell()


def contents(path, asked):
    """Every column with its number of rows."""
    names, start = _head(path)
    rows = (path.stat().st_size - start) // (8 * max(len(names), 1))
    return [Column(name, rows=rows) for name in names]


def read(path, wanted, asked):
    """The wanted columns; what is raised is told as a DataFileError with the path."""
    names, start = _head(path)
    for name in wanted:
        if name not in names:
            raise DataFileError(f"{path}: there is no column {name!r}.", path=path)
    require_limit(path, path.stat().st_size - start, asked.max_bytes)
    rows = np.fromfile(path, "<f8", offset=start).reshape(-1, len(names))
    columns = {name: pa.array(rows[:, names.index(name)]) for name in wanted}
    return Table(columns, RowSource(str(path)))


def write(path):
    """A file for the contract."""
    rows = np.random.default_rng(0).normal(size=(20, 2))
    path.write_bytes(b"speed load\n" + rows.astype("<f8").tobytes())
    return {"speed": rows[:, 0], "load": rows[:, 1]}


KINDS.register(".sig", Kind("signals", sys.modules[__name__]), example=write)
