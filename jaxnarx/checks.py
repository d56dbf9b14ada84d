"""What a request is held to: `SpecError` names the field, the value and the way out.

Every check returns the value it was given, so that it can stand where that is used.
"""

import math
import operator
from collections.abc import Collection, Iterable

from jaxnarx.errors import SpecError, nearest, suggest

Number = float | int
Pair = tuple[Number, Number]


def require(holds: bool, field: str, message: str) -> None:
    """`SpecError` with `message` unless it `holds`."""
    if not holds:
        raise SpecError(message, field=field)


def known_name(name: str, names: Iterable[str], field: str, told: str = "") -> str:
    """`name` if it is one of `names`; else what was `told`, and the nearest of them."""
    names = list(names)
    if name not in names:
        told = told or f"unknown {field} {name!r}"
        raise SpecError(f"{told}. {suggest(str(name), names)}", field=field)
    return name


def choice(value: str, words: Collection[str], field: str) -> str:
    """`value` if it is one of a few `words`."""
    if value not in words:
        listed = ", ".join(map(repr, words))
        meant = nearest(str(value), words)
        raise SpecError(
            f"{field} must be one of {listed}, got {value!r}{meant and '. ' + meant}",
            field=field,
        )
    return value


def whole(value: int, field: str, least: int = 1) -> int:
    """`value` as a whole number that is at least `least`."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or number < least:
        raise SpecError(
            f"{field} must be a whole number from {least} on, got {value!r}",
            field=field,
        )
    return number


def finite(value: Number, field: str) -> float:
    """`value` as a float that is neither NaN nor infinite."""
    if not math.isfinite(value):
        raise SpecError(f"{field} must be a finite number, got {value}", field=field)
    return float(value)


def positive(value: Number, field: str, what: str = "a finite number") -> float:
    """`value` as a finite float above zero; `what` may tell its unit."""
    if not 0 < value < math.inf:
        raise SpecError(f"{field} must be {what} above zero, got {value}", field=field)
    return float(value)


def not_negative(value: Number, field: str) -> float:
    """`value` as a finite float of at least zero."""
    if not 0 <= value < math.inf:
        raise SpecError(f"{field} must not be negative, got {value}", field=field)
    return float(value)


def fraction(value: Number, field: str) -> float:
    """`value` as a float between zero and one, neither included."""
    if not 0 < value < 1:
        raise SpecError(f"{field} must lie between 0 and 1, got {value}", field=field)
    return float(value)


def span(pair: Pair, field: str) -> tuple[float, float]:
    """(low, high), both finite, low <= high."""
    low, high = pair
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise SpecError(
            f"{field} must be (low, high), finite, with low <= high, got {pair}",
            field=field,
        )
    return float(low), float(high)
