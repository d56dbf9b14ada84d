"""How well prediction intervals hold, output by output of every part."""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool
from scipy.special import ndtri, stdtrit

from jaxnarx import metrics
from jaxnarx.confidence import Intervals, intervals
from jaxnarx.data import Channel, Dataset
from jaxnarx.evaluation.rows import ScoredSamples
from jaxnarx.evaluation.table import number
from jaxnarx.formatting import page
from jaxnarx.models import Network
from jaxnarx.simulation import Prepared

INTERVAL_LEVEL = 0.9
"""Probability of the intervals of a report."""
TOLERATED_SHORTFALL = 0.03
"""Share below the level that no report warns of."""
UNLIKELY_PROBABILITY = 0.05
"""Probability that chance over records leaves as few inside."""
SHORT_ALONE = 0.1
"""Share below the level of a single record, which tells nothing of chance."""
WIDE_HALF_WIDTH_RMSE = 2.9
"""RMSE in half a width from which an interval of `INTERVAL_LEVEL` is too wide to be of
use; a normal error needs 1.64."""


@dataclasses.dataclass(frozen=True)
class IntervalCoverage:
    """The share of the samples of a part that the intervals of one output hold.

    `held` is the share inside, which should be `level`; `half` is half their width in
    the mean and `rmse` the error, in the unit of the output; `chance` is how far below
    the level so many records may lie by chance. Records that diverged are left out.
    """

    part: str
    output: str
    unit: str
    level: float
    held: float
    half: float
    samples: int
    rmse: float
    chance: float

    @property
    def least(self) -> float:
        """The share that they must hold: the level less what chance explains."""
        return self.level - max(self.chance, TOLERATED_SHORTFALL)

    @property
    def is_narrow(self) -> bool:
        """Whether they hold less than they claim, and chance does not explain it."""
        return self.held < self.least

    @property
    def is_wide(self) -> bool:
        """Whether they are far wider than the error asks for, and hold more than they
        claim. A normal error would need ndtri((1 + level)/2) times its deviation."""
        normal = float(
            ndtri(0.5 + 0.5 * self.level) / ndtri(0.5 + 0.5 * INTERVAL_LEVEL)
        )
        return (
            self.held > self.level
            and self.half >= WIDE_HALF_WIDTH_RMSE * normal * self.rmse
        )

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit not in ("", "-", "1") else ""
        return f"{self.output} {self.held:.1%} (± {number(self.half, '.3g')}{unit})"

    _repr_html_ = page


def interval_runs(
    network: Any, parts: Mapping[str, Dataset | Prepared], free: Mapping[str, Any]
) -> dict[str, Intervals]:
    """Intervals around the free runs at hand, by part; empty without an error model."""
    known = isinstance(network, Network) and network.errors is not None
    if not known or network.domain is None:
        return {}
    return {
        part: intervals(
            network,
            data,
            level=INTERVAL_LEVEL,
            run=getattr(free[part], "value", free[part]),
        ).value
        for part, data in parts.items()
    }


def coverage(
    part: str,
    outputs: Iterable[Channel],
    found: Intervals,
    free: list[list[ScoredSamples]],
) -> list[IntervalCoverage]:
    """A line per output with samples that count."""
    lines = []
    for o, (channel, samples) in enumerate(zip(outputs, free, strict=True)):
        inside, half, error = [], [], []
        for n, one in enumerate(samples):
            if one.diverged:
                continue
            counted = one.scored[:, 0]
            y = one.measured[counted, 0]
            low, high = found.lower[n][counted, o], found.upper[n][counted, o]
            inside.append((y >= low) & (y <= high))
            half.append(0.5 * (high - low))
            error.append(metrics.rmse(one.measured, one.predicted, one.scored)[0])
        count = np.array([len(one) for one in inside])
        if count.sum():
            every, width = np.concatenate(inside), np.concatenate(half)
            name = (part, channel.name, channel.unit, found.level)
            figures = float(every.mean()), float(width.mean()), len(every)
            seen = count > 0
            rmse = metrics.pooled_rms(np.array(error)[seen], count[seen])
            lines.append(IntervalCoverage(*name, *figures, rmse, _chance(inside)))
    return lines


def _chance(inside: list[Bool[np.ndarray, " samples"]]) -> float:
    """The distance by which the share inside may lie below its level by chance over
    records.

    Errors of a record are not independent: its share counts as one, weighted by its
    samples, with the quantile of Student's distribution.
    """
    inside = [one for one in inside if len(one)]
    records, samples = len(inside), sum(map(len, inside))
    if records < 2:
        return SHORT_ALONE
    share = np.concatenate(inside).mean()
    apart = sum((one.sum() - share * len(one)) ** 2 for one in inside)
    error = np.sqrt(apart * records / (records - 1)) / samples
    return float(-stdtrit(records - 1, UNLIKELY_PROBABILITY) * error)


def coverage_notes(lines: Iterable[IntervalCoverage], main: str) -> list[str]:
    """Notes on the share that the main part's intervals hold, and where it is too
    small."""
    own = [line for line in lines if line.part == main]
    if not own:
        return []
    level = f"{100 * own[0].level:g} %"
    told = ", ".join(map(str, own))
    notes = [f"{level} intervals of the free run hold, on {main}: {told}."]
    short = [line for line in own if line.is_narrow]
    if short:
        notes.append(
            f"The {level} intervals are too narrow on {main} for "
            f"{', '.join(line.output for line in short)}: errors there are larger than "
            "in the records left out when the model was made. Do not rest on them."
        )
    return notes
