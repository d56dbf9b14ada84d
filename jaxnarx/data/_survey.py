"""Survey of a folder of measurements: channels, time, layout, and a proposal which
channels are inputs and outputs, and which records train and test."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxnarx.data.families import NUMBER_MARK, Family, find_family
from jaxnarx.data.files import file_layout
from jaxnarx.data.readers import KINDS, contents
from jaxnarx.data.readers.columns import (
    Asked,
    Column,
    CsvLayout,
    Table,
    numbers,
    seconds,
)
from jaxnarx.data.readers.csv_layout import find_layout
from jaxnarx.data.roles import (
    ChannelGuess,
    assign_roles,
    counts_rows,
    find_twins,
    look_at,
)
from jaxnarx.data.runs import Run, find_cycles, find_odd, propose_parts
from jaxnarx.data.sampling import STATIC_ADVICE, find_sampling, time_unit_in
from jaxnarx.errors import DataError, DataFileError, JaxnarxError, SpecError, suggest

AT_ONCE = 40
"""Columns read at a time."""
SURVEY_SAMPLES = 20_000
"""Samples of a file that are kept for a look, evenly spaced."""


_TIME_NAMES = re.compile(
    r"((t|ts|time|zeit|timestamp|uhrzeit)(_(s|sec|ms|us|min|h))?|date.*|datum.*)\b.*"
    r"|.*\btime",
    re.I,
)


@dataclasses.dataclass(frozen=True)
class Survey:
    """A proposal for a description of `files`; see `survey`.

    `cycles` are records that repeat each other's inputs; `parts` those that train and
    test, or all under `"files"`. `odd` tells of records in which a channel seems to be
    in another unit.
    """

    files: tuple[Path, ...]
    layout: CsvLayout
    table: str
    time: str
    time_unit: str
    sample_time: float | None
    channels: tuple[ChannelGuess, ...]
    only_in: Mapping[str, int]
    cycles: tuple[tuple[Run, ...], ...]
    parts: Mapping[str, tuple[Run, ...]]
    remarks: tuple[str, ...] = ()
    odd: Mapping[Run, str] = dataclasses.field(default_factory=dict)

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

    Channels that not all files hold are not proposed. A channel that is constant, the
    same as another, text, or mostly missing is left out with that as its reason.
    `outputs` and `inputs` name what is known; others are guessed by their names and by
    whether they move in steps. `sample_time` [s] is needed where the files do not tell
    the time, `columns` where CSV files have no header.
    """
    layout = file_layout(files[0])
    if columns:
        layout = dataclasses.replace(layout, columns=tuple(columns))
    asked = Asked(layout, table, sample_time)
    every = [contents(file, asked) for file in files]
    runs = tuple(Run(file) for file in files)
    families = [f for f in map(_channel_family, every) if f is not None and not table]
    if len(families) == len(files):
        every = [list(f.columns.values()) for f in families]
        pairs = zip(files, families, strict=True)
        runs = tuple(Run(file, m) for file, f in pairs for m in f.members)
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
    if runs[0].member:
        remarks.append(
            f"numbered columns are records: {len(runs)} of {', '.join(common)}"
        )
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
        time, unit, sample_time, told = _time(runs[0], common, asked, sample_time)
        remarks += told
    names = [name for name in common if name != time]
    looked = [_values(run, names, asked) for run in runs]
    reasons = {n: why for _, found in looked for n, why in found.items()}
    seen = [
        look_at(common[n], [values[n] for values, _ in looked])
        for n in names
        if n not in reasons
    ]
    twins = find_twins(seen, looked)
    channels = assign_roles(seen, twins, looked, outputs, inputs)
    channels += [
        ChannelGuess(
            n, common[n].unit, np.nan, np.nan, 1.0, "left out", why, common[n].step
        )
        for n, why in reasons.items()
    ]
    tied = find_cycles(runs, channels, looked)
    rows, step = _length(runs[0], time, unit, sample_time, names, asked)
    return Survey(
        *(tuple(files), layout, table, time, unit, sample_time),
        *(
            tuple(channels),
            only_in,
            tied,
            propose_parts(tied, [rows], step),
            tuple(remarks),
        ),
        find_odd(runs, channels, looked),
    )


def _channel_family(columns: Sequence[Column]) -> Family | None:
    return find_family(columns, _TIME_NAMES)


def _length(
    run: Run, time: str, unit: str, sample_time: float | None, names, asked: Asked
) -> tuple[int, float]:
    """Rows of a record and their distance [s]."""
    table = run.read([time or names[0]], asked)
    if not time:
        return len(table), sample_time or 0.0
    known = unit or time_unit_in(table.units.get(time, ""), time)
    t, _ = seconds(table.columns[time], name=time, place=table.place, unit=known)
    return len(t), sample_time or float(np.nanmedian(np.diff(t)))


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
    run: Run,
    columns: Mapping[str, Column],
    asked: Asked,
    sample_time: float | None,
) -> tuple[str, str, float | None, list[str]]:
    """Time column, its unit where it must be stated, sample time, and remarks."""
    given = sample_time
    likely = [
        n for n in columns if _TIME_NAMES.fullmatch(n.replace(NUMBER_MARK, "").strip())
    ]
    others = [n for n in columns if n not in likely][:1]  # files often begin with it
    for name in likely + others:
        table = run.read([name], asked)
        known = time_unit_in(table.units.get(name, ""), name)
        for unit in (None, "ms") if name in likely and not known else (known,):
            t = np.zeros(0)
            try:
                t, unit_found = seconds(
                    table.columns[name], name=name, place=table.place, unit=unit
                )
                step, _ = find_sampling(
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
            if name in others and counts_rows(t):
                continue
            stated = unit if unit and not known else ""
            return name, stated or "", given or (None if name in likely else step), []
    t = run.read(list(columns)[:1], asked).time
    if t is not None:
        step = float(np.median(np.diff(t)))
        return "", "", given or float(f"{step:.9g}"), []
    if given is None:
        raise DataFileError(
            f"{run.file}: no column tells the time. Give --sample-time in seconds. "
            f"{STATIC_ADVICE}",
            path=run.file,
        )
    return "", "", given, []


def _values(
    run: Run, names: Sequence[str], asked: Asked
) -> tuple[dict[str, Float[np.ndarray, " rows"]], dict[str, str]]:
    """Up to 20,000 samples of every channel, NaN where invalid; and why others have
    none."""
    found: dict[str, np.ndarray] = {}
    reasons: dict[str, str] = {}
    for first in range(0, len(names), AT_ONCE):
        part = list(names[first : first + AT_ONCE])
        try:
            tables = [(run.read(part, asked), part)]
        except (DataFileError, DataError):
            tables = []
            for name in part:
                try:
                    tables.append((run.read([name], asked), [name]))
                except JaxnarxError as error:
                    reasons[name] = _short(error)
        for table, own in tables:
            for name in own:
                try:
                    found[name] = _thin(table, name)
                except DataError as error:
                    reasons[name] = _short(error)
    return found, reasons


def _short(error: Exception) -> str:
    """The middle of a message: without the file, without the advice."""
    return str(error).split(": ", 1)[-1].split(". ")[0].rstrip(".")


def _thin(table: Table, name: str) -> Float[np.ndarray, " rows"]:
    x = numbers(table.columns[name], channel=name, place=table.place)
    x = x[:: max(1, -(-len(x) // SURVEY_SAMPLES))].astype(np.float64)
    return np.where(np.isfinite(x), x, np.nan)
