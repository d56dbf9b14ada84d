"""Claims on chunks, so that several processes share a run folder.

A claim is a file that only one process can create. Its time is renewed while the
process lives. The claim of a process that is gone, or of another machine's process that
has not renewed it for `STALE` seconds, is taken over.
"""

import dataclasses
import json
import os
import tempfile
import threading
from pathlib import Path
from typing import Any

from jaxnarx.files import alone
from jaxnarx.sweep.folder.files import unwritable
from jaxnarx.sweep.folder.owner import Owner, this_process

BEAT = 10.0
"""Seconds between two renewals of a claim."""

STALE = 120.0
"""Seconds without renewal after which a claim nobody can check is dead."""


class Claims:
    """The claims that this process holds in a folder, released on leaving."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._held: set[Path] = set()
        self._end = threading.Event()
        self._beating = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> "Claims":
        self._beating.start()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._end.set()
        for path in list(self._held):
            self._drop(path)

    def take(self, number: int) -> bool:
        """Claim a chunk; False where a living process has it."""
        path = self.folder / f"{number:05d}.json"
        self._held.add(path)  # first, so that an interrupt leaves no claim behind
        taken = _create(path) or (_clear_dead(path) and _create(path))
        if not taken:
            self._held.discard(path)
        return taken

    def release(self, number: int) -> None:
        """Give up the claim on a chunk."""
        self._drop(self.folder / f"{number:05d}.json")

    def _drop(self, path: Path) -> None:
        self._held.discard(path)
        if _owner(path) == this_process():
            path.unlink(missing_ok=True)

    def _beat(self) -> None:
        while not self._end.wait(BEAT):
            for path in list(self._held):
                try:
                    os.utime(path)
                except OSError:  # taken over, or the disk is away for a while
                    pass


def is_at_work(folder: Path) -> bool:
    """Whether a process that may be alive holds a claim in the folder."""
    return any(not _is_dead(path) for path in folder.glob("*.json"))


def clear_dead(folder: Path) -> None:
    """Remove the claims of dead processes, on finished chunks too."""
    for path in folder.glob("*.json"):
        _clear_dead(path)


def _create(path: Path) -> bool:
    text = json.dumps(dataclasses.asdict(this_process()))
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
    except FileExistsError:
        return False
    except OSError as error:
        raise unwritable(path, error) from error
    try:
        os.write(handle, text.encode())
    except OSError as error:
        path.unlink(missing_ok=True)
        raise unwritable(path, error) from error
    finally:
        os.close(handle)
    return True


def _clear_dead(path: Path) -> bool:
    """Remove the claim if its owner is dead.

    One process at a time does so and looks again first: another may have taken the
    claim over in the meantime. While a dead claim stands, nobody can make a new one.
    Where nobody can be kept out, two may compute a chunk; the first written stays.
    """
    if not _is_dead(path):
        return False
    with alone(path.parent):
        dead = _is_dead(path)
        if dead:
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise unwritable(path, error) from error
    return dead


def _is_dead(path: Path) -> bool:
    owner = _owner(path)
    gone = None if owner is None else owner.is_gone()
    return _age(path) > STALE if gone is None else gone


def _owner(path: Path) -> Owner | None:
    """Who made the claim; None where that cannot be read."""
    try:
        owner = Owner(**json.loads(path.read_text()))
    except (OSError, ValueError, TypeError, RecursionError):
        return None
    return owner if type(owner.pid) is int and 0 < owner.pid < 2**31 else None


def _age(path: Path) -> float:
    """Seconds since the last renewal, both times by the clock of the file system."""
    try:
        with tempfile.TemporaryFile(dir=path.parent) as now:
            return os.fstat(now.fileno()).st_mtime - path.stat().st_mtime
    except OSError:
        return 0.0
