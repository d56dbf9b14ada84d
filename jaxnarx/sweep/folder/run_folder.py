"""The run folder: opened for one sweep, asked what is left, gathered at the end."""

import contextlib
import dataclasses
import itertools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.sweep.folder.chunks import (
    Damaged,
    arrow_table,
    chunk_name,
    joined,
    read_results,
    write_results,
)
from jaxnarx.sweep.folder.claims import Claims, is_at_work
from jaxnarx.sweep.folder.files import (
    clear_leftovers,
    make_folder,
    require_inside,
    unwritable,
)
from jaxnarx.sweep.folder.manifest import (
    NAME,
    Manifest,
    read_manifest,
    require_same,
    write_manifest,
)

CHUNKS, CLAIMS, TABLE = "chunks", "claims", "table.parquet"


@dataclasses.dataclass(frozen=True)
class RunFolder:
    """A folder that is the record of one sweep."""

    path: Path
    manifest: Manifest

    @property
    def claims(self) -> Path:
        """Where processes say what they work on."""
        return self.path / CLAIMS

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.manifest.members // self.manifest.chunk)

    def members(self, number: int) -> list[int]:
        """Members of a chunk."""
        size = self.manifest.chunk
        return list(
            range(number * size, min((number + 1) * size, self.manifest.members))
        )

    def finished(self) -> list[int]:
        """Chunks that have a file."""
        present = {path.name for path in (self.path / CHUNKS).iterdir()}
        return [n for n in range(self.chunks) if chunk_name(n) in present]

    def unfinished(self) -> list[int]:
        """Chunks that have none."""
        done = set(self.finished())
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
            for number in self.finished():
                if self._is_damaged(number) and claims.take(number):
                    if self._is_damaged(number):
                        self._file(number).unlink()
                        found.append(number)
                    claims.release(number)
        return found

    def table(self) -> pa.Table:
        """All finished rows in the order of the members; at least one chunk must be.

        Once all are there they are kept as `table.parquet`, which is read from then on.
        """
        path, digest = self.path / TABLE, self.manifest.digest
        if path.exists():
            with contextlib.suppress(Damaged):
                return read_results(path, digest)
        numbers = self.finished()
        try:
            table = joined([read_results(self._file(n), digest) for n in numbers])
        except Damaged as error:
            raise DataFileError(
                f"{self.path}: a finished chunk can no longer be read ({error}). Give "
                "the same command again to compute it anew.",
                path=self.path,
            ) from error
        if len(numbers) == self.chunks:
            write_results(path, table, digest, replace=True)
        return table

    def _file(self, number: int) -> Path:
        return self.path / CHUNKS / chunk_name(number)

    def _is_damaged(self, number: int) -> bool:
        """Whether the file cannot be read, or leads out of the folder."""
        path = self._file(number)
        try:
            if not path.is_symlink():
                read_results(path, self.manifest.digest)
                return False
        except Damaged:
            pass
        return os.path.lexists(path)


def open_run(path: Path, asked: Manifest, *, new: bool = False) -> RunFolder:
    """Open the folder for a sweep: begin it, or continue it where it is the same one.

    With `new` an earlier sweep is first set aside, as `path-1`, `path-2`, ...
    """
    path = path.resolve()
    if new:
        _set_aside(path)
    make_folder(path)
    require_inside(path, NAME, CHUNKS, CLAIMS, TABLE)
    if not (path / NAME).exists() and _has_results(path):
        raise DataFileError(
            f"{path} holds results but no {NAME}; restore it, or choose another folder",
            path=path,
        )
    write_manifest(path, asked)
    found = read_manifest(path)
    require_same(path, found, asked)
    for name in (CHUNKS, CLAIMS):
        make_folder(path / name)
    return RunFolder(path, found)


def find_run(path: Path) -> RunFolder:
    """The folder of a sweep that was begun, to look at."""
    path = path.resolve()
    require_inside(path, NAME, CHUNKS, CLAIMS, TABLE)
    return RunFolder(path, read_manifest(path))


def _has_results(path: Path) -> bool:
    return (path / TABLE).exists() or any((path / CHUNKS).glob("*.parquet"))


def _set_aside(path: Path) -> None:
    if not (path / NAME).exists():
        return
    if is_at_work(path / CLAIMS):
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
