"""Files of a run folder: whole or not at all, and never outside the folder."""

from pathlib import Path

from jaxnarx import files
from jaxnarx.errors import DataFileError
from jaxnarx.files import UNFINISHED_SUFFIX, write_whole


def put(path: Path, data: bytes, *, replace: bool = False) -> bool:
    """Write a file so that it appears at once, complete and on the disk.

    Without `replace` a file that is there already stays as it is and the answer is
    False. An error of the file system becomes a `DataFileError`, and nothing is left
    of the attempt (`jaxnarx.files`).
    """
    try:
        return write_whole(path, data, replace=replace)
    except OSError as error:
        raise unwritable(path, error) from error


def unwritable(path: Path, error: OSError) -> DataFileError:
    """The message where a file of the run folder cannot be written."""
    return files.unwritable(path, error, "Finished chunks are kept. ")


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
    for leftover in path.parent.glob(f"{path.name}.*{UNFINISHED_SUFFIX}"):
        leftover.unlink(missing_ok=True)
