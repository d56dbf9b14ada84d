"""How often, and how far, data leave the range that a network was trained on."""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from jaxnarx.data import Dataset, match_channels
from jaxnarx.evaluation.rows import FREE_RUN, POOLED_NAME, Row
from jaxnarx.evaluation.table import number
from jaxnarx.formatting import page
from jaxnarx.models import FLAG, OUTSIDE_WORDS, Network

NOTICEABLE_OUTSIDE_SHARE = 0.01
"""Share of samples outside from which a report says so."""


@dataclasses.dataclass(frozen=True)
class Outside:
    """An input of one part that leaves its trained range; physical units.

    `low` and `high` are reached in the part, `trained` in training; `share` of the
    valid samples lies outside.
    """

    part: str
    channel: str
    unit: str
    low: float
    high: float
    trained: tuple[float, float]
    share: float

    @property
    def beyond(self) -> float:
        """The farthest distance from the trained range, in widths of that range."""
        low, high = self.trained
        far = max(low - self.low, self.high - high)
        return far / (high - low) if high > low else float("inf")

    def __str__(self) -> str:
        reached = " to ".join(number(x) for x in (self.low, self.high))
        trained = " to ".join(number(x) for x in self.trained)
        unit = f" {self.unit}" if self.unit not in ("", "-", "1") else ""
        return (
            f"{self.channel} {reached}{unit}, trained on {trained}: beyond by up to "
            f"{number(100 * self.beyond, '.3g')} % of its width"
        )

    _repr_html_ = page


def find_outside(network: Any, parts: Mapping[str, Dataset]) -> tuple[Outside, ...]:
    """Every input that leaves its range in a part, farthest first."""
    if not isinstance(network, Network):
        return ()
    found = []
    lows, highs = (np.asarray(a).tolist() for a in (network.low, network.high))
    for part, data in parts.items():
        data = match_channels(data, network.channels)[0]
        used = {s for s, _ in network.variables}
        used |= {s for model in network.models for s, _ in model.scheduling}
        for s, channel in enumerate(network.channels.inputs):
            value = np.concatenate([r.u[r.valid[:, s], s] for r in data])
            low, high = lows[s], highs[s]
            slack = 1e-9 * (high - low)
            out = (value < low - slack) | (value > high + slack)
            if s in used and out.any():
                span = float(value.min()), float(value.max())
                name = (part, channel.name, channel.unit)
                found.append(Outside(*name, *span, (low, high), float(out.mean())))
    return tuple(sorted(found, key=lambda o: -o.beyond))


def range_notes(
    rows: Iterable[Row], found: Iterable[Outside], *, outside: str = FLAG
) -> list[str]:
    """Parts with at least 1 % of their samples outside the trained range, how far.

    `outside` is what the network's inputs do there.
    """
    share: dict[str, float] = {}
    for row in rows:
        if row.mode == FREE_RUN and row.record == POOLED_NAME:
            share[row.part] = max(share.get(row.part, 0.0), row.share_outside)
    how_far = {part: [o for o in found if o.part == part] for part in share}
    what = OUTSIDE_WORDS[outside].behind_share
    return [
        f"{100 * value:.3g} % of the {part} samples lie outside the range of the "
        f"training data, {what}"
        + "".join(f"; {o}" for o in how_far[part][:4])
        + ". `extrapolated` of a run's value marks them."
        for part, value in share.items()
        if value >= NOTICEABLE_OUTSIDE_SHARE
    ]


def held_notes(rows: Iterable[Row]) -> list[str]:
    """Outputs held at the edge of their trained range, with the records where at least
    1 % of the samples were; free run."""
    rows = [row for row in rows if row.mode == FREE_RUN and row.samples]
    notes = []
    for pooled in (row for row in rows if row.record == POOLED_NAME):
        own = [
            row
            for row in rows
            if (row.part, row.output) == (pooled.part, pooled.output)
            and row is not pooled
            and row.held >= NOTICEABLE_OUTSIDE_SHARE * row.samples
        ]
        own.sort(key=lambda row: -row.held / row.samples)
        if not own:
            continue
        told = [f"{_share(row)} of the samples of record {row.record}" for row in own]
        more = f" and {len(own) - 4} more records" if len(own) > 4 else ""
        notes.append(
            f"{pooled.output}, {pooled.part}, free run: {', '.join(told[:4])}{more} "
            f"were held at the edge of the trained range ({_share(pooled)} of all)."
        )
    return notes


def _share(row: Row) -> str:
    return f"{100 * row.held / row.samples:.3g} %"
