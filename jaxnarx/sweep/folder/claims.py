"""Claims on chunks, so that several commands share a run folder.

A claim is a lock on a file. The system ends it with its process, however that ends, so
that what a dead process has left is open at once. Where the system has no such locks
nobody is kept out: a chunk may be computed twice, and the file written first stays.
"""

import contextlib
import os
from pathlib import Path
from typing import Any, BinaryIO

from jaxnarx.files import try_lock
from jaxnarx.sweep.folder.files import unwritable

CLAIM_SUFFIX = ".lock"


class Claims:
    """The claims that this process holds in a folder, released on leaving."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._held: dict[int, BinaryIO] = {}

    def __enter__(self) -> "Claims":
        return self

    def __exit__(self, *exception: Any) -> None:
        for number in list(self._held):
            self.release(number)

    def take(self, number: int) -> bool:
        """Claim a chunk; False where it is claimed already."""
        path = self.folder / f"{number:05d}{CLAIM_SUFFIX}"
        try:
            # A file object: where an interrupt comes next, it closes by itself.
            file = open(path, "ab", opener=_open)
        except OSError as error:
            raise unwritable(path, error) from error
        if _is_free(path, file):
            self._held[number] = file
            return True
        file.close()
        return False

    def release(self, number: int) -> None:
        """Give up the claim on a chunk."""
        with self._held.pop(number) as file, contextlib.suppress(OSError):
            os.unlink(file.name)  # before it is closed: the next claim is a new file


def clear_dead(folder: Path) -> bool:
    """Remove what dead processes have left; whether a living one holds a claim."""
    living = False
    for path in folder.glob(f"*{CLAIM_SUFFIX}"):
        try:
            with open(path, "r+b", opener=_open) as file:
                if _is_free(path, file):
                    path.unlink()
                else:
                    living = True
        except FileNotFoundError:  # released just now
            pass
        except OSError as error:
            raise unwritable(path, error) from error
    return living


def _open(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o644)


def _is_free(path: Path, file: BinaryIO) -> bool:
    """Lock the file; False where another has, or had and has removed it since."""
    if not try_lock(file.fileno()):
        return False
    with contextlib.suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    return False
