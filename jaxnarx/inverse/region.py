"""Where some of many points lie, said by one channel and one border."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float


@dataclasses.dataclass(frozen=True)
class Region:
    """Points where a channel lies above or below a border, in the channel's unit.

    `agreement` is the balanced share of points it tells right, the mean over flagged
    and other points: 1 is a clean cut, 0.5 says nothing. `low` and `high` hold 5 % and
    95 % of the flagged points' values of that channel.
    """

    channel: str
    above: bool
    border: float
    agreement: float
    low: float
    high: float

    def __str__(self) -> str:
        side = "above" if self.above else "below"
        return (
            f"where {self.channel} is {side} {self.border:.4g} (in {self.low:.4g} to "
            f"{self.high:.4g}; the border tells {self.agreement:.0%} right)"
        )


def find_region(
    place: Float[np.ndarray, "points channels"],
    names: list[str],
    flag: Bool[np.ndarray, " points"],
) -> Region:
    """The channel, side and border that tell flagged points from others best.

    All borders between neighbouring values are tried. `flag` must hold for some points
    and not for all.
    """
    if not flag.any() or flag.all():
        raise ValueError("a region needs flagged points and others")
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
    if best is None:
        raise ValueError("a region needs a channel that varies")
    return best[1]
