"""The one guard of the verbs: a wrong object is named before anything is computed.

It reads annotations: what a verb says it takes is what it is held to, and nothing is
said twice. Public verbs carry it as their outermost decorator. It costs microseconds a
call, and what is being traced passes, as arrays are not looked at.
"""

import collections.abc
import functools
import inspect
import numbers
import os
import pathlib
import types
import typing
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from jaxnarx.errors import SpecError

F = TypeVar("F", bound=Callable[..., Any])
C = TypeVar("C", bound=type)

PACKAGE_PREFIX = "jaxnarx."
PLAIN_PACKAGES = ("builtins", "numpy", "pathlib", "jaxlib", "jax")
"""Packages none of whose objects is a method."""


def guard_arguments(verb: F) -> F:
    """`verb`, which refuses with a `SpecError` what its annotations do not allow.

    It checks arguments that take objects of this package, alone or in lists and
    dictionaries, paths, and single numbers. A method of a class of the user's own
    passes: the verb says what it needs of it.
    """
    return typing.cast(F, _guard(verb, verb.__name__))


def guard_fields(noun: C) -> C:
    """A class whose constructor is held to the annotations of its fields likewise."""
    vars(noun)["__init__"]  # its own: one that is inherited would be guarded for others
    noun.__init__ = _guard(noun.__init__, noun.__name__)
    return noun


def _guard(verb: Callable[..., Any], called: str) -> Callable[..., Any]:
    parameters = inspect.signature(verb).parameters
    names = tuple(parameters)
    wanted = {
        n: p.annotation for n, p in parameters.items() if p.annotation is not p.empty
    }

    @functools.wraps(verb)
    def call(*args: Any, **kwargs: Any) -> Any:
        for name, value in (*zip(names, args, strict=False), *kwargs.items()):
            if name in wanted and not (name == "method" and _may_be_method(value)):
                require_fit(called, name, value, wanted[name])
        return verb(*args, **kwargs)

    return call


def require_fit(called: str, name: str, value: Any, wanted: Any) -> None:
    """SpecError where an argument of `called` is not what its annotation asks for."""
    if not is_fit(value, wanted):
        raise SpecError(
            f"{called}: {name} is {_describe_value(value)}, but must be "
            f"{_describe_annotation(wanted)}{_advice(value)}",
            field=name,
        )


def is_fit(value: Any, wanted: Any) -> bool:
    """Whether a value is what an annotation asks for; True where that is not known."""
    if wanted is Any or getattr(wanted, "_is_protocol", False) and not _is_ours(wanted):
        return True
    origin, inner = typing.get_origin(wanted), typing.get_args(wanted)
    if origin in (typing.Union, types.UnionType):
        paths = {os.PathLike, pathlib.Path} & {typing.get_origin(e) or e for e in inner}
        named = not paths or _may_be_path(value)
        return named and any(is_fit(value, each) for each in inner)
    if wanted is None or wanted is type(None):
        return value is None
    if origin is typing.Literal:  # the verb says which words there are
        return isinstance(value, tuple({type(each) for each in inner}))
    if wanted in _NUMBER_KINDS:
        return _is_number(value, wanted)
    if origin is collections.abc.Callable:
        return callable(value) and not isinstance(value, type)
    if origin in (collections.abc.Mapping, dict):
        if not isinstance(value, collections.abc.Mapping):
            return False
        if inner[1] is Any:  # one that reads files is not asked for any
            return all(is_fit(k, inner[0]) for k in value)
        pairs = value.items()
        return all(is_fit(k, inner[0]) and is_fit(v, inner[1]) for k, v in pairs)
    if origin in _COLLECTION_KINDS or origin is tuple and inner[-1] is ...:
        return _is_several(value, inner[0]) and all(is_fit(e, inner[0]) for e in value)
    if hasattr(wanted, "array_type"):
        return _is_array(value, wanted.dims)
    wanted = origin or wanted
    if wanted in (str, os.PathLike, pathlib.Path) or _is_ours(wanted):
        # A class can be called as a function of one's own can, and is none.
        fits = isinstance(value, wanted) and not isinstance(value, type)
        # A network can be called, but is no function of one's own either.
        called = getattr(wanted, "_is_protocol", False) and "__call__" in vars(wanted)
        fits = fits and not (called and _is_noun(value))
        solved = fits and wanted.__name__ == "Solution" and inner
        return is_fit(value.value, inner[0]) if solved else fits
    return not _is_noun(value)


LONGEST_FILE_NAME = 255
"""Bytes of a part of a path on the usual file systems."""


def _may_be_path(value: Any) -> bool:
    """Whether the system could name a file so; True for what is no text or path."""
    if not isinstance(value, str | os.PathLike):
        return True
    try:
        name = os.fsencode(value)
    except (UnicodeError, TypeError):
        return False
    parts = name.split(os.sep.encode())
    return b"\0" not in name and max(map(len, parts)) <= LONGEST_FILE_NAME


_NUMBER_KINDS: dict[Any, Any] = {
    int: numbers.Integral,
    float: numbers.Real,
    bool: np.bool_,
}
"""Annotations of one number, and what else than that class is one."""
_COLLECTION_KINDS = (collections.abc.Sequence, collections.abc.Iterable, list, tuple)


def _is_number(value: Any, wanted: type) -> bool:
    """One number of a kind; a real one may be an array without axes, too.

    True and False are no whole numbers.
    """
    if _is_numpy_or_jax(value):
        kind = getattr(value.dtype, "kind", "?")
        return wanted is float and np.ndim(value) == 0 and kind in "iuf"
    fits = isinstance(value, (wanted, _NUMBER_KINDS[wanted]))
    if wanted is int and fits:
        return not isinstance(value, bool) and -(2**63) <= int(value) < 2**63
    return fits


def _is_several(value: Any, inner: Any) -> bool:
    """Things one after the other that can be looked through twice; numbers, also as an
    array."""
    if _is_numpy_or_jax(value):
        alone = {inner, *typing.get_args(inner)}
        return np.ndim(value) == 1 and not alone.isdisjoint({int, float, complex, Any})
    several = isinstance(value, collections.abc.Sequence)
    return several and not isinstance(value, str | bytes)


def _is_array(value: Any, dims: tuple[Any, ...]) -> bool:
    """Numbers, or lists of them, with as many axes as an annotation names."""
    if not _is_numpy_or_jax(value):
        if not _is_several(value, None):
            return False
        try:
            value = np.asarray(value)
        except (TypeError, ValueError):
            return False
    kind = getattr(value.dtype, "kind", "?")
    return kind in "biufc" and np.ndim(value) == len(dims)


def _is_numpy_or_jax(value: Any) -> bool:
    """Whether it is an array, of known numbers or not; scalars of numpy are none."""
    return isinstance(value, np.ndarray) or hasattr(value, "aval")


def _is_ours(wanted: Any) -> bool:
    """A class of this package that tells its objects apart."""
    if typing.get_origin(wanted) in (typing.Union, types.UnionType):
        return any(map(_is_ours, typing.get_args(wanted)))
    is_class = isinstance(wanted, type) and wanted.__module__.startswith(PACKAGE_PREFIX)
    vague = getattr(wanted, "_is_protocol", False)
    return is_class and (not vague or getattr(wanted, "_is_runtime_protocol", False))


def _may_be_method(value: Any) -> bool:
    """Whether it could be a method of the user's own: what a verb needs, it says."""
    root = (value if isinstance(value, type) else type(value)).__module__.split(".")[0]
    return root not in PLAIN_PACKAGES and not _is_noun(value)


def _is_noun(value: Any) -> bool:
    """An object, or a class, of this package."""
    kind = value if isinstance(value, type) else type(value)
    return kind.__module__.startswith(PACKAGE_PREFIX)


def _describe_value(value: Any) -> str:
    if value is None:
        return "None"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    plain = isinstance(value, str | int | float | list | tuple | dict)
    shown = f" ({value!r})" if plain else ""
    return f"of type {type(value).__name__}{shown[:60]}"


def _describe_annotation(wanted: Any) -> str:
    """An annotation in words."""
    if typing.get_origin(wanted) in (typing.Union, types.UnionType):
        words = [_describe_annotation(each) for each in typing.get_args(wanted)]
        return " or ".join(dict.fromkeys(words))
    if wanted is type(None):
        return "None"
    words = {int: "a whole number", float: "a number", str: "a text"}
    words |= {bool: "True or False"}
    if wanted in words:
        return words[wanted]
    origin, inner = typing.get_origin(wanted), typing.get_args(wanted)
    if origin is collections.abc.Callable:
        return "a function"
    if origin is typing.Literal:
        return " or ".join(map(repr, inner))
    name = getattr(origin or wanted, "__name__", str(wanted))
    return f"{name} of {_describe_annotation(inner[-1])}" if inner and origin else name


def _advice(value: Any) -> str:
    if type(value).__name__ == "Solution" and _is_noun(value):
        return "; hand on its .value"
    if isinstance(value, type):
        return "; call the class to make one"
    return ""
