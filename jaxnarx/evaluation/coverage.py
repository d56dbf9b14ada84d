"""How well prediction intervals hold, output by output of every part."""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from jaxnarx.data import Channel, Dataset
from jaxnarx.evaluation.rows import ScoredSamples
from jaxnarx.evaluation.table import number
from jaxnarx.models import Network
from jaxnarx.shown import page
from jaxnarx.trust import Intervals, intervals

LEVEL = 0.9
"""Probability of the intervals of a report."""
SHORT = 0.1
"""Share below the level from which a report warns."""


@dataclasses.dataclass(frozen=True)
class IntervalCoverage:
    """What the intervals of one output hold of the samples of a part.

    `held` is the share inside, which should be `level`; `half` is half their width in
    the mean, in the unit of the output. Records that diverged are left out.
    """

    part: str
    output: str
    unit: str
    level: float
    held: float
    half: float
    samples: int

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit not in ("", "-", "1") else ""
        return f"{self.output} {self.held:.1%} (± {number(self.half, '.3g')}{unit})"

    _repr_html_ = page


def interval_runs(
    network: Any, parts: Mapping[str, Dataset], free: Mapping[str, Any]
) -> dict[str, Intervals]:
    """By part, around the free runs at hand; empty without an error model."""
    known = isinstance(network, Network) and network.errors is not None
    if not known or network.domain is None:
        return {}
    return {
        part: intervals(
            network, data, level=LEVEL, run=getattr(free[part], "value", free[part])
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
        inside, half = [np.zeros(0, bool)], [np.zeros(0)]
        for n, one in enumerate(samples):
            if one.diverged:
                continue
            counted = one.scored[:, 0]
            y = one.measured[counted, 0]
            low, high = found.lower[n][counted, o], found.upper[n][counted, o]
            inside.append((y >= low) & (y <= high))
            half.append(0.5 * (high - low))
        every, width = np.concatenate(inside), np.concatenate(half)
        if len(every):
            name = (part, channel.name, channel.unit, found.level)
            figures = float(every.mean()), float(width.mean()), len(every)
            lines.append(IntervalCoverage(*name, *figures))
    return lines


def coverage_notes(lines: Iterable[IntervalCoverage], main: str) -> list[str]:
    """What the main part's intervals hold, and where that is too little."""
    own = [line for line in lines if line.part == main]
    if not own:
        return []
    level = f"{100 * own[0].level:g} %"
    told = ", ".join(map(str, own))
    notes = [f"{level} intervals of the free run hold, on {main}: {told}."]
    short = [line for line in own if line.held < line.level - SHORT]
    if short:
        notes.append(
            f"The {level} intervals are too narrow on {main} for "
            f"{', '.join(line.output for line in short)}: errors there are larger than "
            "in the records left out when the model was made. Do not rest on them."
        )
    return notes
