"""Datasets from files, as a TOML description says (its format: `description`)."""

import dataclasses
import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.columns import Table, table_source
from jaxnarx.data.construct import alike
from jaxnarx.data.csv_table import CsvLayout
from jaxnarx.data.dataset import Dataset, Record
from jaxnarx.data.description import PARTS, Description, load_description
from jaxnarx.data.frames import one_sample_time
from jaxnarx.data.missing import assemble
from jaxnarx.data.preparation import Preparation
from jaxnarx.data.tables import read_table
from jaxnarx.errors import DataFileError, SpecError

MAX_BYTES = 4e9
"""Limit of the expanded size of all files of a description, in bytes."""


@dataclasses.dataclass(frozen=True, eq=False)
class Split:
    """The parts of a description; a part that it does not name is None.

    `preparation` is what was done to the files before, if the description says so.
    """

    train: Dataset | None
    validate: Dataset | None
    test: Dataset | None
    all: Dataset
    preparation: Preparation | None = None


def read(
    path: str | os.PathLike[str],
    *,
    root: str | os.PathLike[str] | None = None,
    max_bytes: float = MAX_BYTES,
) -> Dataset:
    """All records of the TOML description at `path`: train, then validate, then test.

    See `jaxnarx.data.description` for the format. `root` is the folder that paths in
    the description are relative to; default the environment variable `JAXNARX_DATA`,
    else the folder of the description. Records are named after their files, with the
    parent folder where two names collide. More than `max_bytes` when expanded is
    refused before reading.
    """
    return _read(Path(path), load_description(Path(path)), root, max_bytes)[0]


def read_split(
    path: str | os.PathLike[str],
    *,
    root: str | os.PathLike[str] | None = None,
    max_bytes: float = MAX_BYTES,
) -> Split:
    """The parts `train`, `validate`, `test` of a description, and `all` as by `read`.

    A description that lists `files` gives only `all`. A record that is in two parts, by
    its path or by its contents, is a SpecError.
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
    )


def read_files(
    paths: Sequence[str | os.PathLike[str]],
    channels: Channels,
    *,
    sample_time: float,
    missing: str = "refuse",
    max_bytes: float = MAX_BYTES,
) -> Dataset:
    """Records from CSV or Parquet files whose columns are named like `channels`.

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
        layout=CsvLayout(),
    )
    files = [Path(p) for p in paths]
    for file in files:
        if not file.is_file():
            raise DataFileError(f"{file}: there is no such file.", path=file)
    tables = _tables(files, description, max_bytes)
    own = _with_file_units(description, tables)
    folder = Path(os.path.commonpath([f.resolve().parent for f in files]))
    names = _record_names([f.resolve() for f in files], folder)
    sources = alike(
        [
            table_source(
                table,
                own,
                description.columns,
                name=name,
                time=None,
                sample_time=sample_time,
                split=missing == "split",
            )[0]
            for name, table in zip(names, tables, strict=True)
        ]
    )
    return assemble(sources, own, sample_time=sample_time, missing=missing)


def _preparation(path: Path, description: Description, root) -> Preparation | None:
    """The preparation that the description names; a damaged one is a DataFileError."""
    if description.preparation is None:
        return None
    file = _root(path, root, description) / description.preparation
    try:
        return Preparation.from_dict(json.loads(file.read_text(encoding="utf-8")))
    except OSError as error:
        raise DataFileError(
            f"{path}: the preparation {file} cannot be opened "
            f"({error.strerror or error}).",
            path=file,
        ) from error
    except (ValueError, RecursionError) as error:
        raise DataFileError(
            f"{file}: not what `jaxnarx prepare` writes: {error}", path=file
        ) from error


def _read(
    path: Path, description: Description, root, max_bytes
) -> tuple[Dataset, list[str]]:
    """All records, and the part each belongs to."""
    folder = _root(path, root, description)
    found = _find(description, folder, path)
    files = [file for file, _ in found]
    tables = _tables(files, description, max_bytes)
    channels = _with_file_units(description, tables)
    parts = [
        table_source(
            table,
            channels,
            description.columns,
            name=name,
            time=description.time,
            sample_time=description.sample_time,
            split=description.missing == "split",
        )
        for name, table in zip(_record_names(files, folder), tables, strict=True)
    ]
    step = one_sample_time([(s.place.name, dt) for s, dt in parts])
    sources = alike([s for s, _ in parts])
    data = assemble(sources, channels, sample_time=step, missing=description.missing)
    part_of = {s.name: part for s, (_, part) in zip(sources, found, strict=True)}
    return data, [part_of[_source_name(r, part_of)] for r in data]


def _source_name(record: Record, known) -> str:
    """The file a record came from; pieces of a split file are called name#1, ..."""
    return record.name if record.name in known else record.name.rpartition("#")[0]


def _root(path: Path, root, description: Description) -> Path:
    if root is not None:
        base, origin = Path(root), "the argument root"
    elif os.environ.get("JAXNARX_DATA"):
        base, origin = Path(os.environ["JAXNARX_DATA"]), "JAXNARX_DATA"
    else:
        base, origin = path.parent, "the description's own folder"
    folder = base / description.root
    if not folder.is_dir():
        raise DataFileError(
            f"{path}: the data folder {folder} does not exist (from {origin}). Give "
            "root=..., or set the environment variable JAXNARX_DATA.",
            path=folder,
        )
    return folder


def _find(description: Description, folder: Path, path: Path) -> list[tuple[Path, str]]:
    """Every file with its part, in order; a file in two parts is refused."""
    found: dict[Path, str] = {}
    for part, patterns in description.patterns.items():
        for pattern in patterns:
            for file in _glob(folder, pattern, part, path):
                if found.setdefault(file, part) != part:
                    raise SpecError(
                        f"{path}: {file.name} is in {found[file]} and in {part} "
                        f"(pattern {pattern!r}). A record may serve one part only.",
                        field=f"records.{part}",
                    )
    return list(found.items())


def _glob(folder: Path, pattern: str, part: str, path: Path) -> list[Path]:
    pure = PurePosixPath(pattern)
    if not pattern or pure.is_absolute() or ".." in pure.parts or "\\" in pattern:
        raise SpecError(
            f"{path}: the pattern {pattern!r} leaves the data folder {folder}. Write "
            "it relative to that folder, with /, and set root to a folder above all "
            "files.",
            field=f"records.{part}",
        )
    files = sorted(f for f in folder.glob(pattern) if f.is_file())
    if not files:
        raise DataFileError(
            f"{path}: no file matches {pattern!r} in {folder} (records.{part}). Check "
            "the pattern, and that the folder is the right one (root=..., or the "
            "environment variable JAXNARX_DATA).",
            path=folder / pattern,
        )
    inside = folder.resolve()
    for file in files:
        if not file.resolve().is_relative_to(inside):
            raise SpecError(
                f"{path}: {file} is a link to a place outside the data folder. Set "
                "root to a folder above the files themselves.",
                field=f"records.{part}",
            )
    return files


def _tables(files: list[Path], description: Description, max_bytes) -> list[Table]:
    left, tables = max_bytes, []
    for file in files:
        table = read_table(file, description.wanted, description.layout, max_bytes=left)
        left -= 8 * len(table) * len(table.columns)
        tables.append(table)
    return tables


def _with_file_units(description: Description, tables: Sequence[Table]) -> Channels:
    """The channels, with units from unit rows; two different units are refused."""
    channels = description.channels
    units = {c.name: c.unit for c in channels.all}
    stated_by = dict.fromkeys(units, "the description")
    for table in tables:
        for name, unit in units.items():
            own = table.units.get(description.columns[name], "").strip("[]() ")
            if own and unit and own != unit.strip("[]() "):
                raise SpecError(
                    f"{table.place.lead}{name} is in {own!r}, but in {unit!r} "
                    f"according to {stated_by[name]}. Convert the file, or correct "
                    "the unit.",
                    field=name,
                )
            if own and not unit:
                units[name], stated_by[name] = own, table.place.name
    return Channels(
        tuple(Channel(c.name, units[c.name]) for c in channels.inputs),
        tuple(Channel(c.name, units[c.name]) for c in channels.outputs),
    )


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
        key = fingerprint(record)
        name, first = seen.setdefault(key, (record.name, part))
        if first != part:
            raise SpecError(
                f"{path}: {record.name} in {part} has the same contents as {name} in "
                f"{first}. A record may serve one part only.",
                field=f"records.{part}",
            )


def fingerprint(record: Record) -> str:
    """A digest of a record's samples, whatever it is called."""
    digest = hashlib.sha256(str((record.u.shape, record.y.shape)).encode())
    for x in (record.u, record.y, record.valid):
        digest.update(x.tobytes())
    return digest.hexdigest()
