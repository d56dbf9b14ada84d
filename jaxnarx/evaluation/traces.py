"""Data of a report's figures: chosen records, and residuals in free run."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx import metrics
from jaxnarx.data import Channel
from jaxnarx.evaluation.rows import ScoredSamples

SCATTER_PAIRS = 3000
"""At most so many (measured, simulated) pairs are kept for the scatter figure."""


@dataclasses.dataclass(frozen=True, eq=False)
class Trace:
    """One output of one record, measured and simulated. `time` [s] starts at zero.

    `rank` is `"worst"`, `"median"` or `"best"` by free-run RMSE, empty for the others;
    a diverged record is worse than any other and has no `rmse`. `lower` and `upper`
    are its prediction intervals, where the network knows its errors.
    """

    output: Channel
    record: str
    rank: str
    rmse: float | None
    time: Float[np.ndarray, " time"]
    measured: Float[np.ndarray, " time"]
    simulated: Float[np.ndarray, " time"]
    one_step: Float[np.ndarray, " time"] | None
    limited: Bool[np.ndarray, " time"]
    scored: Bool[np.ndarray, " time"]
    lower: Float[np.ndarray, " time"] | None = None
    upper: Float[np.ndarray, " time"] | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Residuals:
    """Free-run residuals (measured - simulated) over all records that stayed bounded.

    `counts` and `edges` are their histogram, `mean` and `deviation` its moments, all in
    the unit of the output; `measured` and `simulated` are evenly thinned pairs. With no
    sample to count, all are empty and the moments 0.
    """

    output: Channel
    mean: float
    deviation: float
    counts: Int[np.ndarray, " bins"]
    edges: Float[np.ndarray, " borders"]
    measured: Float[np.ndarray, " pairs"]
    simulated: Float[np.ndarray, " pairs"]


def choose(
    channel: Channel,
    free: list[ScoredSamples],
    one_step: list[ScoredSamples] | None,
    sample_time: float,
    edges: list[tuple[np.ndarray, np.ndarray]] | None = None,
) -> tuple[Trace, ...]:
    """The worst, the median and the best record, then the others in their order.

    Records without any counted sample are passed over. `edges` are the lower and the
    upper end of the intervals of every record.
    """
    counted = [i for i, s in enumerate(free) if s.scored.any()]
    order = sorted(counted, key=lambda i: _rmse(free[i]), reverse=True)
    picks = {len(order) - 1: "best", len(order) // 2: "median", 0: "worst"}
    if len(order) == 1:
        picks = {0: "only"}
    ranked = {order[p]: r for p, r in sorted(picks.items()) if 0 <= p < len(order)}
    ranked |= {i: "" for i in counted if i not in ranked}
    return tuple(
        _trace(channel, free[i], rank, sample_time, one_step, i, edges)
        for i, rank in ranked.items()
    )


def residuals(channel: Channel, free: list[ScoredSamples], bins: int = 41) -> Residuals:
    """Histogram and thinned pairs of the records that did not diverge."""
    calm = [s for s in free if not s.diverged and s.scored.any()]
    empty = np.zeros(0)
    if not calm:
        return Residuals(channel, 0.0, 0.0, np.zeros(0, int), empty, empty, empty)
    measured = np.concatenate([s.measured[s.scored] for s in calm])
    simulated = np.concatenate([s.predicted[s.scored] for s in calm])
    error = measured - simulated
    counts, edges = _histogram(error, bins)
    kept = np.unique(np.linspace(0, len(error) - 1, SCATTER_PAIRS).astype(int))
    return Residuals(
        channel,
        float(error.mean()),
        float(error.std()),
        counts,
        edges,
        measured[kept],
        simulated[kept],
    )


def _histogram(error: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Counts about zero, up to the largest error; equal errors make one narrow bin."""
    scale = float(np.max(np.abs(error))) or 1.0
    counts, edges = np.histogram(error / scale, bins, (-1.0, 1.0))
    return counts, edges * scale


def _rmse(samples: ScoredSamples) -> float:
    if samples.diverged:
        return np.inf
    return float(metrics.rmse(samples.measured, samples.predicted, samples.scored)[0])


def _trace(
    channel: Channel,
    free: ScoredSamples,
    rank: str,
    sample_time: float,
    one_step: list[ScoredSamples] | None,
    index: int,
    edges: list[tuple[np.ndarray, np.ndarray]] | None,
) -> Trace:
    lower, upper = (None, None) if edges is None else edges[index]
    return Trace(
        output=channel,
        record=free.record,
        rank=rank,
        rmse=None if free.diverged else _rmse(free),
        time=np.arange(len(free.measured)) * float(sample_time),
        measured=free.measured[:, 0],
        simulated=free.predicted[:, 0],
        one_step=None if one_step is None else one_step[index].predicted[:, 0],
        limited=free.limited[:, 0],
        scored=free.scored[:, 0],
        lower=lower,
        upper=upper,
    )
