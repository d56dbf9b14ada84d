"""What the makers of signals ask of their arguments: `SpecError` names the argument."""

import math
import operator
from collections.abc import Collection

from jaxnarx.errors import SpecError, suggest

Number = float | int
Pair = tuple[Number, Number]


def whole(value: int, field: str, least: int = 1) -> int:
    """`value` as a whole number that is at least `least`."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or number < least:
        raise SpecError(
            f"{field} must be a whole number of at least {least}, got {value!r}",
            field=field,
        )
    return number


def finite(value: Number, field: str) -> float:
    """`value` as a float that is neither NaN nor infinite."""
    if not math.isfinite(value):
        raise SpecError(f"{field} must be a finite number, got {value}", field=field)
    return float(value)


def positive(value: Number, field: str) -> float:
    """`value` as a finite float above zero."""
    if not (math.isfinite(value) and value > 0):
        raise SpecError(
            f"{field} must be a finite number above zero, got {value}", field=field
        )
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


def hold_range(hold: tuple[int, int]) -> tuple[int, int]:
    """(shortest, longest) in samples, 1 <= shortest <= longest."""
    shortest, longest = (whole(h, "hold") for h in hold)
    if shortest > longest:
        raise SpecError(
            f"hold must be (shortest, longest) in samples with 1 <= shortest <= "
            f"longest, got {hold}",
            field="hold",
        )
    return shortest, longest


def member(value: str, known: Collection[str], field: str) -> str:
    """`value` if it is one of `known`."""
    if value not in known:
        raise SpecError(
            f"unknown {field} {value!r}. {suggest(value, known)}", field=field
        )
    return value
