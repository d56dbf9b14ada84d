"""Files that appear whole or not at all, whatever else writes beside them."""

import contextlib
import os
import secrets
from pathlib import Path

UNFINISHED = ".tmp"
"""How the name of a file ends that is still being written."""


def write_whole(path: Path, data: bytes, *, replace: bool = True) -> bool:
    """Write a file so that it appears at once, complete and on the disk.

    The bytes go to a new file beside it, under a name that nobody else has and that
    is refused where something is there already, be it a link; that file then takes
    the place of `path`. Without `replace` a file that is there stays as it is and the
    answer is False. Errors are those of the system; nothing is left of the attempt.
    """
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}{UNFINISHED}")
    file = open(temporary, "xb")  # before the try: where it fails it is not ours
    try:
        with file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        placed = _move(temporary, path, replace)
    finally:
        with contextlib.suppress(OSError):  # of the attempt, not of clearing up
            temporary.unlink(missing_ok=True)
    _settle(path.parent)
    return placed


def _move(source: Path, target: Path, replace: bool) -> bool:
    if replace:
        os.replace(source, target)
        return True
    try:
        os.link(source, target)  # unlike a renaming, refuses where something is
    except FileExistsError:
        return False
    except OSError:  # a file system without links
        if target.exists():
            return False
        os.replace(source, target)
    return True


def _settle(folder: Path) -> None:
    """Have the folder's own list of names written, where the system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
