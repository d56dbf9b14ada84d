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

from jaxnarx.errors import DataFileError


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
def open_tree(
    path: Path, wanted: Sequence[str] | None = None
) -> Iterator[dict[str, Any]]:
    """Open a file as a tree; arrays of HDF5 are not read before they are used.

    Vectors that are not `wanted` may be left out.
    """
    suffix = path.suffix.lower()
    if suffix == ".mat":
        yield _mat(path, wanted)
    elif suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            yield {name: simplify(file[name]) for name in file.files}
    else:
        import h5py

        with h5py.File(path) as file:
            yield _hdf5(path, file)


def unfolded_size(path: Path) -> int:
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
    """The size of a file of version 5: the tag of every packed element tells how long
    it will be."""
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
    """Bytes of all datasets, each as often as it has a name."""
    import h5py

    with h5py.File(path) as file:
        return sum(
            int(item.size or 0) * item.dtype.itemsize
            for _, item in _walk(path, file)
            if isinstance(item, h5py.Dataset)
        )


def _walk(path: Path, group: Any) -> Iterator[tuple[str, Any]]:
    """Name and item of all that a group holds, at every depth; each group once."""
    import h5py

    visited = {group}
    waiting = [(group, "")]
    while waiting:
        group, place = waiting.pop()
        for name, item in _own_items(path, group, place):
            yield f"{place}{name}", item
            if isinstance(item, h5py.Group) and item not in visited:
                visited.add(item)
                waiting.append((item, f"{place}{name}/"))


def _own_items(path: Path, group: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Members of a group that lie in the file itself.

    DataFileError for links to other files and datasets stored in others: they could
    hold any bytes of this machine, and any number of them. A soft link is another name
    of what the file holds anyway, so it is passed over.
    """
    import h5py

    for name in group:
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise _link_error(path, place + name, f"a link to {link.filename!r}")
        if not isinstance(link, h5py.HardLink):
            continue
        item = group[name]
        if isinstance(item, h5py.Dataset) and item.external:
            raise _link_error(path, place + name, f"stored in {item.external[0][0]!r}")
        if isinstance(item, h5py.Dataset) and item.is_virtual:
            raise _link_error(path, place + name, "put together from other datasets")
        yield name, item


def _link_error(path: Path, name: str, what: str) -> DataFileError:
    return DataFileError(
        f"{path}: {name} is {what}, which is not followed. Copy its samples into this "
        "file.",
        path=path,
    )


def _hdf5(path: Path, file: Any) -> dict[str, Any]:
    """The tree of a file; a group that has several names has one here."""
    import h5py

    tree: dict[str, Any] = {}
    _add_attributes(tree, file)
    for place, item in _walk(path, file):
        *above, name = place.split("/")
        if len(above) > MAX_DEPTH:
            continue
        branch = tree
        for part in above:
            branch = branch[part]
        if isinstance(item, h5py.Group):
            branch[name] = {}
            _add_attributes(branch[name], item)
        elif isinstance(item, h5py.Dataset):
            _add_dataset(branch, name, item)
    return tree


def _add_attributes(branch: dict[str, Any], group: Any) -> None:
    """Numbers among the attributes: a sample time may stand there."""
    for name, value in group.attrs.items():
        if isinstance(value, int | float | np.number):
            branch.setdefault(name, np.asarray(value))


def _add_dataset(branch: dict[str, Any], name: str, item: Any) -> None:
    """A dataset as one of the forms of this module; numbers are not read yet."""
    import h5py

    if item.shape is None:
        return
    if h5py.check_string_dtype(item.dtype):
        branch[name] = simplify(np.asarray(item.asstr()[()], object))
    elif item.dtype.names:
        branch[name] = simplify(item[()])
    elif item.dtype.kind != "O":
        unit = next((item.attrs[n] for n in _UNIT_NAMES if n in item.attrs), "")
        branch[name] = WithUnit(item, _text(unit))


_UNIT_NAMES = ("unit", "units", "Unit", "Units")
MAX_DEPTH = 12
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
    return {k: simplify(v) for k, v in found.items() if not k.startswith("__")}


def _is_number(kind: str) -> bool:
    return kind.startswith(("double", "single", "logical", "int", "uint"))


def simplify(value: Any, depth: int = 0) -> Any:
    """A variable as one of the forms of this module; `None` for what has none."""
    properties = getattr(value, "properties", None)
    if depth > MAX_DEPTH:
        return None
    if isinstance(properties, Mapping):
        branch = {str(k): simplify(v, depth + 1) for k, v in properties.items()}
        return _series(branch) if "Data_" in branch else branch
    if isinstance(value, Mapping):
        return {str(k): simplify(v, depth + 1) for k, v in value.items()}
    if hasattr(value, "iloc") and hasattr(value, "columns"):
        return _frame(value)
    if isinstance(value, np.ndarray) and value.dtype.names:
        return _structs(value, depth)
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        parts = [simplify(v, depth + 1) for v in value.ravel()]
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
        return TimedColumns({name: simplify(value[name]) for name in names})
    every = [
        {name: simplify(one[name], depth + 1) for name in names}
        for one in value.ravel()
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
            columns[name] = simplify(column.to_numpy())
    index, time = value.index.to_numpy(), None
    if index.dtype.kind in "mM":
        time = count_from_first(index)
    return TimedColumns(columns, time, dict(zip(names, units, strict=False)), labels)


def count_from_first(moments: np.ndarray) -> np.ndarray:
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
