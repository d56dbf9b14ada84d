"""The contract of a kind of file.

`KINDS.register(".sig", Kind("signals", reader), example=write)`: `write(path)` writes a
file and returns its columns, arrays of numbers by name, at least two of 20 rows.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from jaxnarx.data import Asked, contents, numbers, read_table
from jaxnarx.errors import DataFileError

Write = Callable[[Path], Mapping[str, np.ndarray]]


def contents_are_its_columns(write: Write, suffix: str, folder: Path) -> None:
    """`contents` names every column that can be read, with the number of its rows."""
    columns = write(folder / f"a{suffix}")
    found = {one.name: one for one in contents(folder / f"a{suffix}", Asked())}
    assert set(columns) <= set(found)
    for name, values in columns.items():
        assert found[name].rows in (0, len(values)), name


def reads_what_is_wanted(write: Write, suffix: str, folder: Path) -> None:
    """`read` returns the wanted columns, exactly, and all of their rows."""
    path = folder / f"a{suffix}"
    columns = write(path)
    wanted = list(columns)[::-1]
    table = read_table(path, wanted, Asked())
    assert set(wanted) <= set(table.columns)
    for name in wanted:
        got = numbers(table.columns[name], channel=name, place=table.place)
        np.testing.assert_array_equal(got, columns[name])


def refuses_what_is_not_there(write: Write, suffix: str, folder: Path) -> None:
    """An unknown column is a DataFileError that names it."""
    path = folder / f"a{suffix}"
    write(path)
    _require_refusal(path, ["no such column"], Asked(), "no such column")


def refuses_what_is_too_large(write: Write, suffix: str, folder: Path) -> None:
    """More than `max_bytes` is a DataFileError, before it is read."""
    path = folder / f"a{suffix}"
    columns = write(path)
    _require_refusal(path, list(columns), Asked(max_bytes=8), "max_bytes")


def refuses_what_is_damaged(write: Write, suffix: str, folder: Path) -> None:
    """A file cut off anywhere is read or refused by a DataFileError; never another
    exception, and never more rows than there were."""
    whole = folder / f"whole{suffix}"
    columns = write(whole)
    data, path = whole.read_bytes(), folder / f"cut{suffix}"
    rows = max(map(len, columns.values()))
    refused = 0
    for size in np.linspace(0, len(data) - 1, 12).astype(int).tolist():
        path.write_bytes(data[:size])
        try:
            table = read_table(path, list(columns), Asked())
        except DataFileError as error:
            assert str(path) in str(error)
            refused += 1
        else:
            assert len(table) <= rows
    assert refused, "an empty file was read"


CHECKS = (
    contents_are_its_columns,
    reads_what_is_wanted,
    refuses_what_is_not_there,
    refuses_what_is_too_large,
    refuses_what_is_damaged,
)


def _require_refusal(path: Path, wanted: list[str], asked: Asked, word: str) -> None:
    try:
        read_table(path, wanted, asked)
    except DataFileError as error:
        assert word in str(error), str(error)
        return
    raise AssertionError("it was read")
