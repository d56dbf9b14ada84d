"""Fitted steps from JSON: only known kinds, only fields of the right type."""

import dataclasses
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any

from jaxnarx.data.preparation.cleaning import LowPass, OutliersMasked
from jaxnarx.data.preparation.crank_angle import AtCrankAngle, ToTime
from jaxnarx.data.preparation.levels import Detrend, OffsetRemoved, Scaled
from jaxnarx.data.preparation.resample import Decimate, Resample, Shift
from jaxnarx.data.preparation.step import AbstractFitted
from jaxnarx.errors import SpecError, suggest

STEP_KINDS: dict[str, type[AbstractFitted]] = {
    kind.__name__: kind
    for kind in (
        AtCrankAngle,
        Decimate,
        Detrend,
        LowPass,
        OffsetRemoved,
        OutliersMasked,
        Resample,
        Scaled,
        Shift,
        ToTime,
    )
}


def decode_step(table: Any) -> AbstractFitted:
    """The step that `AbstractFitted.to_dict` wrote; anything else is a SpecError."""
    table = decode(table, dict[str, Any], "steps")
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in STEP_KINDS:
        raise SpecError(
            f"there is no preparation step {kind!r}. {suggest(str(kind), STEP_KINDS)}",
            field="kind",
        )
    cls = STEP_KINDS[kind]
    fields = {k: v for k, v in table.items() if k != "kind"}
    return cls(**decode_fields(fields, cls, kind))


def decode_fields(table: Mapping[str, Any], cls: type, lead: str) -> dict[str, Any]:
    """Values for the constructor of a dataclass: every field once, none beside."""
    hints = typing.get_type_hints(cls)
    names = [f.name for f in dataclasses.fields(cls)]
    if set(table) != set(names):
        odd = sorted(set(table) ^ set(names))
        raise SpecError(
            f"{lead}: {', '.join(odd)} is missing or unknown; expected exactly "
            f"{', '.join(names)}",
            field=odd[0],
        )
    return {n: decode(table[n], hints[n], f"{lead}.{n}") for n in names}


def decode(value: Any, hint: Any, field: str) -> Any:
    """A JSON value as the type that `hint` states; SpecError names the field."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if origin in (types.UnionType, typing.Union):
        return _decode_first(value, inner, field)
    if origin is tuple and isinstance(value, list | tuple):
        return _sequence(value, inner, field)
    if origin in (dict, Mapping) and isinstance(value, Mapping):
        return {str(k): decode(v, inner[1], f"{field}.{k}") for k, v in value.items()}
    if hint is float and type(value) in (int, float) and abs(value) < 1e300:
        return float(value)
    if _is(value, hint, inner if origin is typing.Literal else ()):
        return value
    name = getattr(hint, "__name__", None) if origin is None else str(hint)
    raise SpecError(f"{field} must be {name}, got {value!r}", field=field)


def _is(value: Any, hint: Any, words: tuple[Any, ...]) -> bool:
    """Whether a plain value has the plain type `hint`, or is one of the words."""
    if hint is float:
        return False
    if isinstance(value, str) and value in words:
        return True
    return type(value) is hint


def _sequence(value: Sequence[Any], inner: tuple[Any, ...], field: str) -> tuple:
    if inner[-1] is Ellipsis:
        return tuple(decode(v, inner[0], field) for v in value)
    if len(value) != len(inner):
        raise SpecError(
            f"{field} must have {len(inner)} entries, got {value!r}", field=field
        )
    return tuple(decode(v, h, field) for v, h in zip(value, inner, strict=True))


def _decode_first(value: Any, hints: tuple[Any, ...], field: str) -> Any:
    """The first of several types that fits; float last, so that integers stay."""
    *others, last = sorted(hints, key=lambda h: h is float)
    for hint in others:
        try:
            return decode(value, hint, field)
        except SpecError:
            continue
    return decode(value, last, field)
