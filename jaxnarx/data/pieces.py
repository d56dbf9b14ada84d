"""A bounded sample of the rows of a data set, in uninterrupted pieces."""

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.record import Record
from jaxnarx.data.scaling import scaling_unit

_ANALYSED_ROWS = 1 << 15
"""About as many rows are looked at; statistics gain little from more."""

_LONGEST_PIECE = 1 << 12
"""Rows of the pieces that longer data are cut into."""


@dataclasses.dataclass(frozen=True, eq=False)
class Piece:
    """Consecutive rows of one record, in units of the channels' standard deviations."""

    u: Float[np.ndarray, "inputs time"]
    y: Float[np.ndarray, "outputs time"]

    def __len__(self) -> int:
        return self.y.shape[1]


def pieces(data: Dataset, *, every: int = 1) -> list[Piece]:
    """All rows of `data`, or pieces evenly spread over them where there are many.

    A row is the mean of `every` rows. Every channel is freed of its mean over all
    pieces and divided by its standard deviation, so that no offset and no unit matters;
    a constant channel is zero.
    """
    spans = [(r, 0, len(r)) for r in data if len(r)]
    if data.samples > _ANALYSED_ROWS * every:
        spans = [s for r in data for s in _cut(r, _LONGEST_PIECE * every)]
        count = max(_ANALYSED_ROWS * every * len(spans) // data.samples, 1)
        chosen = np.linspace(0, len(spans) - 1, count).round().astype(int)
        spans = [spans[i] for i in np.unique(chosen)]
    u = [average_samples(r.u[a:b].T, every) for r, a, b in spans]
    y = [average_samples(r.y[a:b].T, every) for r, a, b in spans]
    return [Piece(a, b) for a, b in zip(standardise(u), standardise(y), strict=True)]


def _cut(record: Record, longest: int) -> list[tuple[Record, int, int]]:
    count = -(-len(record) // longest)
    edges = np.linspace(0, len(record), count + 1).round().astype(int)
    return [
        (record, int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]


def usual_length(lengths: Iterable[int]) -> int:
    """Length of the longest record without which others hold under nine tenths of all
    samples: one long or a few short records do not change it."""
    known = np.sort(list(lengths))[::-1]
    return int(known[np.searchsorted(np.cumsum(known), 0.9 * known.sum())])


def average_samples(
    x: Float[np.ndarray, "channels time"], every: int
) -> Float[np.ndarray, "channels fewer"]:
    """Means of every `every` samples, in float64; incomplete ones are left out."""
    count = x.shape[1] // every
    return (
        x[:, : count * every]
        .astype(np.float64)
        .reshape(len(x), count, every)
        .mean(axis=2)
    )


def standardise(
    parts: list[Float[np.ndarray, "channels _"]],
) -> list[Float[np.ndarray, "channels _"]]:
    """Channels freed of their means over all `parts`, in units of their deviations.

    A constant channel is zero.
    """
    unit = scaling_unit(*parts)[:, None]
    parts = [p / unit for p in parts]
    count = sum(p.shape[1] for p in parts)
    mean = np.sum([p.sum(axis=1) for p in parts], axis=0) / count
    parts = [p - mean[:, None] for p in parts]
    size = np.sqrt(np.sum([np.sum(p**2, axis=1) for p in parts], axis=0) / count)
    # what is left of a constant after its mean is rounding
    still = size <= 1e-12 * np.abs(mean)
    scale = np.where(still, 0.0, 1 / np.where(still | (size == 0), 1.0, size))
    return [p * scale[:, None] for p in parts]
