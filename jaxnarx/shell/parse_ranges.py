"""Options that give a name some numbers, such as `speed=800:4000`, and durations."""

import math
import re
from typing import Any

from jaxnarx.errors import SpecError

SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}


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


def seconds(text: str, option: str) -> float:
    """`90`, `90s`, `20min` or `1.5h` in seconds."""
    match = re.fullmatch(r"\s*([0-9.]+)\s*([a-z]*)\s*", text)
    if match is None or match[2] not in SECONDS or match[1].count(".") > 1:
        raise SpecError(
            f"{option} must be a time such as 90s, 20min or 1h, got {text!r}"
        )
    return float(match[1]) * SECONDS[match[2]]
