"""Files of a run folder: whole or not at all, and never outside the folder."""

import errno
import os
from pathlib import Path

from jaxnarx.errors import DataFileError
from jaxnarx.sweep.folder.owner import this_process


def put(path: Path, data: bytes, *, replace: bool = False) -> bool:
    """Write a file so that it appears at once, complete and on the disk.

    The bytes go to a `.tmp` file of this process beside it, which then takes its
    place. Without `replace` a file that is there already stays as it is and the answer
    is False. An error of the file system becomes a `DataFileError`, and nothing is
    left of the attempt.
    """
    temporary = path.with_name(f"{path.name}.{this_process().token}.tmp")
    try:
        try:
            _write(temporary, data)
            placed = _move(temporary, path, replace)
        finally:
            temporary.unlink(missing_ok=True)
        _settle(path.parent)
    except OSError as error:
        raise unwritable(path, error) from error
    return placed


def unwritable(path: Path, error: OSError) -> DataFileError:
    """What to tell where a file of the run folder cannot be written."""
    hint = "Free some space" if _is_full(error) else "Make the folder writable"
    return DataFileError(
        f"{path}: cannot be written ({error.strerror or error}). Finished chunks are "
        f"kept. {hint} and give the same command again to continue.",
        path=path,
    )


def make_folder(path: Path) -> None:
    """Make a folder and its parents where they are absent."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(path, error) from error


def require_inside(folder: Path, *parts: str) -> None:
    """DataFileError where a part of the run folder is a link that leads elsewhere."""
    for part in parts:
        path = folder / part
        if path.is_symlink():
            raise DataFileError(
                f"{path} is a symbolic link; a sweep writes only inside its own "
                "folder. Remove the link, or choose another folder.",
                path=path,
            )


def clear_leftovers(path: Path) -> None:
    """Remove what a process that died while writing `path` has left beside it.

    Only for the owner of the claim on `path`: no one else is then writing it.
    """
    for leftover in path.parent.glob(f"{path.name}.*.tmp"):
        leftover.unlink(missing_ok=True)


def _is_full(error: OSError) -> bool:
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def _write(path: Path, data: bytes) -> None:
    with open(path, "xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


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
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError:
        pass
    finally:
        os.close(handle)
