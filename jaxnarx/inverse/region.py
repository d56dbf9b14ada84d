"""The region of some of many points, described by one channel and one border, or by
two."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.formatting import page

SECOND_BORDER_GAIN = 0.05
"""A second border is named where it tells so much more of the points right."""


@dataclasses.dataclass(frozen=True)
class Region:
    """Points where a channel lies above or below a border, in the channel's unit.

    `agreement` is the balanced share of points it tells right, the mean over flagged
    and other points: 1 is a clean cut, 0.5 says nothing. `low` and `high` hold 5 % and
    95 % of the flagged points' values of that channel. `also` is a second border, that
    of a corner, whose `agreement` is that of both together.
    """

    channel: str
    above: bool
    border: float
    agreement: float
    low: float
    high: float
    also: "Region | None" = None

    def __str__(self) -> str:
        if self.also is None:
            return (
                f"where {self._half} (in {self.low:.4g} to {self.high:.4g}; the border "
                f"tells {self.agreement:.0%} right)"
            )
        return (
            f"where {self._half} and {self.also._half} (the corner tells "
            f"{self.also.agreement:.0%} right)"
        )

    _repr_html_ = page

    @property
    def _half(self) -> str:
        side = "above" if self.above else "below"
        return f"{self.channel} is {side} {self.border:.4g}"

    def holds(
        self, place: Float[np.ndarray, "points channels"], names: list[str]
    ) -> Bool[np.ndarray, " points"]:
        """True for points that lie in it."""
        value = place[:, names.index(self.channel)]
        inside = value > self.border if self.above else value <= self.border
        return inside if self.also is None else inside & self.also.holds(place, names)


def find_region(
    place: Float[np.ndarray, "points channels"],
    names: list[str],
    flag: Bool[np.ndarray, " points"],
) -> Region:
    """The channel, side and border that tell flagged points from others best.

    All borders between neighbouring values are tried; then a second one on that side,
    which is kept where both together tell 5 % more right. `flag` must hold for some
    points and not for all.
    """
    if not flag.any() or flag.all():
        raise ValueError("a region needs flagged points and others")
    first = _half(place, names, flag)
    if first is None:
        raise ValueError("a region needs a channel that varies")
    inside = first.holds(place, names)
    if flag[inside].all() or not flag[inside].any():
        return first
    second = _half(place[inside], names, flag[inside])
    if second is None:
        return first
    corner = inside & second.holds(place, names)
    right = float(0.5 * (corner[flag].mean() + 1 - corner[~flag].mean()))
    if right < first.agreement + SECOND_BORDER_GAIN:
        return first
    second = dataclasses.replace(second, agreement=right)
    return dataclasses.replace(first, also=second)


def _half(
    place: Float[np.ndarray, "points channels"],
    names: list[str],
    flag: Bool[np.ndarray, " points"],
) -> Region | None:
    """The best single border; None where no channel varies."""
    best: tuple[float, Region] | None = None
    for column, name in zip(place.T, names, strict=True):
        order = np.argsort(column, kind="stable")
        value = column[order].astype(float)
        on = np.cumsum(flag[order]) / flag.sum()
        off = np.cumsum(~flag[order]) / (~flag).sum()
        cut = np.flatnonzero(np.diff(value) > 0)
        if not len(cut):
            continue
        # Share told right by "flagged below", balanced; "above" is its mirror.
        below = 0.5 * (on[cut] + 1 - off[cut])
        right = np.maximum(below, 1 - below)
        n = int(np.argmax(right))
        if best is None or right[n] > best[0]:
            low, high = np.quantile(column[flag].astype(float), [0.05, 0.95])
            border = 0.5 * (value[cut[n]] + value[cut[n] + 1])
            above = bool(below[n] < 0.5)
            found = Region(
                name, above, float(border), float(right[n]), float(low), float(high)
            )
            best = float(right[n]), found
    return None if best is None else best[1]
