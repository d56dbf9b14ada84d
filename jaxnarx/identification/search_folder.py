"""The folder of a search: what was tried, on the disk after every candidate.

    search.json                    key of data and settings, rows, names of groups, rule
    candidates/<number>.safetensors    that candidate, trained on all records
    candidates/<output>.finished       all candidates of that output have been tried

The key is a table of plain values, such as digests. A folder with another key belongs
to another search, whose candidates would not compare with these.
"""

import dataclasses
import json
import os
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxnarx.argument_checks import is_fit
from jaxnarx.deprecation import old_method
from jaxnarx.errors import DataFileError, ModelFileError, SpecError, guard_reading
from jaxnarx.files import encodable, lock_folder, unwritable, write_whole
from jaxnarx.identification.leaderboard import LARGEST_FIGURE, Candidate, Leaderboard
from jaxnarx.models import Network, load, save

SEARCH_FILE = "search.json"
CANDIDATES_FOLDER = "candidates"
FORMAT_VERSION = 1
ROW_VERSION = 4
"""Definition of what a row says, part of the key, so that rows of one leaderboard
compare. Since 2 operations are those of the exported program, since 3 it tells whether
runs are proven bounded, since 4 it has a data factor."""


@dataclasses.dataclass(frozen=True)
class SearchFolder:
    """A search as it stands on the disk."""

    path: Path
    key: Mapping[str, Any]
    leaderboard: Leaderboard
    lock: "FolderLock | None" = dataclasses.field(default=None, compare=False)
    """Keeps other processes out for as long as the search is held somewhere."""

    def model_path(self, number: int) -> Path:
        """The path of a candidate's model, whether it is there or not."""
        return self.path / CANDIDATES_FOLDER / f"{number}.safetensors"

    def row(self, number: int) -> Candidate:
        """The candidate of that number; SpecError where there is none."""
        for row in self.leaderboard:
            if row.number == number:
                return row
        known = [row.number for row in self.leaderboard]
        there = f"numbers go from {min(known)} to {max(known)}" if known else "none yet"
        raise SpecError(f"{self.path} has no candidate {number}: {there}")

    def network(self, number: int) -> Network:
        """The model of a candidate; SpecError where it has none."""
        row, path = self.row(number), self.model_path(number)
        if not path.is_file():
            why = f"{row.status}{': ' if row.detail else ''}{row.detail}"
            raise SpecError(
                f"candidate {number} ({row.family}: {row.name}) has no model: {why}"
            )
        network = load(path)
        if row.output not in network.output_names:
            raise DataFileError(
                f"{self.path / SEARCH_FILE}: candidate {number} is of {row.output}, "
                f"but its model computes {', '.join(network.output_names)}. Begin "
                "anew with --force.",
                path=self.path / SEARCH_FILE,
            )
        return network

    def add(self, row: Candidate, network: Network | None) -> "SearchFolder":
        """The folder with one more candidate, written to the disk: its model before its
        row."""
        if network is not None:
            self.save(row.number, network)
        row = _finite(row)
        board = self.leaderboard
        rows = tuple({r.number: r for r in (*board.rows, row)}.values())
        after = dataclasses.replace(
            self, leaderboard=dataclasses.replace(board, rows=rows)
        )
        after.write()
        return after

    added = old_method("added", "add")

    def save(self, number: int, network: Network) -> None:
        """Write the model of a candidate."""
        path = self.model_path(number)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise unwritable(path, error) from error
        save(network, path)

    def is_finished(self, output: int) -> bool:
        """Whether all candidates of an output, by its place, have been tried."""
        return self._mark(output).exists()

    finished = old_method("finished", "is_finished")

    def finish(self, output: int) -> None:
        """Say that they have."""
        self._mark(output).parent.mkdir(parents=True, exist_ok=True)
        write_whole(self._mark(output), b"")

    def _mark(self, output: int) -> Path:
        return self.path / CANDIDATES_FOLDER / f"{output}.finished"

    def write(self) -> None:
        """Write `search.json`, whole or not at all."""
        board = self.leaderboard
        told = {
            "format": FORMAT_VERSION,
            "key": dict(self.key),
            "group_names": list(board.group_names),
            "rule": board.rule,
            "rows": [row.to_dict() for row in board],
        }
        path = self.path / SEARCH_FILE
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            write_whole(path, json.dumps(told, allow_nan=False, indent=1).encode())
        except OSError as error:
            raise unwritable(path, error, "What was tried is kept. ") from error


def open_search(
    path: Path, key: Mapping[str, Any], leaderboard: Leaderboard
) -> SearchFolder:
    """The folder of this search: gone on with where it is there, else begun.

    `leaderboard` has the names of the groups and the rule of the choice; rows that are
    on the disk already come with the result. SpecError where the folder holds a search
    with another key, or another process searches there.
    """
    new = SearchFolder(
        path, _round_trip(key), leaderboard, _lock(path / CANDIDATES_FOLDER)
    )
    if not (path / SEARCH_FILE).is_file():
        new.write()
        return new
    old = read_search(path)
    names = dict.fromkeys([*new.key, *old.key])
    if other := [name for name in names if old.key.get(name) != new.key.get(name)]:
        raise SpecError(
            f"{path} holds a search that differs in {', '.join(other)}; choose another "
            "--out, or begin anew with --force",
            field="folder",
        )
    rows = tuple(r for r in old.leaderboard if not is_lost(old, r))
    if len(rows) < len(old.leaderboard):
        for mark in (path / CANDIDATES_FOLDER).glob("*.finished"):
            mark.unlink()
    return dataclasses.replace(
        new, leaderboard=dataclasses.replace(leaderboard, rows=rows)
    )


class FolderLock:
    """The lock of this process on a folder; it ends with the last who holds it."""

    def __init__(self, place: Path):
        try:
            handle = lock_folder(place)
        except BlockingIOError:
            raise SpecError(
                f"another process searches in {place.parent}; wait until it is done, "
                "or choose another folder",
                field="folder",
            ) from None
        if handle is not None:
            weakref.finalize(self, os.close, handle)


_OWN_LOCKS: weakref.WeakValueDictionary[Path, FolderLock] = (
    weakref.WeakValueDictionary()
)
"""Locks of this process, which may open a folder again."""


def _lock(place: Path) -> FolderLock:
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(place, error) from error
    known = place.resolve()
    lock = _OWN_LOCKS.get(known) or FolderLock(place)
    _OWN_LOCKS[known] = lock
    return lock


def is_lost(folder: SearchFolder, row: Candidate) -> bool:
    """Whether a candidate's model file is missing."""
    return row.free_run is not None and not folder.model_path(row.number).is_file()


def read_search(path: Path) -> SearchFolder:
    """The search of a folder, finished or not; DataFileError where there is none."""
    file = path / SEARCH_FILE
    if not file.is_file():
        where = (
            "there is no such folder"
            if not path.is_dir()
            else f"it has no {SEARCH_FILE}"
        )
        raise DataFileError(
            f"{path} is no folder of a search ({where}). `jaxnarx identify` without a "
            "method's settings makes one.",
            path=file,
        )
    with guard_reading(
        file, "the record of a search", advice="Begin anew with --force."
    ):
        told = json.loads(file.read_text(encoding="utf-8"))
        if told["format"] > FORMAT_VERSION:
            raise ModelFileError(f"{file}: written by a newer jaxnarx", path=file)
        return SearchFolder(path, dict(told["key"]), _board(file, told))


def _board(file: Path, told: Mapping[str, Any]) -> Leaderboard:
    """The candidates of a file; DataFileError names the row and the field that cannot
    be."""
    names, rule = told["group_names"], told["rule"]
    if not (is_fit(names, list[str]) and is_fit(rule, str)):
        raise TypeError("names of groups and the rule are texts")
    rows: dict[int, Candidate] = {}
    for place, table in enumerate(told["rows"], 1):
        try:
            row = Candidate.from_dict(_encodable(table))
            if row.number in rows:
                raise SpecError(f"number {row.number} is taken by a row before")
            for own, needed in (
                (row.groups, row.eligible),
                (row.nested_groups, row.nested is not None),
            ):
                if len(own) != len(names) and (own or needed):
                    raise SpecError(
                        f"groups has not one figure for each of {len(names)}"
                    )
        except SpecError as error:
            raise DataFileError(
                f"{file}: row {place}: {error}. The file is damaged; begin anew with "
                "--force.",
                path=file,
            ) from error
        rows[row.number] = row
    return Leaderboard(tuple(rows.values()), tuple(map(encodable, names)), rule)


def _encodable(table: Any) -> Any:
    """A row of a file, its texts such as every file can hold."""
    if not isinstance(table, dict):
        return table
    return {k: encodable(v) if isinstance(v, str) else v for k, v in table.items()}


def _finite(row: Candidate) -> Candidate:
    """Drop figures beyond the largest that a file holds."""

    def finite_or_none(value: Any) -> Any:
        return (
            None if isinstance(value, float) and not value <= LARGEST_FIGURE else value
        )

    plain: dict[str, Any] = {
        name: tuple(map(finite_or_none, value))
        if isinstance(value, tuple)
        else finite_or_none(value)
        for name, value in vars(row).items()
    }
    return Candidate(**plain)


def _round_trip(key: Mapping[str, Any]) -> dict[str, Any]:
    """The key as it comes back from the file: tuples are lists."""
    return json.loads(json.dumps(dict(key), allow_nan=False))
