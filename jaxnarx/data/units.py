"""Units as measurement files write them, and how one becomes another.

Only what cannot be misread is converted; everything else must be the same text. Beside
a speed of rotation `1/s` and `Hz` count revolutions, and what reading converts is told.
"""

import math
import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnarx.formatting import page


class Conversion(NamedTuple):
    """new = factor * old + offset."""

    factor: float
    offset: float

    def __call__(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """The values in the new unit, of the type they have."""
        if self == (1.0, 0.0):
            return x
        return (x * self.factor + self.offset).astype(x.dtype)

    def __str__(self) -> str:
        offset = f" {self.offset:+.6g}" if self.offset else ""
        return f"times {self.factor:.6g}{offset}"

    _repr_html_ = page


_UNIT_SPELLINGS: dict[str, dict[str, tuple[float, float]]] = {
    "dimensionless": {"-|1": (1.0, 0.0), "%|pct|percent": (0.01, 0.0)},
    "speed of rotation": {
        "rpm|1/min|min-1|min^-1|U/min|r/min|rev/min|/min": (1.0, 0.0),
        "rad/s": (30 / math.pi, 0.0),
        "1/s|s-1|s^-1|U/s|r/s|rev/s|rps|Hz": (60.0, 0.0),
    },
    "pressure": {
        "Pa": (1.0, 0.0),
        "hPa|mbar": (1e2, 0.0),
        "kPa": (1e3, 0.0),
        "bar": (1e5, 0.0),
        "MPa": (1e6, 0.0),
        "psi": (6894.757293168361, 0.0),
    },
    "temperature": {
        "K|Kelvin": (1.0, 0.0),
        "degC|°C|C|Cel|deg C|Celsius": (1.0, 273.15),
        "degF|°F|deg F": (5 / 9, 273.15 - 160 / 9),
    },
    "torque": {"Nm|N·m|N*m|N.m": (1.0, 0.0), "kNm": (1e3, 0.0)},
    "power": {"W": (1.0, 0.0), "kW": (1e3, 0.0), "PS": (735.49875, 0.0)},
    "energy": {
        "J": (1.0, 0.0),
        "kJ": (1e3, 0.0),
        "MJ": (1e6, 0.0),
        "Wh": (3600.0, 0.0),
        "kWh": (3.6e6, 0.0),
    },
    "mass": {"kg": (1.0, 0.0), "g": (1e-3, 0.0), "mg": (1e-6, 0.0)},
    "mass flow": {
        "kg/s": (1.0, 0.0),
        "g/s": (1e-3, 0.0),
        "mg/s": (1e-6, 0.0),
        "kg/h": (1 / 3600, 0.0),
        "g/h": (1e-3 / 3600, 0.0),
    },
    "mass per stroke": {
        "mg/stroke|mg/str|mg/stk|mg/hub|mg/Hub|mg/H": (1.0, 0.0),
        "g/stroke": (1e3, 0.0),
    },
    "angle": {
        "deg|°|degCA|°CA|deg CA|degCrk|°KW|°crk": (1.0, 0.0),
        "rad": (180 / math.pi, 0.0),
    },
    "time": {
        "s|sec": (1.0, 0.0),
        "ms|msec": (1e-3, 0.0),
        "us|µs": (1e-6, 0.0),
        "min": (60.0, 0.0),
        "h": (3600.0, 0.0),
    },
    "velocity": {"m/s": (1.0, 0.0), "km/h|kph": (1 / 3.6, 0.0), "mph": (0.44704, 0.0)},
    "length": {"m": (1.0, 0.0), "cm": (1e-2, 0.0), "mm": (1e-3, 0.0)},
    "voltage": {"V": (1.0, 0.0), "mV": (1e-3, 0.0)},
    "current": {"A": (1.0, 0.0), "mA": (1e-3, 0.0)},
    "share of volume": {
        "ppm": (1e-6, 0.0),
        "vol%|Vol%|% vol|Vol.-%|%vol": (1e-2, 0.0),
    },
}
_KNOWN_UNITS = {
    name: (dimension, *scale)
    for dimension, units in _UNIT_SPELLINGS.items()
    for names, scale in units.items()
    for name in names.split("|")
}

LEVEL_QUANTITIES = (
    "temperature",
    "pressure",
    "speed of rotation",
    "velocity",
    "angle",
    "length",
)
"""Quantities that are levels: a sum of them over a record means nothing."""
_PER_TIME = {"/s": 1.0, "/sec": 1.0, "/min": 60.0, "/h": 3600.0}
_INTEGRALS = {"W": "J", "kW": "kJ"}
_PLAIN_RATES = re.compile(r"Hz|1?/(s|min)|(s|min)\^?-1")
"""Units that count revolutions beside a speed of rotation alone."""


class BaseUnit(NamedTuple):
    """A unit in those of SI and the radian: exponents by their names, and value in them
    = factor * value + offset."""

    exponents: dict[str, int]
    factor: float
    offset: float


_BASE_UNITS: dict[str, tuple[dict[str, int], float]] = {
    "dimensionless": ({}, 1.0),
    "speed of rotation": ({"s": -1, "rad": 1}, math.pi / 30),
    "pressure": ({"kg": 1, "m": -1, "s": -2}, 1.0),
    "temperature": ({"K": 1}, 1.0),
    "torque": ({"kg": 1, "m": 2, "s": -2}, 1.0),
    "power": ({"kg": 1, "m": 2, "s": -3}, 1.0),
    "energy": ({"kg": 1, "m": 2, "s": -2}, 1.0),
    "mass": ({"kg": 1}, 1.0),
    "mass flow": ({"kg": 1, "s": -1}, 1.0),
    "mass per stroke": ({"kg": 1}, 1e-6),
    "angle": ({"rad": 1}, math.pi / 180),
    "time": ({"s": 1}, 1.0),
    "velocity": ({"m": 1, "s": -1}, 1.0),
    "length": ({"m": 1}, 1.0),
    "voltage": ({"kg": 1, "m": 2, "s": -3, "A": -1}, 1.0),
    "current": ({"A": 1}, 1.0),
    "share of volume": ({}, 1.0),
}
"""The unit that `_UNIT_SPELLINGS` counts each quantity in, in base units."""


def bare(unit: str) -> str:
    """The unit without brackets and what else only surrounds it."""
    text = unit.strip().strip("[]()").strip()
    return text.replace("\N{GREEK SMALL LETTER MU}", "\N{MICRO SIGN}")


def conversion(old: str, new: str) -> Conversion | None:
    """The conversion from one unit to another; None where they do not measure the same
    for certain."""
    old, new = bare(old), bare(new)
    if old == new:
        return Conversion(1.0, 0.0)
    if old not in _KNOWN_UNITS or new not in _KNOWN_UNITS:
        return None
    (one, factor, offset), (other, scale, shift) = _KNOWN_UNITS[old], _KNOWN_UNITS[new]
    if one != other:
        return None
    return Conversion(factor / scale, (offset - shift) / scale)


def same_unit(a: str, b: str) -> bool:
    """Whether two stated units are one, however they are spelt."""
    return conversion(a, b) == (1.0, 0.0)


def dimension(unit: str) -> str | None:
    """The quantity of a unit, such as `"temperature"`; None where it is not known."""
    found = _KNOWN_UNITS.get(bare(unit))
    return None if found is None else found[0]


def is_known(unit: str) -> bool:
    """Whether it is one of the table."""
    return bare(unit) in _KNOWN_UNITS


def base_unit(unit: str) -> BaseUnit | None:
    """A unit in base units; None where it is not known, or may count revolutions or
    anything else, as 1/s does."""
    found = _KNOWN_UNITS.get(bare(unit))
    if found is None or _PLAIN_RATES.fullmatch(bare(unit)):
        return None
    quantity, factor, offset = found
    exponents, scale = _BASE_UNITS[quantity]
    return BaseUnit(exponents, factor * scale, offset * scale)


def sum_over_time(unit: str) -> tuple[str, float] | None:
    """The unit of the sum over time of what has this unit, g of g/h, and how many
    seconds its time has, 3600; None where it is no rate."""
    text = bare(unit)
    if dimension(text) in LEVEL_QUANTITIES:
        return None
    if text in _INTEGRALS:
        return _INTEGRALS[text], 1.0
    for ending, seconds in _PER_TIME.items():
        head = text.removesuffix(ending).strip()
        if head and head != text and "/" not in head:
            return ("" if head == "1" else head), seconds
    return None
