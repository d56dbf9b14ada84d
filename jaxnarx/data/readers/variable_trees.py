"""MATLAB, HDF5 and NumPy files as trees of named variables, each form for all three.

A branch is a dict; leaves are arrays of numbers, lists of texts and `TimedColumns`.
Structs, groups and archives become dicts, arrays of structs lists of them. Runs in a
process of its own, see `variables`.
"""

import contextlib
import dataclasses
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True)
class TimedColumns:
    """Columns over one time: a table, a timetable, a timeseries, a compound dataset.

    `time` [s] is `None` where there is none; `labels` name the values of columns that
    were categories.
    """

    columns: Mapping[str, Any]
    time: np.ndarray | None = None
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    labels: Mapping[str, Sequence[str]] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class WithUnit:
    """An array whose file states its unit."""

    array: Any
    unit: str


@contextlib.contextmanager
def opened(path: Path, wanted: Sequence[str] | None = None) -> Iterator[dict[str, Any]]:
    """What is in a file; of HDF5, arrays that are not read before they are used.

    Vectors that are not `wanted` may be left out.
    """
    suffix = path.suffix.lower()
    if suffix == ".mat":
        yield _mat(path, wanted)
    elif suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            yield {name: plain(file[name]) for name in file.files}
    else:
        import h5py

        with h5py.File(path) as file:
            yield _hdf5(file)


def unfolded(path: Path) -> int:
    """Bytes of a file when it is unfolded, by its own account."""
    if path.suffix.lower() == ".npz":
        with zipfile.ZipFile(path) as archive:
            return sum(part.file_size for part in archive.infolist())
    with path.open("rb") as file:
        begin = file.read(520)
    if b"\x89HDF\r\n\x1a\n" in begin or begin.startswith(b"MATLAB 7.3"):
        return _hdf5_size(path)
    return _mat_size(path) if begin.startswith(b"MATLAB 5") else path.stat().st_size


def _mat_size(path: Path) -> int:
    """Of version 5: the tag of every packed element tells how long it will be."""
    size = path.stat().st_size
    total = 0
    with path.open("rb") as file:
        order = "<" if file.read(128)[126:128] == b"IM" else ">"
        while file.tell() + 8 <= size:
            kind, count = np.frombuffer(file.read(8), f"{order}u4").tolist()
            inside = file.tell()
            if kind == 15:
                tag = zlib.decompressobj().decompress(file.read(min(count, 256)), 8)
                total += np.frombuffer(tag, f"{order}u4").tolist()[1]
            else:
                total += count
            file.seek(inside + count)
    return total


def _hdf5_size(path: Path) -> int:
    import h5py

    total = 0

    def add(_, item: Any) -> None:
        nonlocal total
        if isinstance(item, h5py.Dataset):
            total += int(item.size or 0) * item.dtype.itemsize

    with h5py.File(path) as file:
        file.visititems(add)
    return total


def _hdf5(group: Any, depth: int = 0) -> dict[str, Any]:
    import h5py

    found: dict[str, Any] = {}
    for name, item in group.items():
        if isinstance(item, h5py.Group) and depth < DEPTH:
            found[name] = _hdf5(item, depth + 1)
        elif not isinstance(item, h5py.Dataset) or item.shape is None:
            continue
        elif h5py.check_string_dtype(item.dtype):
            found[name] = plain(np.asarray(item.asstr()[()], object))
        elif item.dtype.names:
            found[name] = plain(item[()])
        elif item.dtype.kind != "O":
            unit = next((item.attrs[n] for n in _UNIT if n in item.attrs), "")
            found[name] = WithUnit(item, _text(unit))
    for name, value in group.attrs.items():  # a sample time may stand there
        if isinstance(value, int | float | np.number):
            found.setdefault(name, np.asarray(value))
    return found


_UNIT = ("unit", "units", "Unit", "Units")
DEPTH = 12
"""Levels of groups and structs that are looked into."""


def _mat(path: Path, wanted: Sequence[str] | None) -> dict[str, Any]:
    import warnings

    import matio

    warnings.simplefilter("ignore")
    held = matio.whosmat(path)
    names = None
    if wanted is not None and all(_is_number(kind) for _, kind in held.values()):
        # nothing beside the vectors says that they are called otherwise
        asked = {name.split(".")[0] for name in wanted}
        names = [
            name
            for name, (shape, _) in held.items()
            if name in asked or min(shape) > 1 or np.prod(shape) == 1
        ]
    found = matio.load_from_mat(path, variable_names=names, add_table_attrs=True)
    return {k: plain(v) for k, v in found.items() if not k.startswith("__")}


def _is_number(kind: str) -> bool:
    return kind.startswith(("double", "single", "logical", "int", "uint"))


def plain(value: Any, depth: int = 0) -> Any:
    """A variable as one of the forms of this module; `None` for what has none."""
    properties = getattr(value, "properties", None)
    if depth > DEPTH:
        return None
    if isinstance(properties, Mapping):
        branch = {str(k): plain(v, depth + 1) for k, v in properties.items()}
        return _series(branch) if "Data_" in branch else branch
    if isinstance(value, Mapping):
        return {str(k): plain(v, depth + 1) for k, v in value.items()}
    if hasattr(value, "iloc") and hasattr(value, "columns"):
        return _frame(value)
    if isinstance(value, np.ndarray) and value.dtype.names:
        return _structs(value, depth)
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        parts = [plain(v, depth + 1) for v in value.ravel()]
        if parts and all(isinstance(p, list) and len(p) == 1 for p in parts):
            return [p[0] for p in parts]
        return parts[0] if len(parts) == 1 else parts
    if isinstance(value, str | bytes):
        return [_text(value)]
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.kind in "SUT":
            return [_text(v) for v in array.ravel()]
        return array
    return None


def _structs(value: np.ndarray, depth: int) -> Any:
    """A struct as a dict, several as a list, a compound of numbers as a frame."""
    names = value.dtype.names
    assert names is not None
    if not any(value.dtype[name].kind == "O" for name in names):
        return TimedColumns({name: plain(value[name]) for name in names})
    every = [
        {name: plain(one[name], depth + 1) for name in names} for one in value.ravel()
    ]
    return every[0] if len(every) == 1 else every


def _frame(value: Any) -> TimedColumns:
    """A table or timetable of MATLAB, which arrives as a frame of pandas."""
    attrs = value.attrs
    units = attrs.get("VariableUnits") or attrs.get("varUnits") or []
    names = [str(name) for name in value.columns]
    columns, labels = {}, {}
    for k, name in enumerate(names):
        column = value.iloc[:, k]
        if hasattr(column, "cat"):
            labels[name] = [str(c) for c in column.cat.categories]
            codes = np.asarray(column.cat.codes, float)
            columns[name] = np.where(codes < 0, np.nan, codes)
        else:
            columns[name] = plain(column.to_numpy())
    index, time = value.index.to_numpy(), None
    if index.dtype.kind in "mM":
        time = since_first(index)
    return TimedColumns(columns, time, dict(zip(names, units, strict=False)), labels)


def since_first(moments: np.ndarray) -> np.ndarray:
    """Dates count from their first, durations from zero [s]."""
    if moments.dtype.kind == "M":
        moments = moments - moments[:1]
    return moments.astype("timedelta64[ns]").astype(np.float64) * 1e-9


def _series(branch: dict[str, Any]) -> Any:
    """A MATLAB timeseries; one that is uniform keeps start and increment only."""
    data, info = branch["Data_"], branch.get("TimeInfo")
    if not isinstance(data, np.ndarray) or data.ndim > 3:
        return None
    data = np.squeeze(data)
    info = info if isinstance(info, dict) else {}
    unit = (info.get("Units") or ["seconds"])[0].lower()
    scale = {"milliseconds": 1e-3, "microseconds": 1e-6, "minutes": 60.0}.get(unit, 1.0)
    time = branch.get("Time_")
    if not isinstance(time, np.ndarray) or not time.size:
        time = info.get("Time_")
    if not isinstance(time, np.ndarray) or not time.size:
        start, step = (_number(info, name) for name in ("Start", "Increment"))
        length = len(data) if branch.get("IsTimeFirst_", True) else data.shape[-1]
        time = (start or 0.0) + (step or 1.0) * np.arange(length)
    time = np.ravel(np.asarray(time, float)) * scale
    if data.ndim == 2 and len(data) != len(time):
        data = data.T
    told = branch.get("DataInfo")
    unit = (told.get("Units") or [""])[0] if isinstance(told, dict) else ""
    name = (branch.get("Name") or [""])[0]
    columns = {name: data}
    if data.ndim == 2:
        columns = {f"{name}_{k + 1}": data[:, k] for k in range(data.shape[1])}
    return TimedColumns(columns, time, dict.fromkeys(columns, str(unit)))


def _number(branch: Mapping[str, Any], name: str) -> float | None:
    for key in (name, f"{name}_"):
        value = branch.get(key)
        if isinstance(value, np.ndarray) and value.size == 1:
            return float(value.ravel()[0])
    return None


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size else ""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").strip()
    return str(value).strip()
