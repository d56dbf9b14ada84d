"""The run folder: opened for one sweep, asked what is left, gathered at the end."""

import contextlib
import dataclasses
import itertools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.sweep.folder.chunks import (
    Damaged,
    arrow_table,
    chunk_name,
    chunk_number,
    join_tables,
    read_results,
    write_results,
)
from jaxnarx.sweep.folder.claims import Claims, clear_dead
from jaxnarx.sweep.folder.files import (
    clear_leftovers,
    make_folder,
    require_inside,
    unwritable,
)
from jaxnarx.sweep.folder.manifest import (
    MANIFEST_FILE,
    Manifest,
    read_manifest,
    require_same,
    write_manifest,
)

CHUNKS_FOLDER, CLAIMS_FOLDER, TABLE_FILE = "chunks", "claims", "table.parquet"


@dataclasses.dataclass(frozen=True)
class RunFolder:
    """A folder that is the record of one sweep."""

    path: Path
    manifest: Manifest

    @property
    def claims(self) -> Path:
        """The folder in which processes say what they work on."""
        return self.path / CLAIMS_FOLDER

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.manifest.members // self.manifest.chunk)

    def members(self, number: int) -> range:
        """Members of a chunk."""
        size = self.manifest.chunk
        return range(number * size, min((number + 1) * size, self.manifest.members))

    def finished_chunks(self) -> list[int]:
        """Chunks that have a file."""
        found = (
            chunk_number(path.name) for path in (self.path / CHUNKS_FOLDER).glob("*")
        )
        return sorted(n for n in found if n is not None and n < self.chunks)

    def unfinished_chunks(self) -> list[int]:
        """Chunks that have none."""
        done = set(self.finished_chunks())
        return [n for n in range(self.chunks) if n not in done]

    def is_finished(self, number: int) -> bool:
        """Whether a chunk has a file."""
        return self._file(number).exists()

    def write(self, number: int, rows: Sequence[Mapping[str, Any]]) -> bool:
        """Write a chunk, by the owner of its claim; False if it is there already."""
        path = self._file(number)
        clear_leftovers(path)
        return write_results(path, arrow_table(rows), self.manifest.digest)

    def discard_damaged(self) -> list[int]:
        """Remove files of chunks that cannot be read; these chunks are open again."""
        found = []
        with Claims(self.claims) as claims:
            for number in self.finished_chunks():
                if self._is_damaged(number) and claims.take(number):
                    if self._is_damaged(number):
                        self._remove(number)
                        found.append(number)
                    claims.release(number)
        return found

    def table(self, *, keep: bool = False) -> pa.Table:
        """All finished rows in the order of the members; at least one chunk must be.

        `keep` writes them to `table.parquet`, once all are there; they are read from it
        where it is sound.
        """
        path = self.path / TABLE_FILE
        if path.exists():
            with contextlib.suppress(Damaged):
                return self._read(path, range(self.manifest.members))
        try:
            table = join_tables([self._chunk(n) for n in self.finished_chunks()])
        except Damaged as error:
            raise DataFileError(
                f"{self.path}: a finished chunk can no longer be used ({error}). Give "
                "the command of the sweep again to compute it anew.",
                path=self.path,
            ) from error
        if keep and table.num_rows == self.manifest.members:
            write_results(path, table, self.manifest.digest, replace=True)
        return table

    def _chunk(self, number: int) -> pa.Table:
        return self._read(self._file(number), self.members(number))

    def _read(self, path: Path, members: Sequence[int]) -> pa.Table:
        return read_results(path, self.manifest.digest, members)

    def _file(self, number: int) -> Path:
        return self.path / CHUNKS_FOLDER / chunk_name(number)

    def _is_damaged(self, number: int) -> bool:
        """Whether there is a file that is not the chunk."""
        try:
            self._chunk(number)
        except Damaged:
            return os.path.lexists(self._file(number))
        return False

    def _remove(self, number: int) -> None:
        path = self._file(number)
        try:
            path.unlink()
        except OSError as error:
            raise unwritable(path, error) from error


def open_run(path: Path, asked: Manifest, *, new: bool = False) -> RunFolder:
    """Open the folder for a sweep: begin it, or continue it where it is the same one.

    With `new` an earlier sweep is first set aside, as `path-1`, `path-2`, ...
    """
    path = path.resolve()
    if new:
        _set_aside(path)
    make_folder(path)
    require_inside(path, MANIFEST_FILE, CHUNKS_FOLDER, CLAIMS_FOLDER, TABLE_FILE)
    if not (path / MANIFEST_FILE).exists() and _has_results(path):
        raise DataFileError(
            f"{path} holds results but no {MANIFEST_FILE}; restore it, or choose "
            "another folder",
            path=path,
        )
    write_manifest(path, asked)
    found = read_manifest(path)
    require_same(path, found, asked)
    for name in (CHUNKS_FOLDER, CLAIMS_FOLDER):
        make_folder(path / name)
    return RunFolder(path, found)


@guard_arguments
def find_run(path: Path) -> RunFolder:
    """The folder of a sweep that was begun, to look at."""
    path = path.resolve()
    require_inside(path, MANIFEST_FILE, CHUNKS_FOLDER, CLAIMS_FOLDER, TABLE_FILE)
    return RunFolder(path, read_manifest(path))


def _has_results(path: Path) -> bool:
    return (path / TABLE_FILE).exists() or any((path / CHUNKS_FOLDER).glob("*.parquet"))


def _set_aside(path: Path) -> None:
    if not (path / MANIFEST_FILE).exists():
        return
    if clear_dead(path / CLAIMS_FOLDER):
        raise SpecError(
            f"{path}: another process is at work on it; end that first, or choose "
            "another folder",
            field="folder",
        )
    names = (path.with_name(f"{path.name}-{n}") for n in itertools.count(1))
    aside = next(p for p in names if not p.exists())
    try:
        path.rename(aside)
    except OSError as error:
        raise unwritable(path, error) from error
