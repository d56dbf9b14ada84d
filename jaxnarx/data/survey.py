"""What is in a folder of measurements: channels, time, layout, and a proposal which
channels are inputs and outputs, and which records train and test."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.files import file_layout
from jaxnarx.data.missing import Source, alike, assemble
from jaxnarx.data.readers import KINDS, contents, read_table
from jaxnarx.data.readers.columns import (
    Asked,
    Column,
    CsvLayout,
    Table,
    numbers,
    seconds,
)
from jaxnarx.data.readers.csv_layout import find_layout
from jaxnarx.data.repeats import cycles
from jaxnarx.data.sampling import sampling, time_unit_in
from jaxnarx.errors import DataError, DataFileError, JaxnarxError, SpecError, suggest

AT_ONCE = 40
"""Columns read at a time."""
ROWS = 20_000
"""Samples of a file that are kept for a look, evenly spaced."""
SAME = 1e-9
"""Two channels are one where they differ by no more than this share of their spread."""
STEPS = 0.6
"""A channel that keeps its value from sample to sample this often moves in steps."""
EMPTY = 0.5
"""A channel with more missing samples than this share is left out."""
TEST = 5
"""One cycle in so many tests."""

_TIME = re.compile(r"(t|time|zeit|timestamp|date.*|datum.*|uhrzeit)\b.*|.*\btime", re.I)
_OUTPUT = re.compile(
    r"no_?x|(?<![a-z])(co2?|[tu]?hc|pn|pm|o2|md|be)(?![a-z])|soot|smoke|fsn|opac|emiss"
    r"|afr|exh|abgas|egt|cat(?![a-z])|catalyst|turbine|torque|trq|power|imep|pmi|bsfc"
    r"|consum|knock|noise|vib|oil|cool|temp|^t_",
    re.I,
)
_INPUT = re.compile(
    r"speed|rpm|n_?mot|(?<![a-z])(n|sa)(?![a-z])|drehzahl|load|last|throttle|thr|pedal"
    r"|inj|fue?l|fpw|ign|spark|zw|valve|vgt|wastegate|duty|cam|vvt|phi|rail|boost|set"
    r"|soll|cmd|demand|cut",
    re.I,
)
"""What channels are often called, of gasoline and diesel engines."""


@dataclasses.dataclass(frozen=True)
class ChannelGuess:
    """A channel that all files hold: its range, and what it is taken for and why.

    `role` is `"input"`, `"output"` or `"left out"`; `step` [s] its raster where it has
    one of its own; `missing` the share of samples that are not valid.
    """

    name: str
    unit: str
    low: float
    high: float
    missing: float
    role: str
    reason: str
    step: float | None = None


@dataclasses.dataclass(frozen=True)
class Survey:
    """A proposal for a description of `files`; see `survey`.

    `cycles` are files that repeat each other's inputs, by their names; `parts` the
    files that train and test, or all under `"files"`.
    """

    files: tuple[Path, ...]
    layout: CsvLayout
    table: str
    time: str
    time_unit: str
    sample_time: float | None
    channels: tuple[ChannelGuess, ...]
    only_in: Mapping[str, int]
    cycles: tuple[tuple[Path, ...], ...]
    parts: Mapping[str, tuple[Path, ...]]
    remarks: tuple[str, ...] = ()

    def of(self, role: str) -> list[ChannelGuess]:
        """The channels taken for `"input"`, `"output"` or `"left out"`."""
        return [one for one in self.channels if one.role == role]


def survey(
    files: Sequence[Path],
    *,
    columns: Sequence[str] = (),
    outputs: Sequence[str] = (),
    inputs: Sequence[str] = (),
    table: str = "",
    sample_time: float | None = None,
) -> Survey:
    """Look into files of measurements, and propose what to make of them.

    Channels that not all files hold are not proposed. What is constant, the same as
    another, text, or mostly missing is left out with that as its reason. `outputs` and
    `inputs` name what is known; others are guessed by their names and by whether they
    move in steps. `sample_time` [s] is needed where the files do not tell the time,
    `columns` where CSV files have no header.
    """
    layout = file_layout(files[0])
    if columns:
        layout = dataclasses.replace(layout, columns=tuple(columns))
    asked = Asked(layout, table, sample_time)
    every = [contents(file, asked) for file in files]
    table = table or _one_table(files[0], every[0])
    asked = dataclasses.replace(asked, table=table)
    common, only_in = _common(every, table)
    for name in (*outputs, *inputs):
        if name not in common:
            raise SpecError(
                f"no channel {name!r} in all files. {suggest(name, common)}",
                field="outputs" if name in outputs else "inputs",
            )
    rasters = [c.step for c in common.values() if c.step]
    time, unit, remarks = "", "", []
    if rasters:
        usual = float(np.median(rasters))
        sample_time = float(f"{usual:.6g}") if sample_time is None else sample_time
        asked = dataclasses.replace(asked, sample_time=sample_time)
        if len({f"{step:.3g}" for step in rasters}) > 1:
            told = sorted({float(f"{step:.3g}") for step in rasters})
            remarks.append(
                f"rasters of {', '.join(f'{s:g}' for s in told)} s; brought to "
                f"{sample_time:g} s"
            )
    else:
        time, unit, sample_time, told = _time(files[0], common, asked, sample_time)
        remarks += told
    names = [name for name in common if name != time]
    looked = [_values(file, names, asked) for file in files]
    reasons = {n: why for _, found in looked for n, why in found.items()}
    seen = [
        _seen(common[n], [values[n] for values, _ in looked])
        for n in names
        if n not in reasons
    ]
    twins = _twins(seen, looked)
    channels = _roles(seen, twins, looked, outputs, inputs)
    channels += [
        ChannelGuess(
            n, common[n].unit, np.nan, np.nan, 1.0, "left out", why, common[n].step
        )
        for n, why in reasons.items()
    ]
    tied = _cycles(files, channels, looked)
    return Survey(
        *(tuple(files), layout, table, time, unit, sample_time),
        *(tuple(channels), only_in, tied, _parts(files, tied), tuple(remarks)),
    )


def measurement_files(paths: Sequence[Path]) -> list[Path]:
    """Files, and all readable files of folders, in alphabetical order."""
    found: dict[Path, None] = {}
    for path in paths:
        if path.is_dir():
            own = sorted(p for p in path.iterdir() if _is_data(p))
            if not own:
                raise DataFileError(
                    f"{path}: no file that can be read ({', '.join(KINDS)}).", path=path
                )
            found |= dict.fromkeys(own)
        elif not path.is_file():
            raise DataFileError(f"{path}: there is no such file.", path=path)
        else:
            found[path] = None
    return list(found)


def _is_data(path: Path) -> bool:
    """Whether a file of a folder is one of measurements, as far as its kind tells."""
    kind = path.suffix.lower()
    if kind == ".txt":  # may be a licence as well
        return find_layout(path) is not None
    return kind in KINDS and path.is_file()


def _one_table(file: Path, columns: list[Column]) -> str:
    """The sheet, variable or group to read; empty where there is one alone."""
    tables = dict.fromkeys(c.table for c in columns)
    if len(tables) < 2 or any(c.step for c in columns):
        return ""
    raise SpecError(
        f"{file} holds several tables: {', '.join(tables)}. Say which by --table.",
        field="table",
    )


def _common(
    every: Sequence[Sequence[Column]], table: str
) -> tuple[dict[str, Column], dict[str, int]]:
    """Channels that all files hold, and how many hold the others."""
    count: dict[str, int] = {}
    first: dict[str, Column] = {}
    for columns in every:
        own = [c for c in columns if not table or c.table in ("", table)]
        for column in {c.name: c for c in own}.values():
            count[column.name] = count.get(column.name, 0) + 1
            first.setdefault(column.name, column)
    common = {n: c for n, c in first.items() if count[n] == len(every)}
    if not common:
        raise DataFileError(
            "The files have no channel in common. Describe those that belong together."
        )
    return common, {n: k for n, k in count.items() if k < len(every)}


def _time(
    file: Path,
    columns: Mapping[str, Column],
    asked: Asked,
    sample_time: float | None,
) -> tuple[str, str, float | None, list[str]]:
    """Time column, its unit where it must be stated, sample time, and remarks."""
    given = sample_time
    likely = [n for n in columns if _TIME.fullmatch(n.strip())]
    others = [n for n in columns if n not in likely][:1]  # files often begin with it
    for name in likely + others:
        table = read_table(file, [name], asked)
        known = time_unit_in(table.units.get(name, ""), name)
        for unit in (None, "ms") if name in likely and not known else (known,):
            t = np.zeros(0)
            try:
                t, unit_found = seconds(
                    table.columns[name], name=name, place=table.place, unit=unit
                )
                step, _ = sampling(
                    t,
                    column=name,
                    place=table.place,
                    sample_time=given,
                    split=True,
                    unit=unit_found,
                )
            except JaxnarxError as error:
                if name in likely and "not uniform" in str(error) and given is None:
                    steps = np.diff(t)
                    step = float(f"{np.median(steps):.3g}")
                    rough = f"{name} is not uniform; {step:g} s is its usual step"
                    return name, unit or "", step, [rough]
                continue
            if name in others and _counts(t):
                continue
            stated = unit if unit and not known else ""
            return name, stated or "", given or (None if name in likely else step), []
    t = read_table(file, list(columns)[:1], asked).time
    if t is not None:
        step = float(np.median(np.diff(t)))
        return "", "", given or float(f"{step:.9g}"), []
    if given is None:
        raise DataFileError(
            f"{file}: no column tells the time. Give --sample-time in seconds.",
            path=file,
        )
    return "", "", given, []


def _counts(t: Float[np.ndarray, " rows"]) -> bool:
    """Whether stamps are the numbers of their rows."""
    return len(t) > 1 and bool(np.all(np.diff(t) == 1))


def _values(
    file: Path, names: Sequence[str], asked: Asked
) -> tuple[dict[str, Float[np.ndarray, " rows"]], dict[str, str]]:
    """Up to 20,000 samples of every channel, NaN where invalid; and why others have
    none."""
    found: dict[str, np.ndarray] = {}
    reasons: dict[str, str] = {}
    for first in range(0, len(names), AT_ONCE):
        part = list(names[first : first + AT_ONCE])
        try:
            tables = [(read_table(file, part, asked), part)]
        except (DataFileError, DataError):
            tables = []
            for name in part:
                try:
                    tables.append((read_table(file, [name], asked), [name]))
                except JaxnarxError as error:
                    reasons[name] = _short(error)
        for table, own in tables:
            for name in own:
                try:
                    found[name] = _thinned(table, name)
                except DataError as error:
                    reasons[name] = _short(error)
    return found, reasons


def _short(error: Exception) -> str:
    """The middle of a message: without the file, without the advice."""
    return str(error).split(": ", 1)[-1].split(". ")[0].rstrip(".")


def _thinned(table: Table, name: str) -> Float[np.ndarray, " rows"]:
    x = numbers(table.columns[name], channel=name, place=table.place)
    x = x[:: max(1, -(-len(x) // ROWS))].astype(np.float64)
    return np.where(np.isfinite(x), x, np.nan)


def _seen(column: Column, values: Sequence[Float[np.ndarray, " rows"]]) -> ChannelGuess:
    """Range and share missing; constants and empty channels are left out."""
    x = np.concatenate(values)
    known = x[np.isfinite(x)]
    missing = 1 - len(known) / max(len(x), 1)
    low, high = (
        (float(known.min()), float(known.max())) if len(known) else (np.nan,) * 2
    )
    role, reason = "", ""
    if missing > EMPTY:
        role, reason = "left out", f"{missing:.0%} of the samples are missing"
    elif all(len(v) > 2 and _counts(v) for v in values):
        role, reason = "left out", "counts its rows"
    elif not high > low:
        role, reason = "left out", f"constant at {low:g}"
    return ChannelGuess(
        column.name, column.unit, low, high, missing, role, reason, column.step
    )


def _twins(seen: Sequence[ChannelGuess], looked) -> dict[str, str]:
    """Channels that are the same as an earlier one, up to scale and offset."""
    alive = [one.name for one in seen if not one.role]
    if not alive:
        return {}
    rows = min(sum(len(values[n]) for values, _ in looked) for n in alive)
    known = np.stack(
        [np.concatenate([values[n] for values, _ in looked])[:rows] for n in alive]
    )
    good = np.isfinite(known).all(axis=0)
    if good.sum() < 10:
        return {}
    x = known[:, good]
    x = x - x.mean(axis=1, keepdims=True)
    size = np.sqrt((x**2).sum(axis=1, keepdims=True))
    x = x / np.where(size > 0, size, 1.0)
    alike = np.abs(x @ x.T) > 1 - SAME
    found = {}
    for i, name in enumerate(alive):
        earlier = [alive[j] for j in range(i) if alike[i, j] and alive[j] not in found]
        if earlier:
            found[name] = earlier[0]
    return found


def _roles(
    seen: Sequence[ChannelGuess],
    twins: Mapping[str, str],
    looked,
    outputs: Sequence[str],
    inputs: Sequence[str],
) -> list[ChannelGuess]:
    """Every channel with its role and the reason for it."""

    def role(one: ChannelGuess) -> tuple[str, str]:
        if one.name in outputs or one.name in inputs:
            return ("output" if one.name in outputs else "input"), "as asked for"
        if one.role:
            return one.role, one.reason
        if one.name in twins and twins[one.name] not in (*outputs, *inputs):
            return "left out", f"the same as {twins[one.name]}, up to scale"
        if one.name in twins:
            return "left out", f"the same as {twins[one.name]}"
        if inputs:
            return "left out", "not asked for"
        if _OUTPUT.search(one.name):
            if outputs:
                return "left out", "its name speaks of an output that is not asked for"
            return "output", "by its name"
        if _INPUT.search(one.name):
            return "input", "by its name"
        x = np.concatenate([values[one.name] for values, _ in looked])
        still = float(np.mean(np.diff(x[np.isfinite(x)]) == 0))
        if still > STEPS:
            return "input", f"moves in steps ({still:.0%} of the samples keep still)"
        if outputs:
            return "input", "neither its name nor its course says what it is"
        return "output", "it moves smoothly, and its name says nothing"

    return [
        dataclasses.replace(one, role=found[0], reason=found[1])
        for one in seen
        for found in [role(one)]
    ]


def _cycles(
    files: Sequence[Path], channels: Sequence[ChannelGuess], looked
) -> tuple[tuple[Path, ...], ...]:
    """Files whose inputs repeat each other; every file is in one."""
    inputs = [c.name for c in channels if c.role == "input"]
    alone = tuple((file,) for file in files)
    if not inputs or len(files) < 2:
        return alone
    names = Channels(tuple(map(Channel, inputs)), (Channel("every sample"),))
    sources = []
    for file, (values, _) in zip(files, looked, strict=True):
        rows = min(len(values[n]) for n in inputs)
        x = [np.nan_to_num(values[n][:rows], nan=0.0) for n in inputs]
        x.append(np.ones(rows))
        sources.append(Source(str(file), np.stack(x, axis=1)))
    try:
        data = Dataset(assemble(alike(sources), names, 1.0, "mask"), names, 1.0)
        found = cycles(data)
    except DataError:
        return alone
    return tuple(tuple(files[r] for r in sorted(c.records)) for c in found)


def _parts(
    files: Sequence[Path], tied: Sequence[Sequence[Path]]
) -> dict[str, tuple[Path, ...]]:
    """Whole cycles train or test, one in five the latter; one alone is not divided.

    Files that say in their names what they are for are taken at their word.
    """
    if len(tied) < 2:
        return {"files": tuple(files)}
    said = {
        part: tuple(f for f in files if re.search(rf"(?<![a-z]){part}", f.stem, re.I))
        for part in ("train", "validat", "test")
    }
    if said["train"] and sum(map(len, said.values())) == len(files):
        named = {"validate" if p == "validat" else p: own for p, own in said.items()}
        return {part: own for part, own in named.items() if own}
    order = sorted(tied, key=lambda own: files.index(own[0]))
    last = min(TEST, len(order)) - 1
    testing = {file for own in order[last::TEST] for file in own}
    return {
        "train": tuple(f for f in files if f not in testing),
        "test": tuple(f for f in files if f in testing),
    }
