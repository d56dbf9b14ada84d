"""Classes of settings: frozen, their fields held to what they are annotated with.

A field that takes a list may be given any sequence, and is kept as a tuple; one text,
or one whole number, counts as a list of one. Rules for several fields at once stand in
a class's own `__post_init__`, which finds each of them right by itself.
"""

import dataclasses
import functools
import math
import sys
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Integral, Real
from typing import (
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

from jaxnarx.checks import choice
from jaxnarx.errors import SpecError

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Rule:
    """A rule for a number, in words behind "must", and as a test."""

    words: str
    holds: Callable[[Any], bool]


Count = Annotated[int, Rule("be at least 1", lambda n: n >= 1)]
Steps = Annotated[int, Rule("be at least 0", lambda n: n >= 0)]
Seed = Annotated[int, Rule("lie in [0, 2^31)", lambda n: 0 <= n < 2**31)]
Positive = Annotated[float | int, Rule("be positive", lambda x: 0 < x < math.inf)]
NotNegative = Annotated[
    float | int, Rule("be finite and not negative", lambda x: 0 <= x < math.inf)
]
Share = Annotated[float | int, Rule("lie in [0, 1)", lambda x: 0 <= x < 1)]
Chance = Annotated[float | int, Rule("lie in (0, 1)", lambda x: 0 < x < 1)]
Forgetting = Annotated[
    float | int,
    Rule("lie in (0, 1], where 1 forgets nothing", lambda x: 0 < x <= 1),
]


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def settings(kind: type[T]) -> type[T]:
    """A class decorator: a frozen dataclass whose fields are checked."""
    return _settings(kind, eq=True)


@dataclass_transform(
    frozen_default=True, eq_default=False, field_specifiers=(dataclasses.field,)
)
def unlike_settings(kind: type[T]) -> type[T]:
    """The same, but that two objects are equal only if they are one."""
    return _settings(kind, eq=False)


def _settings(kind: Any, *, eq: bool) -> Any:
    after: Any = getattr(kind, "__post_init__", None)

    def __post_init__(self: Any) -> None:
        for name, hint in field_hints(type(self)).items():
            value = _lists_to_tuples(hint, getattr(self, name))
            object.__setattr__(self, name, value)
            hold(hint, value, name)
        if after is not None:
            after(self)

    kind.__post_init__ = __post_init__
    return _annotate_plainly(dataclasses.dataclass(frozen=True, eq=eq)(kind))


_HELD_ANNOTATIONS: dict[type, dict[str, Any]] = {}
"""Annotations of classes of settings, with the rules that `help` does not show."""


def _annotate_plainly(kind: Any) -> Any:
    """A class whose annotations are plain types, as people read them."""
    _HELD_ANNOTATIONS[kind] = dict(vars(kind).get("__annotations__", {}))
    parts: tuple[Any, ...] = (kind, kind.__init__)
    for one in parts:
        one.__annotations__ = _resolve_hints(kind.__module__, one.__annotations__)
    return kind


def _resolve_hints(
    module: str, annotations: Mapping[str, Any], *, rules: bool = False
) -> dict[str, Any]:
    """Annotations with names resolved, by default without the rules of numbers."""
    holder = types.SimpleNamespace(__annotations__=dict(annotations))
    known = getattr(sys.modules.get(module), "__dict__", {})
    return get_type_hints(holder, globalns=known, include_extras=rules)


@functools.cache
def field_hints(kind: type) -> dict[str, Any]:
    """The fields of a class of settings and what they may hold."""
    hints: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        own = _HELD_ANNOTATIONS.get(base) or vars(base).get("__annotations__") or {}
        hints |= _resolve_hints(base.__module__, own, rules=True)
    return {f.name: hints[f.name] for f in dataclasses.fields(kind) if f.name != "_"}


def union_members(hint: Any) -> tuple[Any, ...]:
    """The members of a union, or the one type there is, without bounds."""
    origin, inside = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return tuple(kind for part in inside for kind in union_members(part))
    return union_members(inside[0]) if origin is Annotated else (hint,)


def hold(hint: Any, value: Any, name: str) -> None:
    """`SpecError` unless a value is of the kind of its field, and within its bounds."""
    if get_origin(hint) is Literal:
        choice(value, get_args(hint), name)
    if not fits(hint, value):
        raise SpecError(f"{name} must be {words(hint)}, got {value!r}", field=name)
    parts = get_args(hint) if len(union_members(hint)) > 1 else (hint,)
    for part in (hint, *parts):
        if get_origin(part) is Annotated and fits(part, value):
            for bound in part.__metadata__:
                if not bound.holds(value):
                    raise SpecError(
                        f"{name} must {bound.words}, got {value}", field=name
                    )


def fits(hint: Any, value: Any) -> bool:
    """Whether a value is of the kind that a field is annotated with."""
    origin, inside = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return fits(inside[0], value)
    if origin in (Union, types.UnionType):
        return any(fits(part, value) for part in inside)
    if origin is Literal:
        return value in inside
    if hint is Any or hint is type(value):
        return True
    if hint in (None, type(None)):
        return value is None
    if isinstance(value, bool):
        return hint is bool
    if hint is int:
        return isinstance(value, Integral)
    if hint is float:
        return isinstance(value, Real)
    if origin is tuple and inside[-1] is not ...:
        listed = isinstance(value, list | tuple) and len(value) == len(inside)
        return listed and all(map(fits, inside, value))
    if origin in (tuple, Sequence):
        listed = isinstance(value, list | tuple)
        return listed and all(fits(inside[0], item) for item in value)
    if origin is Mapping:
        return isinstance(value, Mapping) and all(
            fits(inside[0], k) and fits(inside[1], v) for k, v in value.items()
        )
    return isinstance(hint, type) and isinstance(value, hint)


_TYPE_WORDS = {
    int: "a whole number",
    float: "a number",
    str: "text",
    bool: "true or false",
}


def words(hint: Any) -> str:
    """The values that a field may hold, for messages."""
    kinds = union_members(hint)
    if len(kinds) > 1:
        parts = [p for p in kinds if p is not int or float not in kinds]
        return " or ".join(dict.fromkeys(map(words, parts)))
    kind = next(iter(kinds))
    origin, inside = get_origin(kind), get_args(kind)
    if origin is Literal:
        return "one of " + ", ".join(map(str, inside))
    if origin is tuple and inside[-1] is not ...:
        return f"{len(inside)} numbers"
    if origin in (tuple, Sequence):
        return "a list"
    if origin is Mapping:
        return "a table by name"
    none = "none" if kind is type(None) else f"a {getattr(kind, '__name__', kind)}"
    return _TYPE_WORDS.get(kind, none)


def _lists_to_tuples(hint: Any, value: Any) -> Any:
    """A value as its field keeps it: lists as tuples, one alone as a list of one."""
    kinds = union_members(hint)
    lists = [k for k in kinds if get_origin(k) in (Sequence, tuple)]
    if not lists or value is None or isinstance(value, Mapping):
        return value
    of = get_args(lists[0])[0]
    alone = isinstance(value, str) or isinstance(value, Integral)
    if alone:
        single = fits(of, value) and not any(fits(k, value) for k in kinds)
        return (value,) if single else value
    if not isinstance(value, Iterable) or getattr(value, "shape", None) == ():
        return value
    return tuple(_lists_to_tuples(of, item) for item in value)
