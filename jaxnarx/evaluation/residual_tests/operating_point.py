"""Residuals by operating point: where in its range the model is off."""

import dataclasses

import numpy as np
import scipy.special
from jaxtyping import Float, Int

from jaxnarx.arrays import quadratic
from jaxnarx.data import scaling_unit
from jaxnarx.evaluation.residual_tests.residual import Residual

DEFAULT_BINS = 10


@dataclasses.dataclass(frozen=True, eq=False)
class OperatingPoint:
    """Mean and standard deviation of the residual in bins of one variable.

    Bin n reaches from `edges[n]` to `edges[n + 1]` (the variable's unit); bins hold
    equally many samples as far as values differ. `mean` and `deviation` have the unit
    of the output; `error` is the standard error of the mean if the model is right: less
    than deviation/sqrt(samples) where the fit has pulled it to zero. `statistic` is F,
    with `freedom`, for all means being zero (after a fit with a constant: equal), `p`
    its probability.
    """

    variable: str
    unit: str
    edges: Float[np.ndarray, " borders"]
    samples: Int[np.ndarray, " bins"]
    mean: Float[np.ndarray, " bins"]
    deviation: Float[np.ndarray, " bins"]
    error: Float[np.ndarray, " bins"]
    statistic: float
    freedom: tuple[float, float]
    p: float

    @property
    def effect(self) -> float:
        """Share of the residual's mean square that the means of the bins explain."""
        unit = scaling_unit(self.mean, self.deviation)
        between = float(np.sum(self.samples * (self.mean / unit) ** 2))
        spare = (self.samples - 1).clip(0)
        within = float(np.sum(spare * (self.deviation / unit) ** 2))
        return between / (between + within) if between > 0 else 0.0

    def times(self, unit: float) -> "OperatingPoint":
        """The same with residuals `unit` times as large."""
        sizes = ("mean", "deviation", "error")
        larger = {name: getattr(self, name) * unit for name in sizes}
        return dataclasses.replace(self, **larger)


def bin_by_operating_point(
    residual: Residual,
    values: Float[np.ndarray, " samples"],
    *,
    variable: str,
    unit: str = "",
    bins: int = DEFAULT_BINS,
) -> OperatingPoint | None:
    """Bins of `values`, one for each known residual in flat order, and their test.

    The sums T_b of the residual over the bins have covariance V = sum_b s_b^2 W_b'W_b,
    with W what the fit leaves of the bins' indicators and s_b the deviation in each
    bin, which may differ. F = T'V^-1 T/rank V: without a fit this is Welch's test of
    equal means (1951) to first order, with one it is that of adding the bins to the
    regressors. Residuals with autocorrelation make it speak up too often. None where
    the variable has one value.
    """
    edges = np.unique(np.quantile(values, np.linspace(0, 1, bins + 1)))
    if len(edges) < 2:
        return None
    bin_of = np.clip(
        np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2
    )
    e = residual.value[residual.known]
    count = np.bincount(bin_of, minlength=len(edges) - 1)
    total = np.bincount(bin_of, e, len(count))
    safe = np.maximum(count, 1)
    spread = np.bincount(bin_of, (e - (total / safe)[bin_of]) ** 2, len(count))
    spread = np.sqrt(spread / np.maximum(count - 1, 1))
    place = np.searchsorted(np.flatnonzero(residual.known), residual.at)
    own = bin_of[place]
    indicator = (own[:, None] == np.arange(len(count))[None]).astype(float)
    w = residual.remove_fit_and_mean(indicator) * spread[own][:, None]
    v = w.T @ w * residual.share
    whole, rank = quadratic(v, total, least=1e-6)
    statistic = whole / max(rank, 1)
    freedom = (float(rank), max(residual.freedom - rank, 1.0))
    p = float(scipy.special.fdtrc(*freedom, statistic)) if rank else 1.0
    shift = residual.mean if residual.centred else 0.0
    error = np.sqrt(np.diagonal(v)) / safe
    return OperatingPoint(
        variable,
        unit,
        edges,
        count,
        total / safe + shift,
        spread,
        error,
        statistic,
        freedom,
        p,
    )
