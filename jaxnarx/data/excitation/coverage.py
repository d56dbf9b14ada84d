"""How much of the operating space a record visits, as numbers."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.data.excitation.placement import Box, box, discrepancy
from jaxnarx.data.excitation.require import whole
from jaxnarx.errors import DataError, SpecError

Points = Float[Array, "samples inputs"] | Float[np.ndarray, "samples inputs"]


@dataclasses.dataclass(frozen=True, eq=False)
class Coverage:
    """Shares of the operating space that points visit; all from 0 to 1.

    `range_used` is the span of the points in each input's range; `pairs[i, j]` the
    share of the `bins` by `bins` cells of inputs i and j with a point in them (the
    diagonal: of the `bins` cells of one input); `whole` the share of the cells of the
    whole space, cut into `whole_bins` for each input, as many as there can be, up to
    `bins`, without more cells than points; `outside` the share of the points that lie
    outside the space, which visit no cell. `discrepancy` is the centred L2 discrepancy,
    0 for perfectly even points.
    """

    names: tuple[str, ...]
    samples: int
    range_used: Float[np.ndarray, " inputs"]
    pairs: Float[np.ndarray, "inputs inputs"]
    bins: int
    whole: float
    whole_bins: int
    outside: float
    discrepancy: float

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and names, ready for JSON."""
        values = dataclasses.asdict(self)
        return {
            k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()
        } | {"names": list(self.names)}

    def __str__(self) -> str:
        width = max(len(n) for n in self.names)
        lines = [
            f"{name:<{width}}  {used:6.1%} of the range, {self.pairs[i, i]:6.1%} of "
            f"{self.bins} parts of it"
            for i, (name, used) in enumerate(
                zip(self.names, self.range_used, strict=True)
            )
        ]
        lines += [
            f"{a} x {b}: {self.pairs[i, j]:.1%} of {self.bins**2} cells"
            for i, a in enumerate(self.names)
            for j, b in enumerate(self.names[:i])
        ]
        cells = self.whole_bins ** len(self.names)
        lines.append(
            f"whole space: {self.whole:.1%} of {cells} cells, discrepancy "
            f"{self.discrepancy:.3g}, {self.outside:.1%} of {self.samples} samples "
            "outside"
        )
        return "\n".join(lines)


def coverage(
    points: Points,
    low: Box,
    high: Box,
    *,
    bins: int = 10,
    names: Sequence[str] | None = None,
) -> Coverage:
    """What `points` visit of the box from `low` to `high`, in the units of the inputs.

    Cells are equal parts of the box, closed below, the last one above too. Coverage
    grows with the number of points whatever the signal: compare records of about the
    same length.
    """
    low, high = box(low, high)
    bins = whole(bins, "bins")
    x = _points(points, low)
    names = [f"input {i + 1}" for i in range(len(low))] if names is None else names
    inside = np.all((x >= low) & (x <= high), axis=1)
    kept = x[inside]
    cell = cells(kept, low, high, bins)
    coarse = _whole_bins(len(x), len(low), bins)
    clipped = np.clip(x, low, high)
    return Coverage(
        names=tuple(names),
        samples=len(x),
        range_used=(clipped.max(axis=0) - clipped.min(axis=0)) / (high - low),
        pairs=_pairs(cell, bins),
        bins=bins,
        whole=_share(cells(kept, low, high, coarse), coarse),
        whole_bins=coarse,
        outside=float(1 - inside.mean()),
        discrepancy=discrepancy(x, low, high),
    )


def cells(
    points: Float[np.ndarray, "samples inputs"],
    low: Float[np.ndarray, " inputs"],
    high: Float[np.ndarray, " inputs"],
    bins: int,
) -> Int[np.ndarray, "samples inputs"]:
    """Cell along each input, 0 to `bins` - 1; points outside go to the nearest."""
    part = np.floor(bins * (points - low) / (high - low)).astype(int)
    return np.clip(part, 0, bins - 1)


def _pairs(
    cell: Int[np.ndarray, "samples inputs"], bins: int
) -> Float[np.ndarray, "inputs inputs"]:
    n = cell.shape[1]
    share = np.zeros((n, n))
    for i in range(n):
        share[i, i] = _share(cell[:, i : i + 1], bins)
        for j in range(i):
            share[i, j] = share[j, i] = _share(cell[:, [i, j]], bins)
    return share


def _share(cell: Int[np.ndarray, "samples inputs"], bins: int) -> float:
    """Share of the cells that appear."""
    count = bins ** cell.shape[1]
    visited = np.zeros(count, bool)
    visited[cell @ bins ** np.arange(cell.shape[1])] = True
    return float(visited.mean())


def _whole_bins(samples: int, inputs: int, most: int) -> int:
    return max(b for b in range(1, most + 1) if b == 1 or b**inputs <= samples)


def _points(points: Points, low: np.ndarray) -> np.ndarray:
    x = np.asarray(points, float)
    if x.ndim != 2 or x.shape[1] != len(low):
        raise SpecError(
            f"points must be an array of samples by {len(low)} inputs, got shape "
            f"{x.shape}",
            field="points",
        )
    if not len(x) or not np.all(np.isfinite(x)):
        raise DataError(
            "coverage needs one or more points, all finite; leave out missing samples"
        )
    return x
