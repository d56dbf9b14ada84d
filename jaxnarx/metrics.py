"""Measures of agreement between a measured and a predicted output, per output.

Every function takes `y` measured, `yhat` predicted and a `mask` of the samples that
count, all of shape (time, outputs) or (records, time, outputs), as NumPy or jax arrays,
and returns one number per output; records are pooled. All can be traced, and have a
derivative by `yhat` wherever there is one; where the error is zero throughout, zero
stands for it.

    e = jnx.metrics.nrmse(runs.measured, jnx.free_run(net, runs), runs.scored)

Edges, the same everywhere. *No* counted sample gives the worst value (`inf`, or `-inf`
where larger is better), never NaN: an error that was not measured is not a small one. A
counted prediction that is not finite gives the worst value as well. A *constant* output
has no spread to compare with: a zero error gives the perfect value, any other error the
worst. Samples that `mask` leaves out have no influence, finite or not. Squares are
taken of scaled values, so magnitudes up to 1e150 neither overflow nor vanish.

Reference: Z. Li 2012, (4.43), (4.44), (6.8).
"""

import functools
import typing
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Bool, Float, Shaped

__all__ = ["fit", "nmse", "nrmse", "r2", "rmse", "scores"]

F = TypeVar("F", bound=Callable[..., Any])
Array = np.ndarray | jax.Array


def _compile(metric: F) -> F:
    """Compile for jax arrays; NumPy's are taken as they are."""
    program = jax.jit(metric)

    @functools.wraps(metric)
    def call(*args, **kwargs):
        given = (*args, *kwargs.values())
        ours = program if any(isinstance(a, jax.Array) for a in given) else metric
        return ours(*args, **kwargs)

    return typing.cast(F, call)


PERFECT_VALUES = {"rmse": 0.0, "nrmse": 0.0, "r2": 1.0, "fit": 100.0, "nmse": 0.0}
"""The metrics in the order in which they are shown, with the value of a perfect fit."""


@_compile
def rmse(
    y: Float[Array, "*records time outputs"],
    yhat: Float[Array, "*records time outputs"],
    mask: Bool[Array, "*records time outputs"],
) -> Float[Array, " outputs"]:
    """Root mean square error in the unit of `y`; 0 is perfect, no sample gives `inf`.

    sqrt(sum e^2 / N), e = y - yhat, over the N samples where `mask` holds.
    """
    return _root_mean_square(_pool_records(_error(y, yhat, mask)), _pool_records(mask))


@_compile
def nrmse(
    y: Float[Array, "*records time outputs"],
    yhat: Float[Array, "*records time outputs"],
    mask: Bool[Array, "*records time outputs"],
) -> Float[Array, " outputs"]:
    """Root mean square error over the standard deviation of `y`, that is sqrt(SSE/SST).

    Both moments use only samples where `mask` holds. Dimensionless; 0 is perfect, 1 is
    as good as predicting the mean, larger is worse. A constant output gives `inf`
    unless the error is zero.
    """
    return _quotient(
        rmse(y, yhat, mask), _spread(_pool_records(y), _pool_records(mask))
    )


@_compile
def r2(
    y: Float[Array, "*records time outputs"],
    yhat: Float[Array, "*records time outputs"],
    mask: Bool[Array, "*records time outputs"],
) -> Float[Array, " outputs"]:
    """Coefficient of determination (4.44), 1 - SSE/SST; 1 is perfect, 0 is the mean.

    A constant output, or no sample, gives `-inf` unless the error is zero.
    """
    with np.errstate(over="ignore"):
        return 1.0 - nrmse(y, yhat, mask) ** 2


@_compile
def fit(
    y: Float[Array, "*records time outputs"],
    yhat: Float[Array, "*records time outputs"],
    mask: Bool[Array, "*records time outputs"],
) -> Float[Array, " outputs"]:
    """Fit ratio (4.43) in percent: 100 (1 - |y - yhat| / |y - mean y|).

    100 is perfect, 0 is as good as the mean, and it may be negative. A constant output,
    or no sample, gives `-inf` unless the error is zero.
    """
    with np.errstate(over="ignore"):
        return 100.0 * (1.0 - nrmse(y, yhat, mask))


@_compile
def nmse(
    y: Float[Array, "*records time outputs"],
    yhat: Float[Array, "*records time outputs"],
    mask: Bool[Array, "*records time outputs"],
) -> Float[Array, " outputs"]:
    """Var(e)/Var(y), the thesis's NMSE (6.8). *Blind to bias*, and not 1 - R2.

    A prediction that is wrong by a constant scores a perfect 0, so read it beside the
    RMSE. A constant output gives `inf` unless the error is constant too.
    """
    y, error, mask = (
        _pool_records(y),
        _pool_records(_error(y, yhat, mask)),
        _pool_records(mask),
    )
    xp = _namespace(y)
    measured = xp.isfinite(_root_mean_square(error, mask))
    scatter = xp.where(measured, _spread(error, mask), xp.inf)
    with np.errstate(over="ignore"):
        return _quotient(scatter, _spread(y, mask)) ** 2


def scores(
    measured: Float[Array, "*records time outputs"],
    predicted: Float[Array, "*records time outputs"],
    mask: Bool[Array, "*records time outputs"],
) -> dict[str, Shaped[Array, " outputs"]]:
    """Compute all metrics by name, and `samples`, the count of samples in `mask`."""
    values: dict[str, Any] = {
        name: function(measured, predicted, mask)
        for name, function in zip(
            PERFECT_VALUES, (rmse, nrmse, r2, fit, nmse), strict=True
        )
    }
    return values | {"samples": _pool_records(mask).sum(axis=0)}


def is_constant(
    y: Float[Array, "*records time outputs"], mask: Bool[Array, "*records time outputs"]
) -> Bool[Array, " outputs"]:
    """Whether the counted samples of an output are all equal (or there are none)."""
    return _spread(_pool_records(y), _pool_records(mask)) == 0


def pooled_rms(
    errors: Float[np.ndarray, " parts"], count: Shaped[np.ndarray, " parts"]
) -> float:
    """Root mean square over all samples from that of every part; 0 without samples.

    The largest is taken out before squaring, so nothing overflows.
    """
    scale = float(np.max(errors, initial=0.0)) or 1.0
    if not np.isfinite(scale):
        return scale
    square = count @ (errors / scale) ** 2 / max(count.sum(), 1)
    return scale * float(np.sqrt(square))


def _namespace(y: Array) -> Any:
    return y.__array_namespace__()


def _pool_records(value: Array) -> Array:
    """All records behind one another."""
    return value if value.ndim == 2 else value.reshape(-1, value.shape[-1])


def _root(square: Array) -> Array:
    """Square root whose slope at zero is zero."""
    xp = _namespace(square)
    some = square > 0
    return xp.where(some, xp.sqrt(xp.where(some, square, 1.0)), 0.0)


def _error(y: Array, yhat: Array, mask: Array) -> Array:
    """y - yhat, zero outside `mask`, `inf` where a counted value is not finite."""
    xp = _namespace(y)
    with np.errstate(over="ignore", invalid="ignore"):
        error = xp.where(mask, y - yhat, 0.0)
    return xp.where(xp.isfinite(error), error, xp.inf)


def _root_mean_square(value: Array, mask: Array) -> Array:
    """sqrt(mean(value^2)); the largest magnitude is taken out before squaring."""
    xp = _namespace(value)
    largest = xp.max(xp.abs(xp.where(mask, value, 0.0)), axis=0, initial=0.0)
    scale = xp.where(xp.isfinite(largest) & (largest > 0), largest, 1.0)
    scaled = xp.where(mask & xp.isfinite(value), value, 0.0) / scale[None]
    count = xp.sum(mask, axis=0, dtype=value.dtype)
    mean = xp.sum(scaled**2, axis=0) / xp.maximum(count, 1.0)
    usable = (count > 0) & xp.isfinite(largest)
    return xp.where(usable, scale * _root(mean), xp.inf)


def _spread(value: Array, mask: Array) -> Array:
    """Standard deviation (divisor N); exactly 0 for equal values or no sample.

    Deviations are taken from the middle of the range first: the mean of equal numbers
    need not be that number in floating point.
    """
    xp = _namespace(value)
    high = xp.max(xp.where(mask, value, -xp.inf), axis=0, initial=-xp.inf)
    low = xp.min(xp.where(mask, value, xp.inf), axis=0, initial=xp.inf)
    known = xp.isfinite(high) & xp.isfinite(low)
    high, low = xp.where(known, high, 0.0), xp.where(known, low, 0.0)
    middle, half = 0.5 * high + 0.5 * low, 0.5 * high - 0.5 * low
    varied = half > 0
    centred = xp.where(mask & varied[None], value, middle[None]) - middle[None]
    unit = centred / xp.where(varied, half, 1.0)[None]
    count = xp.maximum(xp.sum(mask, axis=0, dtype=value.dtype), 1.0)
    mean = xp.sum(unit, axis=0) / count
    deviation = xp.where(mask, unit - mean[None], 0.0)
    spread = half * _root(xp.sum(deviation**2, axis=0) / count)
    return xp.where(varied, spread, 0.0)


def _quotient(error: Array, spread: Array) -> Array:
    """error / spread; 0 / 0 is 0, and anything else over 0 is `inf`."""
    xp = _namespace(error)
    divided = spread > 0
    with np.errstate(over="ignore"):
        ratio = error / xp.where(divided, spread, 1.0)
    return xp.where(divided, ratio, xp.where(error > 0, xp.inf, 0.0))
