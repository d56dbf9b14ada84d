"""Data files of any kind: what is in them, and wanted columns of them.

A kind of file is a module with two functions, `contents(path, asked)` and `read(path,
wanted, asked)`; both may raise whatever comes, which is told as a DataFileError here.
The types they return are in `jaxnarx.data.readers.columns`.
"""

import dataclasses
import importlib
import importlib.util
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from jaxnarx.data.readers.columns import Asked, Column, Table
from jaxnarx.data.readers.columns import require_limit as require_limit
from jaxnarx.data.record import RowSource as RowSource
from jaxnarx.errors import DataFileError, SpecError, guard_reading
from jaxnarx.extensions import Registry


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of file: its module, and the extra of jaxnarx that brings `package`.

    `module` is the name of one of this folder, or anything that has the two functions.
    """

    name: str
    module: Any
    package: str = ""
    extra: str = ""
    packed: bool = False
    """Whether such files are archives by themselves."""
    marks: tuple[bytes, ...] = ()
    """How such files begin, or go on behind a block of 512 bytes."""


_CSV, _PARQUET = Kind("CSV", "csv_file"), Kind("Parquet", "parquet_file")
_SHEET = Kind("spreadsheet", "spreadsheet", "python_calamine", "excel", packed=True)
_MDF = Kind("MDF", "mdf", "asammdf", "mdf", marks=(b"MDF", b"UnFinMF"))
_MAT = Kind("MATLAB", "variables", "matio", "matlab")
_HDF5 = Kind("HDF5", "variables", "h5py", "hdf5", marks=(b"\x89HDF\r\n\x1a\n",))
_OWN_KINDS: dict[str, Kind] = {
    ".csv": _CSV,
    ".txt": _CSV,
    ".parquet": _PARQUET,
    ".xlsx": _SHEET,
    ".xlsm": _SHEET,
    ".xlsb": _SHEET,
    ".xls": _SHEET,
    ".ods": _SHEET,
    ".mf4": _MDF,
    ".mdf": _MDF,
    ".dat": _MDF,
    ".mat": _MAT,
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".hdf": _HDF5,
    ".npz": Kind("npz", "variables", packed=True, marks=(b"PK",)),
}


def _require_suffix(name: str, kind: Kind) -> None:
    if not name.startswith(".") or name != name.lower():
        raise SpecError(
            f"a kind of file goes by its suffix in lower case, such as '.sig', got "
            f"{name!r}",
            field="name",
        )


KINDS = Registry("kind of file", _OWN_KINDS, check=_require_suffix)
"""Kinds of files by suffix, lower case."""

_ARCHIVE_MARKS = {
    b"PK\x03\x04": "zip",
    b"\x1f\x8b": "gzip",
    b"BZh": "bzip2",
    b"\xfd7zXZ\x00": "xz",
    b"\x28\xb5\x2f\xfd": "zstandard",
    b"7z\xbc\xaf": "7z",
    b"\x1f\x9d": "compress",
    b"\x04\x22\x4d\x18": "lz4",
}


FILE_WATCHER: ContextVar[Callable[[Path | None], None] | None] = ContextVar(
    "FILE_WATCHER", default=None
)
"""Is told every file when its reading begins, and None when it has ended."""


def read_table(path: Path, wanted: Sequence[str], asked: Asked) -> Table:
    """The `wanted` columns of a file.

    Archives and files that would take more than `asked.max_bytes` are refused unread;
    what cannot be read is a DataFileError.
    """
    wanted = list(dict.fromkeys(wanted))
    return _use_watched(path, lambda module: module.read(path, wanted, asked))


def contents(path: Path, asked: Asked) -> list[Column]:
    """All columns of a file that could be channels."""
    return _use_watched(path, lambda module: module.contents(path, asked))


def _use_watched(path: Path, use: Any) -> Any:
    watcher = FILE_WATCHER.get()
    if watcher is None:
        return _use_reader(path, use)
    watcher(path)
    try:
        return _use_reader(path, use)
    finally:
        watcher(None)


def _use_reader(path: Path, use: Any) -> Any:
    kind = KINDS.get(path.suffix.lower())
    with guard_reading(path, "CSV" if kind is None else kind.name):
        _require_plain(path, kind)
        if path.suffix.lower() == ".dat" and not _begins(path, _MDF):
            kind = _CSV  # texts are called so as well
        if kind is None:
            known = ", ".join(KINDS)
            raise DataFileError(
                f"{path}: files of kind {path.suffix.lower() or 'without a suffix'!r} "
                f"cannot be read; known are {known}.",
                path=path,
            )
        if kind.marks and not _begins(path, kind):
            raise DataFileError(
                f"{path}: this is no {kind.name} file, it does not begin like one. "
                "Call it what it is, or export it anew.",
                path=path,
            )
        if kind.package and importlib.util.find_spec(kind.package) is None:
            raise DataFileError(
                f"{path}: {kind.name} files are read with the package {kind.package}, "
                f'which is not installed: pip install "jaxnarx[{kind.extra}]".',
                path=path,
            )
        if not isinstance(kind.module, str):
            return use(kind.module)
        return use(importlib.import_module(f"jaxnarx.data.readers.{kind.module}"))


def _begins(path: Path, kind: Kind) -> bool:
    """Whether a file begins as its kind does."""
    with path.open("rb") as file:
        begin = file.read(600)
    return begin.startswith(kind.marks) or begin[512:].startswith(kind.marks)


def _require_plain(path: Path, kind: Kind | None):
    with path.open("rb") as file:
        begin = file.read(64)
    if not begin:
        raise DataFileError(f"{path}: the file is empty.", path=path)
    if kind is not None and kind.packed:
        return
    if b"[Content_Types].xml" in begin:
        raise DataFileError(
            f"{path}: this is a spreadsheet. Call it .xlsx, and it is read as one.",
            path=path,
        )
    for mark, name in _ARCHIVE_MARKS.items():
        if begin.startswith(mark):
            raise DataFileError(
                f"{path}: this is a {name} archive, which is not opened because its "
                "expanded size is unknown. Unpack it first.",
                path=path,
            )
