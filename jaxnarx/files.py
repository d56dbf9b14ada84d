"""Files that appear whole or not at all, whatever else writes beside them, and text
that is safe in them."""

import contextlib
import errno
import os
import secrets
import shutil
import tempfile
import time
import weakref
from collections.abc import Iterator
from pathlib import Path

from jaxnarx.errors import DataFileError

UNFINISHED_SUFFIX = ".tmp"
"""How the name of a file ends that is still being written."""


def cache_folder(name: str) -> Path | None:
    """The user's folder for what is quicker kept than made again; None where it cannot
    be."""
    home = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = Path(home or Path.home() / ".cache") / "jaxnarx" / name
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # it cannot be written, or there is no home
        return None
    return folder


def write_whole(path: Path, data: bytes, *, replace: bool = True) -> bool:
    """Write a file so that it appears at once, complete and on the disk.

    The bytes go to a new file beside it, under a name that nobody else has and that
    is refused where something is there already, be it a link; that file then takes
    the place of `path`. Without `replace` a file that is there stays as it is and the
    answer is False. Errors are those of the system; nothing is left of the attempt.
    """
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}{UNFINISHED_SUFFIX}")
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


def cell(text: str) -> str:
    """Text that a spreadsheet will not take for a formula."""
    return "'" + text if text.startswith(tuple("=+-@\t\r")) else text


def encodable(text: str) -> str:
    """Text as UTF-8 has it, with escapes for the rest (odd bytes of file names)."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def unwritable(path: object, error: OSError, kept: str = "") -> DataFileError:
    """The message where `path` cannot be written; `kept` is a sentence on the rest."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    hint = "Free some space" if full else "Make the folder writable"
    return DataFileError(
        f"{path}: cannot be written ({error.strerror or error}). {kept}{hint} and give "
        "the same command again.",
        path=path,
    )


@contextlib.contextmanager
def hold_lock(folder: Path) -> Iterator[None]:
    """Keep other processes out that ask the same; the lock ends with its process.

    Where the system has no such lock, nobody is kept out.
    """
    handle = None
    try:
        with contextlib.suppress(OSError, ImportError):
            import fcntl

            handle = os.open(folder, os.O_RDONLY)
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        if handle is not None:
            os.close(handle)


def try_lock(handle: int) -> bool:
    """Lock an open file or folder; False where another has locked it.

    The lock lasts until `handle` is closed or this process ends, however it ends. Where
    the system has no such lock, nobody is kept out.
    """
    try:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        pass
    return True


def lock_folder(place: Path) -> int | None:
    """A lock on a folder; BlockingIOError where it is held, None where there are none
    on this system, or nothing to lock.
    """
    handle = None
    try:
        import fcntl

        handle = os.open(place, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return handle
    except (ImportError, OSError) as error:
        if handle is not None:
            os.close(handle)
        if isinstance(error, BlockingIOError):
            raise
        return None


TEMPORARY_PREFIX = "jaxnarx-of-a-process-"
"""How the names of temporary folders begin."""
FRESH_FOLDER_SECONDS = 600.0
"""Seconds for which a temporary folder without a lock may be one that is being made."""


class TemporaryFolder:
    """A folder for files of this process; it goes with `cleanup`, or with the process.

    It is locked: where the process is killed, the next one that makes such a folder
    clears it.
    """

    def __init__(self) -> None:
        clear_temporary()
        self.path = Path(tempfile.mkdtemp(prefix=TEMPORARY_PREFIX))
        self.cleanup = weakref.finalize(
            self, _remove, self.path, _lock_folder(self.path)
        )

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *exception: object) -> None:
        self.cleanup()


def clear_temporary() -> None:
    """Remove the temporary folders of this user's processes that are gone."""
    for place in Path(tempfile.gettempdir()).glob(TEMPORARY_PREFIX + "*"):
        with contextlib.suppress(OSError):  # held, another user's, or just removed
            about = place.lstat()
            is_ours = not hasattr(os, "getuid") or about.st_uid == os.getuid()
            if not is_ours or time.time() - about.st_mtime < FRESH_FOLDER_SECONDS:
                continue
            if (handle := lock_folder(place)) is not None:
                _remove(place, handle)


def _lock_folder(place: Path) -> int | None:
    """A lock on a folder that is new; None where it cannot be had."""
    with contextlib.suppress(BlockingIOError):
        return lock_folder(place)
    return None


def _remove(place: Path, handle: int | None) -> None:
    shutil.rmtree(place, ignore_errors=True)
    if handle is not None:
        os.close(handle)


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
