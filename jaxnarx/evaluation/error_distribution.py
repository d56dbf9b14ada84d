"""How large free-run errors are: the largest, 95 % of them, and the whole curve."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Channel
from jaxnarx.evaluation.rows import ScoredSamples

CURVE_POINTS = 201
"""Points of the cumulated curve."""
REPORTED_QUANTILE = 0.95
"""Share of the samples whose error is told beside the largest."""


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorDistribution:
    """Sizes of the free-run error of one output on the main part, in its unit.

    The share `share[n]` of the samples has an error of at most `size[n]`; the largest
    is the last. `within` is the share of those up to the `tolerance` that was asked
    for. Records that diverged are left out, and counted in no share.
    """

    output: str
    unit: str
    samples: int
    share: Float[np.ndarray, " points"]
    size: Float[np.ndarray, " points"]
    tolerance: float | None = None
    within: float | None = None

    @property
    def largest(self) -> float:
        """The largest error."""
        return float(self.size[-1])

    @property
    def most(self) -> float:
        """The error that 95 % of the samples do not exceed."""
        return float(np.interp(REPORTED_QUANTILE, self.share, self.size))


def error_distribution(
    channel: Channel, free: list[ScoredSamples], tolerance: float | None
) -> ErrorDistribution | None:
    """The distribution of one output's errors; None where no record that stayed bounded
    counts."""
    errors = [
        np.abs(one.measured - one.predicted)[one.scored]
        for one in free
        if not one.diverged and one.scored.any()
    ]
    if not errors:
        return None
    size = np.sort(np.concatenate(errors))
    share = np.linspace(0.0, 1.0, min(CURVE_POINTS, len(size)))
    if len(size) == 1:
        share = np.array([1.0])
    curve = np.quantile(size, share)
    within = None if tolerance is None else float(np.mean(size <= tolerance))
    name = channel.name, channel.unit, len(size)
    return ErrorDistribution(*name, share, curve, tolerance, within)
