"""Old names of methods and functions, which warn and work for one release more."""

import sys
import warnings
from collections.abc import Callable, Mapping
from typing import Any


def old_method(old: str, new: str) -> Callable[..., Any]:
    """A method that warns of its name and calls the one that has taken its place."""

    def method(self, *args: Any, **kwargs: Any) -> Any:
        _warn(f"{type(self).__name__}.{old}", new)
        return getattr(self, new)(*args, **kwargs)

    method.__name__ = old
    method.__doc__ = f"Old name of `{new}`, for one release more."
    return method


def find_old(room: str, name: str, names: Mapping[str, str]) -> Any:
    """Return the value that a room offers under another name now; `names` are the new
    names by the old.

    For the `__getattr__` of the room: AttributeError where `name` is no old name.
    """
    if name not in names:
        raise AttributeError(f"module {room!r} has no attribute {name!r}")
    _warn(f"{room}.{name}", names[name], stacklevel=4)
    return getattr(sys.modules[room], names[name])


def _warn(old: str, new: str, *, stacklevel: int = 3) -> None:
    warnings.warn(f"{old} is now {new}", DeprecationWarning, stacklevel=stacklevel)
