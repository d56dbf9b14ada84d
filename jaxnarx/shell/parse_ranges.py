"""Options that give a name some numbers, such as `speed=800:4000`, and durations."""

import math
import re
from typing import Any

from jaxnarx.errors import SpecError

UNIT_SECONDS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
"""Seconds of the units of a time; without one it is in seconds."""


def parse_assignment(
    text: str, option: str, form: str, *wanted: int
) -> tuple[Any, ...]:
    """The name, and as many numbers as one of `wanted`."""
    name, _, values = text.rpartition("=")
    try:
        numbers = [float(x) for x in values.split(":")]
    except ValueError:
        numbers = []
    if not name or len(numbers) not in wanted or not all(map(math.isfinite, numbers)):
        raise SpecError(f"{option} must be {form}, got {text!r}")
    return name, *numbers


def parse_seconds(text: str, option: str) -> float:
    """`90`, `90s`, `20min`, `20m` or `1.5h` in seconds; SpecError unless positive."""
    found = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)", text.strip().lower())
    if found is None or found[2] not in UNIT_SECONDS or not float(found[1]):
        raise SpecError(f"{option} takes a time such as 90s, 20min or 1h, got {text!r}")
    return float(found[1]) * UNIT_SECONDS[found[2]]
