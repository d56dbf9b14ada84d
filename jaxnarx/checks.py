"""Checks of requests: `SpecError` names the field, the value and the way out.

Every check returns the value it was given, so that it can stand where that is used.
"""

import math
import numbers
from collections.abc import Collection, Iterable
from typing import Any

from jaxnarx.errors import SpecError, nearest, suggest

Number = float | int
Pair = tuple[Number, Number]


def require(holds: bool, field: str, message: str) -> None:
    """`SpecError` with `message` unless it `holds`."""
    if not holds:
        raise SpecError(message, field=field)


def require_known(name: Any, names: Iterable[str], field: str, told: str = "") -> Any:
    """`name` if it is one of `names`; else what was `told`, and the nearest of them."""
    names = list(names)
    if not _is_among(name, names):
        told = told or f"unknown {field} {name!r}"
        raise SpecError(f"{told}. {suggest(str(name), names)}", field=field)
    return name


def _is_among(value: Any, words: Collection[Any]) -> bool:
    """Whether it is one of some words; arrays and what has no hash are none."""
    try:
        return bool(value in words)
    except (TypeError, ValueError):
        return False


def choice(value: Any, words: Collection[str], field: str) -> str:
    """`value` if it is one of a few `words`."""
    if not _is_among(value, words):
        listed = ", ".join(map(repr, words))
        meant = nearest(str(value), words)
        raise SpecError(
            f"{field} must be one of {listed}, got {value!r}{meant and '. ' + meant}",
            field=field,
        )
    return value


def whole(value: Any, field: str, least: int = 1, most: int | None = None) -> int:
    """`value` as a whole number from `least` to `most`."""
    is_whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    number = int(value) if is_whole else least - 1
    if number >= least and (most is None or number <= most):
        return number
    if most is not None:
        wanted = f"a whole number from {least} to {most}"
    else:
        wanted = f"at least {least}" if is_whole else "a whole number"
    raise SpecError(f"{field} must be {wanted}, got {value!r}", field=field)


def finite(value: Number, field: str) -> float:
    """`value` as a float that is neither NaN nor infinite."""
    if not math.isfinite(value):
        raise SpecError(f"{field} must be a finite number, got {value}", field=field)
    return float(value)


def positive(
    value: Any, field: str, what: str = "finite number", *, below: Number = math.inf
) -> float:
    """`value` as a float above zero and `below` a limit; `what` may tell its unit."""
    is_real = isinstance(value, numbers.Real) and not isinstance(value, bool)
    number = float(value) if is_real else math.nan
    if not 0 < number < below:
        to = f" below {below:g}" if below < math.inf else ""
        raise SpecError(
            f"{field} must be a positive {what}{to}, got {value!r}", field=field
        )
    return number


def not_negative(value: Number, field: str) -> float:
    """`value` as a finite float of at least zero."""
    if not 0 <= value < math.inf:
        raise SpecError(
            f"{field} must be finite and must not be negative, got {value}", field=field
        )
    return float(value)


def random_key(key: Any, field: str = "key") -> Any:
    """`key` if `jax.random` takes it."""
    import jax

    try:
        jax.random.key_data(key)
    except (TypeError, ValueError):
        raise SpecError(
            f"{field} must be a key such as jax.random.key(0), got a "
            f"{type(key).__name__}",
            field=field,
        ) from None
    return key


def span(pair: Pair, field: str) -> tuple[float, float]:
    """(low, high), both finite, low <= high."""
    low, high = pair
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise SpecError(
            f"{field} must be (low, high), finite, with low <= high, got {pair}",
            field=field,
        )
    return float(low), float(high)
