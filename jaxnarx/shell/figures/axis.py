"""Axes of a panel: round numbers on them, and the room that texts take."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.evaluation import Number, Range
from jaxnarx.shell.figures.palette import shorten

FONT, SMALL_FONT = 9.0, 7.5
"""Height of letters in points."""


@dataclasses.dataclass(frozen=True)
class Axis:
    """One axis of a panel: its range, and where it has which numbers."""

    low: Number
    high: Number
    log: bool
    ticks: tuple[tuple[Number, str], ...]

    def share(self, value: Float[np.ndarray, " _"]) -> Float[np.ndarray, " _"]:
        """The share of the way from low to high; NaN where there is none."""
        value = np.asarray(value, float)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if not self.log:
                return (value - self.low) / (self.high - self.low)
            value = np.where(value > 0, value, np.nan)
            return np.log(value / self.low) / math.log(self.high / self.low)


def find_axis(
    ends: Range, log: bool, most: Number, *, whole: bool = False, ticks=None
) -> Axis:
    """An axis with at most about `most` numbers at round values."""
    if ends[0] == ends[1]:
        ends = (ends[0] / 2, ends[0] * 2) if log else (ends[0] - 0.5, ends[0] + 0.5)
    low, high = sorted(ends)
    if ticks is None:
        ticks = _log_ticks(low, high, most) if log else ()
        if len(ticks) < 2:
            ticks = _even_ticks(low, high, most, whole)
    inside = tuple((v, t) for v, t in ticks if low <= v <= high)
    return Axis(*ends, log, inside)


def _even_ticks(low: Number, high: Number, most: Number, whole: bool):
    """At multiples of 1, 2, 2.5 or 5 times a power of ten."""
    rough = (high - low) / max(most, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * f for f in (1, 2, 2.5, 5, 10) if power * f >= rough * 0.999)
    if whole:
        step = max(1.0, math.ceil(step))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    places = [n * step for n in range(first, last + 1)]
    return [(v, text) for v, text in zip(places, _numbers(places, step), strict=True)]


def _numbers(places: Sequence[Number], step: Number) -> list[str]:
    """All with as many decimals as their step; with a power of ten where they are far
    from one."""
    largest = max(map(abs, places), default=0.0)
    if largest and not 1e-4 <= largest < 1e6:
        return [_power_text(v) for v in places]
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    if round(step * 10**digits) / 10**digits != round(step, digits + 3):
        digits += 1  # steps of 2.5
    return [f"{v:,.{digits}f}".replace("-", "−") if v else "0" for v in places]


def _power_text(value: Number) -> str:
    if not value:
        return "0"
    power = math.floor(math.log10(abs(value)) + 1e-12)
    lead, ten = f"{value / 10.0**power:.6g}", f"10{str(power).translate(_RAISED)}"
    text = ten if lead == "1" else f"{lead}·{ten}"
    return text.replace("-", "−")


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _log_ticks(low: Number, high: Number, most: Number):
    """Powers of ten, or 1, 2 and 5 of each where there is room."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    every = max(1, math.ceil((last - first) / max(most, 1)))
    leads = (1, 2, 5) if math.log10(high / low) <= most / 2.5 else (1,)
    found = []
    for power in range(first, last + 1):
        if power % every:
            continue
        for lead in leads:
            value = lead * 10.0**power
            plain = 1e-3 <= value < 1e6
            text = f"{value:,.10g}" if plain else _power_text(value)
            if low <= value <= high:
                found.append((value, text))
    return found


_NARROW, _BROAD = frozenset("iljtfrI.,:;|!'()[]{} -"), frozenset("mwMW@%—–")


def text_width(text: str, size: Number = FONT) -> Number:
    """About how wide a text is, in points."""
    letters = (
        0.31
        if c in _NARROW
        else 0.86
        if c in _BROAD
        else 0.66
        if c.isupper()
        else 1.0
        if ord(c) > 0x2E80
        else 0.56
        for c in text
    )
    return 1.05 * size * sum(letters)


def fit(text: str, room: Number, font: Number) -> str:
    """As much of a text as there is room for."""
    whole = shorten(text, 200)
    letters = max(4, int(len(whole) * room / max(text_width(whole, font), 1e-9)))
    return shorten(whole, letters)
