"""Folders of what is not finished: whose they are, and what becomes of them.

Each is locked by the process that writes there. The lock ends with the process, however
that ends: what is not locked was left by one that was killed, and is cleared.
"""

import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from jaxnarx.errors import SpecError
from jaxnarx.files import hold_lock, lock_folder

UNFINISHED_PREFIX = ".unfinished-"


@contextmanager
def new_folder(
    folder: Path, names: Sequence[str] = (), by: str = "out"
) -> Iterator[Path]:
    """A new folder inside `folder`, which goes when this ends.

    The files `names` are reserved: SpecError where another process is making one, with
    the option `by` that names another folder.
    """
    # Named before it is made: an interrupt in between leaves nothing either.
    place, handle = folder / f"{UNFINISHED_PREFIX}{secrets.token_hex(8)}", None
    try:
        with hold_lock(folder):
            for other in folders_in_use(folder):
                if both := sorted(set(names) & {path.name for path in other.glob("*")}):
                    raise SpecError(
                        f"another run is writing {both[0]} to {folder}; wait until it "
                        "is done, or choose another --{by}",
                        field=by,
                    )
            place.mkdir(mode=0o700)
            handle = lock_folder(place)
            for name in names:
                (place / name).touch()
        yield place
    finally:
        _remove(place)
        if handle is not None:
            os.close(handle)


def _remove(place: Path) -> None:
    """All of it, though an interrupt comes meanwhile."""
    try:
        shutil.rmtree(place, ignore_errors=True)
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise


def folders_in_use(folder: Path) -> list[Path]:
    """The places at which living processes write in `folder`; what dead ones have left
    is removed."""
    living = []
    for place in folder.glob(UNFINISHED_PREFIX + "*"):
        try:
            handle = lock_folder(place)
        except BlockingIOError:
            living.append(place)
            continue
        if handle is not None:
            shutil.rmtree(place, ignore_errors=True)
            os.close(handle)
    return living
