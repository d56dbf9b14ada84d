"""Numbers of a cycle: means, totals, peaks, percentiles, distances. Arrays."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.calibration.formulas import evaluate
from jaxnarx.settings import Measure

LEAST_WIDTH = 1e-3
"""Range of a signal, as a share of its size, below which it counts as this wide."""
Signal = Callable[[str], Float[Array, "draws samples"]]


def measure_value(
    measure: Measure, signal: Signal, sample_time: float, sharp: float = 0.0
) -> Float[Array, " draws"]:
    """A measure of all samples, of every draw of the plant.

    With `sharp` peaks are smooth: log-sum-exp, which lies above the peak by this share
    of the signal's range at most. So are percentiles: a mean of the values around, see
    `smooth_percentile`.
    """
    x = jnp.asarray(evaluate(measure.of, signal))
    match measure.kind:
        case "mean":
            return x.mean(axis=1)
        case "total":
            return x.sum(axis=1) * sample_time
        case "peak":
            return smooth_peak(x, sharp) if sharp else x.max(axis=1)
        case "lowest":
            return -smooth_peak(-x, sharp) if sharp else x.min(axis=1)
        case "percentile":
            return smooth_percentile(x, measure.share, sharp)
        case _:
            apart = x - evaluate(measure.target, signal)
            return jnp.sqrt(jnp.mean(apart**2, axis=1))


def smooth_percentile(
    x: Float[Array, "draws samples"], share: float, sharp: float
) -> Float[Array, " draws"]:
    """Mean of the sorted values up to a share `sharp` of the samples away, the nearer
    the more; between two values where `sharp` is zero.

    One value alone has a slope that changes wherever another one takes its place, and a
    search ends there.
    """
    count = x.shape[1]
    apart = np.abs(np.arange(count) - share * (count - 1))
    weight = np.maximum(1.0 - apart / max(1.0, sharp * count), 0.0)
    return jnp.sort(x, axis=1) @ jnp.asarray(weight / weight.sum(), x.dtype)


def smooth_peak(
    x: Float[Array, "draws samples"], sharp: float
) -> Float[Array, " draws"]:
    """log sum exp(b x) / b with b such that the error is `sharp` times the range."""
    size = LEAST_WIDTH * jnp.abs(x).max(axis=1) + 1e-300
    width = jnp.maximum(x.max(axis=1) - x.min(axis=1), size)
    b = jnp.log(float(x.shape[1])) / (sharp * width)
    return jax.nn.logsumexp(b[:, None] * x, axis=1) / b
