"""The one guard of the verbs: a wrong object is named before anything is computed.

It reads annotations: what a verb says it takes is what it is held to, and nothing is
said twice. Public verbs carry it as their outermost decorator. It costs microseconds a
call, and what is being traced passes, as arrays are not looked at.
"""

import collections.abc
import functools
import inspect
import os
import types
import typing
from collections.abc import Callable
from typing import Any, TypeVar

from jaxnarx.errors import SpecError

F = TypeVar("F", bound=Callable[..., Any])

OURS = "jaxnarx."
PLAIN = (str, bytes, bool, int, float, complex, list, tuple, dict, set, type(None))


def guarded(verb: F) -> F:
    """`verb`, which refuses with a `SpecError` what its annotations do not allow.

    Held to them are arguments that take objects of this package, alone or in lists and
    dictionaries, paths, and single numbers. A method of a class of the user's own
    passes: the verb says what it needs of it.
    """
    wanted = {n: p.annotation for n, p in inspect.signature(verb).parameters.items()}
    names = tuple(wanted)

    @functools.wraps(verb)
    def call(*args: Any, **kwargs: Any) -> Any:
        for name, value in (*zip(names, args, strict=False), *kwargs.items()):
            if name not in wanted or _fits(value, wanted[name]):
                continue
            if name != "method" or isinstance(value, PLAIN) or _is_noun(value):
                raise SpecError(
                    f"{verb.__name__}: {name} is {_what(value)}, but must be "
                    f"{_listed(wanted[name])}{_advice(value)}",
                    field=name,
                )
        return verb(*args, **kwargs)

    return typing.cast(F, call)


def _fits(value: Any, wanted: Any) -> bool:
    """Whether a value is what an annotation asks for; True where that is not known."""
    if wanted is Any or getattr(wanted, "_is_protocol", False) and not _is_ours(wanted):
        return True
    if wanted in (float, int):
        return hasattr(value, "__float__" if wanted is float else "__index__")
    if typing.get_origin(wanted) in (typing.Union, types.UnionType):
        return any(_fits(value, each) for each in typing.get_args(wanted))
    if wanted is None or wanted is type(None):
        return value is None
    origin, inner = typing.get_origin(wanted), typing.get_args(wanted)
    if origin is collections.abc.Callable:
        return callable(value) and not isinstance(value, type)
    if origin in (collections.abc.Sequence, collections.abc.Mapping):
        if not _is_ours(inner[-1]):
            table = origin is collections.abc.Mapping
            fits = isinstance(value, origin) if table else value is not None
            return fits and not _is_noun(value)
        several = isinstance(value, origin) and not isinstance(value, str)
        values = value.values() if isinstance(value, collections.abc.Mapping) else value
        return several and all(_fits(each, inner[-1]) for each in values)
    wanted = origin or wanted
    if wanted in (str, os.PathLike) or _is_ours(wanted):
        # A class can be called as a function of one's own can, and is none.
        return isinstance(value, wanted) and not isinstance(value, type)
    return not _is_noun(value)


def _is_ours(wanted: Any) -> bool:
    """A class of this package that tells its objects apart."""
    if typing.get_origin(wanted) in (typing.Union, types.UnionType):
        return any(map(_is_ours, typing.get_args(wanted)))
    is_class = isinstance(wanted, type) and wanted.__module__.startswith(OURS)
    vague = getattr(wanted, "_is_protocol", False)
    return is_class and (not vague or getattr(wanted, "_is_runtime_protocol", False))


def _is_noun(value: Any) -> bool:
    """An object, or a class, of this package."""
    kind = value if isinstance(value, type) else type(value)
    return kind.__module__.startswith(OURS)


def _what(value: Any) -> str:
    if value is None:
        return "None"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    shown = f" ({value!r})" if isinstance(value, str | int | float) else ""
    return f"of type {type(value).__name__}{shown[:60]}"


def _listed(wanted: Any) -> str:
    """An annotation in words."""
    if typing.get_origin(wanted) in (typing.Union, types.UnionType):
        words = [_listed(each) for each in typing.get_args(wanted)]
        return " or ".join(dict.fromkeys(words))
    if wanted is type(None):
        return "None"
    words = {int: "a whole number", float: "a number", str: "a text"}
    if wanted in words:
        return words[wanted]
    origin, inner = typing.get_origin(wanted), typing.get_args(wanted)
    if origin is collections.abc.Callable:
        return "a function"
    if origin is typing.Literal:
        return " or ".join(map(repr, inner))
    name = getattr(origin or wanted, "__name__", str(wanted))
    return f"{name} of {_listed(inner[-1])}" if inner and origin else name


def _advice(value: Any) -> str:
    if type(value).__name__ == "Solution" and _is_noun(value):
        return "; hand on its .value"
    if isinstance(value, type):
        return "; call the class to make one"
    return ""
