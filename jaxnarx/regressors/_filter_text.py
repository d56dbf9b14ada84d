"""Filters as people read them, `lp(speed, 4 s)`, and back.

The channel comes first and the numbers of the filter last, so that a name may hold
commas and brackets itself. Numbers are written so that they read back exactly.
"""

import re
from collections.abc import Collection

from jaxnarx.errors import SpecError
from jaxnarx.regressors.filters import (
    AbstractFilter,
    Kautz,
    Laguerre,
    LowPass,
    Orthonormal,
)

_FORM_PATTERN = re.compile(
    r"^(?P<kind>lp|laguerre|kautz|basis)\((?P<inside>.*)\)$", re.DOTALL
)
_ARGUMENT_COUNTS = {"lp": 1, "laguerre": 2, "kautz": 3, "basis": 2}
WRITTEN_FORMS = (
    "'lp(name, 4 s)', 'laguerre(name, 4 s, 2)', 'kautz(name, 2 rad/s, 0.5, 1)' or "
    "'basis(name, -0.25 -1+2j 1/s, 3)'"
)
"""Filters that can be written, for messages."""


def _number(value: float | complex) -> str:
    """Shortest text that reads back as the same number, without brackets."""
    value = complex(value)
    if value.imag:
        return f"{_number(value.real)}+{_number(value.imag)}j"
    return repr(value.real).removesuffix(".0")


def filter_text(filter_: AbstractFilter, name: str) -> str:
    """`filter_` of channel `name`, time constants in s, frequencies in rad/s."""
    if isinstance(filter_, LowPass):
        return f"lp({name}, {_number(filter_.time_constant)} s)"
    if isinstance(filter_, Laguerre):
        return f"laguerre({name}, {_number(filter_.time_constant)} s, {filter_.order})"
    if isinstance(filter_, Kautz):
        about = f"{_number(filter_.frequency)} rad/s, {_number(filter_.damping)}"
        return f"kautz({name}, {about}, {filter_.order})"
    assert isinstance(filter_, Orthonormal)
    poles = " ".join(_number(p) for p in filter_.poles)
    return f"basis({name}, {poles} 1/s, {filter_.order})"


def parse_filter(
    text: str, names: Collection[str]
) -> tuple[str, AbstractFilter] | None:
    """(channel, filter) of `"lp(speed, 4 s)"`; None where it has not that form.

    `names` are the known channels: one of them is found as it is written, otherwise
    blanks around it do not count. Numbers out of range raise `SpecError`.
    """
    match = _FORM_PATTERN.match(text.strip())
    if match is None:
        return None
    kind = match["kind"]
    name, *numbers = match["inside"].rsplit(",", _ARGUMENT_COUNTS[kind])
    if len(numbers) != _ARGUMENT_COUNTS[kind]:
        return None
    try:
        filter_ = _read(kind, [n.strip() for n in numbers])
    except SpecError:
        raise
    except ValueError as error:
        raise SpecError(
            f"{text!r} is not a filter; write {WRITTEN_FORMS}", field="filters"
        ) from error
    return (name if name in names else name.strip()), filter_


def _read(kind: str, numbers: list[str]) -> AbstractFilter:
    if kind == "lp":
        return LowPass(_quantity(numbers[0], "s"))
    if kind == "laguerre":
        return Laguerre(_quantity(numbers[0], "s"), int(numbers[1]))
    if kind == "kautz":
        frequency = _quantity(numbers[0], "rad/s")
        return Kautz(frequency, float(numbers[1]), int(numbers[2]))
    poles = numbers[0].removesuffix("1/s").split()
    return Orthonormal(tuple(map(complex, poles)), int(numbers[1]))


def _quantity(text: str, unit: str) -> float:
    """A number with its unit, which may be left out."""
    return float(text.removesuffix(unit))
