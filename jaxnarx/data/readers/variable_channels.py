"""The channels in a tree of variables; runs in a process of its own, see `variables`.

A vector is a channel by its name. The columns of a matrix are called as a list of texts
beside it says (`names` of as many), or else `data_1`, `data_2`, ...; `units` beside
`names` are theirs. Tables, timetables and timeseries bring their time, and so do a
struct or group with vectors of one length of which one is called `time` or `t`, the
structs that Simulink logs (`time`, `signals`), those of dSPACE (`X`, `Y`) and `iddata`.
"""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.data.readers.columns import require_limit, require_size
from jaxnarx.data.readers.variable_logs import read_branch
from jaxnarx.data.readers.variable_trees import (
    TimedColumns,
    WithUnit,
    count_from_first,
    open_tree,
    unfolded_size,
)
from jaxnarx.data.sampling import TIME_UNITS, time_unit_in
from jaxnarx.errors import DataFileError, suggest

_STEP_NAMES = re.compile(r"(?i)(ts|dt|t_?s|sample_?time|sampling_?time|sample_?period)")
_RATE_NAMES = re.compile(r"(?i)(fs|sample_?rate|sampling_?(rate|frequency))")
_TIME_NAMES = re.compile(
    r"(?i)(time|t|time_?stamps?|zeit)(_(s|ms|us|min|h)|[ _]?[\[(]\w+[\])])?"
)
_LABEL_NAMES = re.compile(
    r"(?i).*(name|label|channel|column|header|title|signal|items|vars).*"
)


@dataclasses.dataclass(frozen=True)
class Variable:
    """A channel: where it is (`table`, its own `name`), its values and time [s].

    `values` may be an array that is not read yet; `part` is its place in a matrix,
    axis and index. `step` [s] is what stands beside it as the sample time.
    """

    table: str
    name: str
    values: Any
    part: tuple[int, int] | None = None
    time: Any = None
    unit: str = ""
    labels: Sequence[str] = ()
    step: float | None = None
    stamps: bool = False
    """Whether it is the time of the channels beside it."""

    @property
    def path(self) -> str:
        return f"{self.table}.{self.name}" if self.table else self.name

    @property
    def rows(self) -> int:
        if self.part is None:
            return int(np.prod(np.shape(self.values)))
        return int(self.values.shape[1 - self.part[0]])

    def read(self) -> np.ndarray:
        if self.part is None:
            return np.asarray(self.values[()]).ravel()
        axis, k = self.part
        return np.asarray(self.values[k, :] if axis == 0 else self.values[:, k])


def contents(path: Path, folder: Path, *, max_bytes: float) -> list[dict[str, Any]]:
    """Columns as keyword arguments of `Column`."""
    _require(path, max_bytes)
    with open_tree(path) as tree:
        found = [one for one in _channels(tree, "", None) if not _is_known_time(one)]
        names = [one.name for one in found]
        return [
            {
                "name": one.name if names.count(one.name) == 1 else one.path,
                "unit": one.unit,
                "rows": one.rows,
                "table": one.table,
                "step": _step(one),
                "text": isinstance(one.values, list),
            }
            for one in found
        ]


def signals(
    path: Path, folder: Path, *, wanted: list[str], table: str, max_bytes: float
) -> dict[str, Any]:
    """Values and stamps of the wanted channels, as files of the folder."""
    _require(path, max_bytes)
    with open_tree(path, wanted) as tree:
        found = list(_channels(tree, "", None))
        chosen = [_find_channel(path, found, name, table) for name in wanted]
        require_limit(path, 8 * sum(one.rows for one in chosen), max_bytes)
        times = _times(path, chosen)
        answer = []
        for k, (name, one, time) in enumerate(zip(wanted, chosen, times, strict=True)):
            x = _numbers(path, one)
            np.save(folder / f"x{k}.npy", x)
            key = None
            if time is not None:
                key = f"t{next(i for i, t in enumerate(times) if t is time)}"
                np.save(folder / f"{key}.npy", np.asarray(time, float))
            labels = list(one.labels)
            told = {"name": name, "time": key, "unit": one.unit, "labels": labels}
            answer.append(told | {"valid": True})
        return {"signals": answer, "notes": []}


def _require(path: Path, max_bytes: float) -> None:
    require_size(path, unfolded_size(path), max_bytes)


def _channels(branch: Any, table: str, step: float | None) -> Iterator[Variable]:
    """All channels below a branch."""
    if isinstance(branch, list):
        for k, part in enumerate(branch):
            if isinstance(part, dict | list):
                yield from _channels(part, f"{table}({k + 1})", step)
        return
    step = _own_step(branch) or step
    special = read_branch(branch)
    if special is not None:
        yield from _frame_variables(special, table, "", step)
        return
    names, units = _texts(branch)
    unit_of = dict(zip(names, units, strict=False)) if names and units else {}
    own: list[Variable] = []
    for name, value in branch.items():
        inside = f"{table}.{name}" if table else name
        unit = unit_of.get(name, "")
        if isinstance(value, WithUnit):
            value, unit = value.array, value.unit or unit
        if isinstance(value, dict) or (
            isinstance(value, list) and any(isinstance(v, dict | list) for v in value)
        ):
            yield from _channels(value, inside, step)
        elif isinstance(value, TimedColumns):
            yield from _frame_variables(value, inside, name, step)
        elif isinstance(value, list) and len(value) > 1:
            if value is not names and value is not units:
                own.append(Variable(table, name, value, unit=unit, step=step))
        elif _kind(value) in "biufmM":
            own += _array_variables(value, table, name, names, units, unit, step)
    yield from (
        _with_time(_rename_vectors(own, names, units))
        if table
        else _rename_vectors(own, names, units)
    )


def _array_variables(
    value: Any,
    table: str,
    name: str,
    names: Sequence[str],
    units: Sequence[str],
    unit: str,
    step: float | None,
) -> list[Variable]:
    shape = value.shape
    if sum(n > 1 for n in shape) == 1:
        return [Variable(table, name, value, unit=unit, step=step)]
    if len(shape) != 2 or min(shape) < 2:
        return []
    axis = 1 if shape[1] == len(names) or shape[0] >= shape[1] else 0
    count = shape[axis]
    known = len(names) == count
    return [
        Variable(
            table,
            names[k] if known else f"{name}_{k + 1}",
            value,
            (axis, k),
            unit=units[k] if known and len(units) == count else unit,
            step=step,
        )
        for k in range(count)
    ]


def _rename_vectors(
    own: list[Variable], names: Sequence[str], units: Sequence[str]
) -> list[Variable]:
    """Vectors by the names beside them, where there are as many: what a language that
    allows no such names has called otherwise."""
    vectors = [one for one in own if one.part is None]
    if not names or len(vectors) != len(names) or len(vectors) != len(own):
        return own
    spelt = [re.sub(r"\W", "_", n, flags=re.ASCII).strip("_") for n in names]
    same = [s in one.name or one.name in s for s, one in zip(spelt, own, strict=True)]
    if not all(same):
        return own
    told = units if len(units) == len(names) else [one.unit for one in own]
    return [
        dataclasses.replace(one, name=n, unit=u)
        for one, n, u in zip(own, names, told, strict=True)
    ]


def _with_time(own: list[Variable]) -> list[Variable]:
    """Vectors of one length beside one time get it."""
    times = [
        one
        for one in own
        if _TIME_NAMES.fullmatch(one.name) and _kind(one.values) in "iufmM"
    ]
    if len(times) > 1:  # a T beside a time is a temperature, or a torque
        times = [one for one in times if one.name.lower() != "t"]
    if len(times) != 1:
        return own
    t = times[0]
    stamps = _stamps(t.read(), time_unit_in(t.unit, t.name))
    return [
        dataclasses.replace(one, time=stamps, stamps=one is t)
        if one.rows == t.rows
        else one
        for one in own
    ]


def _is_known_time(one: Variable) -> bool:
    """Whether it is a time, and channels have that already."""
    if one.name.lower() == "t" and one.time is not None and not one.stamps:
        return False
    return bool(_TIME_NAMES.fullmatch(one.name) and _step(one))


def _stamps(t: np.ndarray, unit: str | None) -> np.ndarray:
    if t.dtype.kind in "mM":
        return count_from_first(t)
    return np.asarray(t, float) * TIME_UNITS[unit or "s"]


def _frame_variables(
    frame: TimedColumns, table: str, name: str, step: float | None
) -> Iterator[Variable]:
    own = [
        Variable(
            table,
            column or name.rsplit(".", 1)[-1],
            values,
            time=frame.time,
            unit=frame.units.get(column, ""),
            labels=frame.labels.get(column, ()),
            step=step,
        )
        for column, values in frame.columns.items()
        if isinstance(values, list) or np.ndim(values) == 1
    ]
    yield from own if frame.time is not None else _with_time(own)


def _texts(branch: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """The names and the units that stand beside the variables, if any do."""
    texts = {
        name: value
        for name, value in branch.items()
        if isinstance(value, list) and value and all(isinstance(v, str) for v in value)
    }
    units = next((v for k, v in texts.items() if "unit" in k.lower()), [])
    names = [
        v
        for k, v in texts.items()
        if _LABEL_NAMES.fullmatch(k) and "unit" not in k.lower()
    ]
    items = [v for k, v in texts.items() if k.endswith("items")]
    return ([*items, *names, []])[0], units


def _own_step(branch: Mapping[str, Any]) -> float | None:
    """A sample time [s], or a rate [1/s], as a number beside the channels."""
    for name, value in branch.items():
        value = value.array if isinstance(value, WithUnit) else value
        if hasattr(value, "shape") and int(np.prod(value.shape)) == 1:
            if value.dtype.kind not in "iuf":
                continue
            number = float(np.asarray(value[()]).ravel()[0])
            if number > 0 and _STEP_NAMES.fullmatch(name):
                return number
            if number > 0 and _RATE_NAMES.fullmatch(name):
                return 1 / number
    return None


def _step(one: Variable) -> float | None:
    """Median distance of the first stamps, or the sample time beside it [s]."""
    if one.time is not None and len(one.time) > 1:
        return float(f"{np.median(np.diff(one.time[:200])):.9g}")
    return one.step


def _kind(values: Any) -> str:
    return values.dtype.kind if hasattr(values, "dtype") else "text"


def _find_channel(path: Path, found: list[Variable], name: str, table: str) -> Variable:
    """The channel of a name, in `table` where one is asked for."""
    inside = [
        one
        for one in found
        if not table or one.table == table or one.table.startswith((f"{table}.",))
    ]
    if table and not inside:
        tables = sorted({one.table for one in found})
        raise DataFileError(
            f"{path}: there is no variable {table!r} that holds channels. "
            f"{suggest(table, tables)}",
            path=path,
        )
    same = [one for one in inside if one.path == name] or [
        one for one in inside if one.name == name
    ]
    if len(same) == 1:
        return same[0]
    if not same:
        raise DataFileError(
            f"{path}: there is no channel {name!r}. "
            f"{suggest(name, dict.fromkeys(one.name for one in inside))}",
            path=path,
        )
    places = ", ".join(repr(one.path) for one in same[:8])
    more = f" and {len(same) - 8} more" if len(same) > 8 else ""
    raise DataFileError(
        f"{path}: channel {name!r} is there {len(same)} times: {places}{more}. Say "
        "which by column = ..., or by table = ... under [data].",
        path=path,
    )


def _times(path: Path, chosen: list[Variable]) -> list[Any]:
    """The time of every channel, or none of any; those without one must be as long as
    each other, or as the time of the others."""
    timed = [one.time for one in chosen if one.time is not None]
    lengths = {one.path: one.rows for one in chosen if one.time is None}
    if timed:
        for name, rows in lengths.items():
            if rows != len(timed[0]):
                raise DataFileError(
                    f"{path}: channel {name} has {rows} samples and no time, others "
                    f"have {len(timed[0])}. Leave it out.",
                    path=path,
                )
        return [timed[0] if one.time is None else one.time for one in chosen]
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{n} {rows}" for n, rows in list(lengths.items())[:8])
        raise DataFileError(
            f"{path}: the channels are not of one length (samples: {told}). Take those "
            "of one variable, by table = ... under [data].",
            path=path,
        )
    steps = {one.step for one in chosen}
    step = steps.pop() if len(steps) == 1 else None
    if step is None:
        return [None] * len(chosen)
    return [step * np.arange(chosen[0].rows)] * len(chosen)


def _numbers(path: Path, one: Variable) -> np.ndarray:
    if isinstance(one.values, list):
        told = sorted(set(one.values))
        shown = ", ".join(repr(t[:40]) for t in told[:8])
        if not all(_is_number(t) for t in told):
            what = f"channel {one.name} holds text: {shown}"
            raise DataFileError(
                f"{path}: {what}. Choose a numeric one.",
                path=path,
            )
        return np.array([float(t) if t else np.nan for t in one.values])
    x = one.read()
    if x.dtype.kind in "mM":
        return _stamps(x, None)
    return np.asarray(x, float)


def _is_number(text: str) -> bool:
    try:
        float(text or "nan")
    except ValueError:
        return False
    return True
