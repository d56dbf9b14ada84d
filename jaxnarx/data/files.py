"""Datasets from files, as a TOML description says (`jaxnarx.settings.description`)."""

import dataclasses
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.crop import Cut, trigger_columns
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.description import PARTS, Description, load_description
from jaxnarx.data.digest import fingerprint
from jaxnarx.data.families import NUMBER_MARK, is_numbered, list_members, read_member
from jaxnarx.data.file_patterns import find_files, find_groups, require_inside
from jaxnarx.data.frames import one_sample_time
from jaxnarx.data.missing import Source, assemble, unify_types
from jaxnarx.data.preparation import Preparation
from jaxnarx.data.readers.columns import CsvLayout, Table, numbers, table_source
from jaxnarx.data.readers.csv_layout import find_layout
from jaxnarx.data.units import Conversion, bare, conversion
from jaxnarx.errors import DataFileError, SpecError, guard_reading, suggest
from jaxnarx.formatting import brief, count, page
from jaxnarx.settings import Physics

MAX_BYTES = 4e9
"""Limit of the expanded size of all files of a description, in bytes. Reading takes up
to five times as much memory for a moment."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Split:
    """The parts of a description; a part that it does not name is None.

    `preparation` is what was done to the files before, if the description says so;
    `physics` is what it states of gains and time constants, by output; every sample of
    `at_rest` is an operating point.
    """

    train: Dataset | None
    validate: Dataset | None
    test: Dataset | None
    all: Dataset
    preparation: Preparation | None = None
    physics: Mapping[str, Physics] = dataclasses.field(default_factory=dict)
    at_rest: Dataset | None = None

    def __str__(self) -> str:
        parts = {"train": self.train, "validate": self.validate, "test": self.test}
        told = [f"{name}: {part}" for name, part in parts.items() if part is not None]
        if self.preparation is not None:
            told.append(str(self.preparation))
        told += [f"{name} {physics}" for name, physics in self.physics.items()]
        if self.at_rest is not None:
            told.append(count(self.at_rest.samples, "operating point") + " at rest")
        return "\n\n".join(told)

    __repr__, _repr_html_ = brief, page


@guard_arguments
def read(
    path: str | os.PathLike[str],
    *,
    root: str | os.PathLike[str] | None = None,
    max_bytes: float = MAX_BYTES,
) -> Dataset:
    """All records of a TOML description: train, then validate, then test.

    Records are named after their files, with the parent folder where two names collide.

    Args:
        path: The description; see `jaxnarx.settings.description` for the format.
        root: The folder that paths in it are relative to; default the environment
            variable `JAXNARX_DATA`, else the folder of the description.
        max_bytes: More than this when expanded is refused before reading.

    Returns:
        The records as one dataset.
    """
    return _read(Path(path), load_description(Path(path)), root, max_bytes)[0]


@guard_arguments
def read_split(
    path: str | os.PathLike[str],
    *,
    root: str | os.PathLike[str] | None = None,
    max_bytes: float = MAX_BYTES,
) -> Split:
    """The parts of a TOML description.

    A record that is in two parts, by its path or by its contents, is a SpecError.

    Args:
        path: The description, as in `read`.
        root: As in `read`.
        max_bytes: As in `read`.

    Returns:
        `train`, `validate`, `test`, None where it does not name them, and `all` as by
        `read`. A description that lists `files` gives only `all`. Files of `at_rest`
        are in none of these.
    """
    path = Path(path)
    description = load_description(path)
    data, parts = _read(path, description, root, max_bytes)
    _require_disjoint(data, parts, path)
    chosen = {
        part: data[[i for i, p in enumerate(parts) if p == part]]
        for part in PARTS
        if part in parts
    }
    return Split(
        *(chosen.get(part) for part in PARTS),
        all=data,
        preparation=_preparation(path, description, root),
        physics=description.physics,
        at_rest=_read_at_rest(path, description, root, max_bytes, data),
    )


def read_files(
    paths: Sequence[str | os.PathLike[str]],
    channels: Channels,
    *,
    sample_time: float,
    missing: str = "refuse",
    max_bytes: float = MAX_BYTES,
) -> Dataset:
    """Records from files of any kind whose columns are named like `channels`.

    For a model's own channels: no description is needed. Every file must hold all of
    them; other columns are ignored.
    """
    description = Description(
        channels=channels,
        columns={name: name for name in channels.names},
        patterns={},
        sample_time=sample_time,
        time=None,
        missing=missing,
        root=".",
    )
    files = [Path(p) for p in paths]
    for file in files:
        if not file.is_file():
            raise DataFileError(f"{file}: there is no such file.", path=file)
    layouts = [file_layout(file) for file in files]
    if layouts and all(layout == layouts[0] for layout in layouts):
        description = dataclasses.replace(description, layout=layouts[0])
    folder = Path(os.path.commonpath([f.resolve().parent for f in files]))
    names = _record_names([f.resolve() for f in files], folder)
    chosen: list[tuple[Path, Cut | None]] = [(file, None) for file in files]
    named = dict(zip(files, names, strict=True))
    return _assemble_records(chosen, named, description, max_bytes)[0]


def file_layout(path: Path) -> CsvLayout:
    """Find out how a CSV file is written, as far as it can be."""
    if path.suffix.lower() not in (".csv", ".txt"):
        return CsvLayout()
    with guard_reading(path, "CSV"):
        return find_layout(path) or CsvLayout()


def _preparation(path: Path, description: Description, root) -> Preparation | None:
    """The preparation that the description names; a damaged one is a DataFileError."""
    if description.preparation is None:
        return None
    file = _root(path, root, description) / description.preparation
    with guard_reading(file, "a preparation", advice="Prepare the files anew."):
        try:
            return Preparation.from_dict(json.loads(file.read_text(encoding="utf-8")))
        except (ValueError, RecursionError) as error:
            raise DataFileError(
                f"{file}: not what `jaxnarx prepare` writes: {error}", path=file
            ) from error


def _read(
    path: Path, description: Description, root, max_bytes
) -> tuple[Dataset, list[str]]:
    """All records, and the part each belongs to."""
    with guard_reading(path, "a description", advice="Correct it."):
        folder = _root(path, root, description)
        found = find_files(description, folder, path)
        groups = find_groups(description, folder, path, found)
    chosen, names = _name_files(found, folder)
    data, origin = _assemble_records(chosen, names, description, max_bytes)
    records = tuple(
        dataclasses.replace(record, group=groups.get(found[n][0], ""))
        for record, n in zip(data, origin, strict=True)
    )
    return dataclasses.replace(data, records=records), [found[n][2] for n in origin]


def _read_at_rest(
    path: Path, description: Description, root, max_bytes: float, data: Dataset
) -> Dataset | None:
    """The operating points that the description names; its rows have no time."""
    if not description.at_rest:
        return None
    own = dataclasses.replace(
        description,
        channels=data.channels,
        patterns={"at_rest": description.at_rest},
        sample_time=data.sample_time,
        time=None,
        missing="mask",
    )
    with guard_reading(path, "a description", advice="Correct it."):
        folder = _root(path, root, description)
        found = find_files(own, folder, path)
        parts = {file for file, *_ in find_files(description, folder, path)}
    chosen, names = _name_files(found, folder)
    for file in names:
        if file in parts:
            raise SpecError(
                f"{path}: {file.name} is among the records and at rest; take it out of "
                "one of them, say by a pattern that begins with !",
                field="records.at_rest",
            )
    return _assemble_records(chosen, names, own, max_bytes, timed=False)[0]


def _name_files(
    found: list[tuple[Path, Cut | None, str]], folder: Path
) -> tuple[list[tuple[Path, Cut | None]], dict[Path, str]]:
    """Files with what is cut from them, and the names of their records."""
    files = list(dict.fromkeys(file for file, *_ in found))
    names = dict(zip(files, _record_names(files, folder), strict=True))
    return [(file, cut) for file, cut, _ in found], names


def _assemble_records(
    chosen: list[tuple[Path, Cut | None]],
    names: dict[Path, str],
    description: Description,
    max_bytes: float,
    *,
    timed: bool = True,
) -> tuple[Dataset, list[int]]:
    """The records of files, or of what is cut from them, and which of `chosen` each
    comes from; `names` are those of the files. Files that tell the time are refused
    where rows are not to be `timed`."""
    sources: list[list[Source]] = [[] for _ in chosen]
    steps, notes = [], []
    channels, stated_by = description.channels, {}
    left = max_bytes
    wanted = [*description.wanted, *trigger_columns(cut for _, cut in chosen)]
    for n, file, cut, member in _each(chosen, description):
        asked = dataclasses.replace(description.asked, max_bytes=left)
        table = read_member(file, wanted, asked, member)
        if table.time is None:
            description.require_time()
        elif not timed:
            raise DataFileError(
                f"{file}: its channels have times of their own, and operating points "
                "at rest have none. Write them to a table, a row for each point.",
                path=file,
            )
        notes += [(table.place.lead, note) for note in table.notes]
        left -= 8 * len(table) * len(table.columns)
        units = {n: table.units.get(c, "") for n, c in description.columns.items()}
        channels, how = _apply_units(channels, units, stated_by, table.place.name)
        with guard_reading(file, "numbers"):
            source, step = table_source(
                table,
                channels,
                description.columns,
                name=f"{names[file]} {NUMBER_MARK}{member}" if member else names[file],
                time=description.time,
                time_unit=description.time_unit,
                sample_time=description.sample_time,
                split=description.missing == "split",
            )
            pieces = [source]
            if cut is not None and not cut.members:
                pieces = _cut(source, cut, step, table)
        converted = [_convert_units(one, channels, how, units) for one in pieces]
        notes += [(table.place.lead, note) for note in converted[0][1]]
        sources[n] += [one for one, _ in converted]
        steps.append((table.place.name, step))
    step = one_sample_time(steps)
    place = {one.name: n for n, own in enumerate(sources) for one in own}
    every = unify_types([one for own in sources for one in own])
    records = assemble(every, channels, step, description.missing)
    # pieces of a record that is split are called name#1, ...
    known = [r.name if r.name in place else r.name.rpartition("#")[0] for r in records]
    data = Dataset(records, channels, step, _merge_notes(notes))
    return data, [place[name] for name in known]


def _each(
    chosen: list[tuple[Path, Cut | None]], description: Description
) -> Iterator[tuple[int, Path, Cut | None, str]]:
    """The place of each of `chosen`, its file and cut, and a number of its columns
    where they are numbered."""
    numbered = is_numbered(description)
    for n, (file, cut) in enumerate(chosen):
        known = list_members(file, description) if numbered else ()
        wanted = cut.members if cut is not None else ()
        for member in wanted:
            if member not in known:
                raise SpecError(
                    f"{file}: there are no columns numbered {member!r}. "
                    f"{suggest(member, known)}",
                    field="records",
                )
        for member in wanted or known or ("",):
            yield n, file, cut, member


def _merge_notes(notes: list[tuple[str, str]]) -> tuple[str, ...]:
    """Notes with what leads them; what several files have alike is told once."""
    files: dict[str, dict[str, None]] = {}
    for lead, note in notes:
        own = lead if note.startswith(lead) else ""
        files.setdefault(note.removeprefix(own), {})[own] = None
    told = []
    for text, (first, *more) in files.items():
        others = f" and {len(more)} more: " if more else ""
        told.append((first.removesuffix(": ") + others if more else first) + text)
    return tuple(told)


def _cut(source: Source, cut: Cut, step: float, table: Table) -> list[Source]:
    """Cut a source, by time or by a column of its table."""
    trigger = None
    if cut.column:
        column = table.columns[cut.column]
        trigger = numbers(column, channel=cut.column, place=table.place)
    return cut.pieces(source, step, trigger)


def _root(path: Path, root, description: Description) -> Path:
    """The folder of the files. One that is given holds all that is read; a description
    alone may name any folder.
    """
    given = root if root is not None else os.environ.get("JAXNARX_DATA")
    base = Path(given) if given else path.parent
    origin = "the description's own folder"
    if given:
        origin = "JAXNARX_DATA" if root is None else "the argument root"
    folder = base / description.root
    if given:
        require_inside(folder, base, path, "data.root")
    if not folder.is_dir():
        raise DataFileError(
            f"{path}: the data folder {folder} does not exist (from {origin}). Give "
            "root=..., or set the environment variable JAXNARX_DATA.",
            path=folder,
        )
    return folder


def _apply_units(
    channels: Channels, units: dict[str, str], stated_by: dict[str, str], source: str
) -> tuple[Channels, dict[str, Conversion]]:
    """The channels, with units that the file `source` states where they have none, and
    how values of the file become theirs, by channel.

    `stated_by` remembers which file a unit comes from that the description lacks.
    """
    how: dict[str, Conversion] = {}

    def apply_unit(channel: Channel) -> Channel:
        own = bare(units[channel.name])
        if own and channel.unit:
            found = conversion(own, channel.unit)
            if found is None:
                by = stated_by.get(channel.name, "the description")
                raise SpecError(
                    f"{source}: {channel.name} is in {own!r}, but in {channel.unit!r} "
                    f"according to {by}. Convert the file, or correct the unit.",
                    field=channel.name,
                )
            if found != (1.0, 0.0):
                how[channel.name] = found
        if own and not channel.unit:
            stated_by[channel.name] = source
        return Channel(channel.name, channel.unit or own)

    found = Channels(
        tuple(map(apply_unit, channels.inputs)),
        tuple(map(apply_unit, channels.outputs)),
    )
    return found, how


def _convert_units(
    source: Source, channels: Channels, how: dict[str, Conversion], units: dict
) -> tuple[Source, tuple[str, ...]]:
    """The rows in the units of the channels, and what was converted."""
    if not how:
        return source, ()
    x, notes = source.x.copy(), []
    for name, convert in how.items():
        s = channels.signal(name)
        x[:, s] = convert(x[:, s])
        unit = channels.all[s].unit
        notes.append(
            f"{source.place.lead}{name} converted from {bare(units[name])} to {unit}, "
            f"{convert}"
        )
    return dataclasses.replace(source, x=x), tuple(notes)


def _record_names(files: list[Path], folder: Path) -> list[str]:
    """Stems, else parent/stem, else the whole relative path: the first that differ."""
    paths = [file.relative_to(folder) for file in files]
    for parts in (1, 2):
        names = ["/".join(p.with_suffix("").parts[-parts:]) for p in paths]
        if len(set(names)) == len(names):
            return names
    return [p.as_posix() for p in paths]


def _require_disjoint(data: Dataset, parts: list[str], path):
    seen: dict[str, tuple[str, str]] = {}
    for record, part in zip(data, parts, strict=True):
        key = fingerprint(record, data.channels.names)
        name, first = seen.setdefault(key, (record.name, part))
        if first != part:
            raise SpecError(
                f"{path}: {record.name} in {part} has the same contents as {name} in "
                f"{first}. A record may serve one part only.",
                field=f"records.{part}",
            )
