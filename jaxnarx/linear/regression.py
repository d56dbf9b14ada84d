"""Linear regression: coefficients, how sure they are, and which samples decided.

With weights w_n as inverse noise variances up to a common factor, theta has covariance
sigma^2 (X'WX)^-1. A ridge or forgetting add to or fade what the samples say, so that
the covariance becomes sigma^2 P (X'VX) P with P = (X'WX + ridge)^-1 and v_n = w_n times
the square of the sample's fading (it is one without forgetting).
"""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import (
    LeastSquaresFit,
    leverage,
    solve_least_squares,
    solve_recursively,
)
from jaxnarx.linear.regression_input import require_numbers, require_weights
from jaxnarx.settings import LeastSquares
from jaxnarx.solution import RESULTS, Solution


@dataclasses.dataclass(frozen=True, eq=False)
class Regression:
    """A linear regression y = X theta + e and its figures; host arrays.

    Units are those of `y` and of `y` over the column's. `degrees` is the number of
    residual degrees of freedom: samples of positive weight less the rank (with a ridge
    less the sum of the leverages; with forgetting the sum of the fadings less the trace
    of P X'VX). Where it is not
    positive `sigma` and all that follows from it are nan.

    `leverage` is the hat diagonal. `studentised` residuals are the error of a sample
    over its standard deviation in a fit without that sample (external studentisation),
    `cook` is Cook's distance; both are zero for samples of weight zero and nan where
    the leverage is one. R. D. Cook, S. Weisberg, Residuals and Influence in Regression,
    1982. `r2` is the coefficient of determination (thesis 4.44), about the mean of `y`
    also without a constant column; nan for a constant `y`.
    """

    names: tuple[str, ...]
    coefficient: Float[np.ndarray, " terms"]
    covariance: Float[np.ndarray, "terms terms"]
    rank: int
    condition: float
    degrees: float
    sigma: float
    r2: float
    residual: Float[np.ndarray, " time"]
    leverage: Float[np.ndarray, " time"]
    studentised: Float[np.ndarray, " time"]
    cook: Float[np.ndarray, " time"]
    method: LeastSquares

    @property
    def standard_error(self) -> Float[np.ndarray, " terms"]:
        """Standard deviation of each coefficient."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def t(self) -> Float[np.ndarray, " terms"]:
        """Coefficient over standard error; nan where the latter is zero or nan."""
        error = self.standard_error
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(error > 0, self.coefficient / error, np.nan)

    @property
    def p(self) -> Float[np.ndarray, " terms"]:
        """Two-sided probability of a larger |t| if the coefficient were zero."""
        return 2.0 * scipy.special.stdtr(max(self.degrees, 1e-300), -np.abs(self.t))

    def interval(self, level: float = 0.95) -> Float[np.ndarray, "terms 2"]:
        """Confidence interval of every coefficient by Student's distribution."""
        factor = scipy.special.stdtrit(max(self.degrees, 1e-300), (1.0 + level) / 2)
        reach = factor * self.standard_error
        return np.stack([self.coefficient - reach, self.coefficient + reach], axis=1)

    @property
    def table(self) -> str:
        """Coefficients with standard errors, t, p and 95 % intervals, as text."""
        return regression_table(self)


def regression_table(value: Regression) -> str:
    """Head with the fit as a whole, then a line per coefficient, as statsmodels has it.

    t and p test each coefficient in the model as it is; they know nothing of a search
    that chose the columns.
    """
    method = value.method
    width = max(11, *(len(name) for name in value.names))
    head = [
        f"{len(value.residual)} samples, {len(value.names)} coefficients, "
        f"{value.degrees:.6g} degrees of freedom",
        f"algorithm {method.algorithm}, columns scaled by {method.scaling}, ridge "
        f"{method.ridge:g}, forgetting {method.forgetting:g}",
        f"rank {value.rank}, condition {value.condition:.3g}, sigma "
        f"{value.sigma:.6g}, R2 {value.r2:.6g}",
        "",
        f"{'':{width}s} {'coefficient':>13s} {'std. error':>11s} {'t':>9s} "
        f"{'P>|t|':>9s} {'[0.025':>13s} {'0.975]':>13s}",
    ]
    columns = (value.coefficient, value.standard_error, value.t, value.p)
    rows = np.column_stack([*columns, value.interval()])
    return "\n".join(
        head
        + [
            f"{name:{width}s} {b:13.6g} {e:11.3g} {t:9.2f} {p:9.2g} "
            f"{low:13.6g} {high:13.6g}"
            for name, (b, e, t, p, low, high) in zip(value.names, rows, strict=True)
        ]
    )


@partial(jax.jit, static_argnames=("algorithm", "scaling"))
def _fit(
    x, y, weight, ridge, cutoff, forgetting, *, algorithm, scaling
) -> LeastSquaresFit:
    options = {"scaling": scaling, "ridge": ridge}
    if algorithm == "recursive":
        return solve_recursively(x, y, weight, forgetting=forgetting, **options)
    return solve_least_squares(
        x, y, weight, algorithm=algorithm, cutoff=cutoff, **options
    )


@jax.jit
def _figures(
    x: Float[Array, "terms time"],
    y: Float[Array, " time"],
    weight: Float[Array, " time"],
    fade: Float[Array, " time"],
    fit: LeastSquaresFit,
):
    """Residuals, leverages, and the factor of sigma^2 in the covariance."""
    residual = y - jnp.sum(x * fit.coefficient[:, None], axis=0)
    spread = fit.root.T @ (x * (jnp.sqrt(weight) * fade)[None])
    return residual, leverage(x, weight * fade, fit.root), spread @ spread.T


@guard_arguments
def least_squares(
    columns: Any,
    y: Any,
    method: LeastSquares | None = None,
    *,
    weights: Any = None,
    names: Sequence[str] | None = None,
) -> Solution[Regression]:
    """Linear regression of `y` on `columns`, (time, terms) numbers in any unit.

    Nothing is added: a constant needs a column of ones. `weights` are inverse noise
    variances up to a factor, one per sample, not negative; `names` of the columns
    (default x1, x2, ...).

    Columns that are collinear, or nearly so, are no failure here: `rank` and `cond` of
    the scaled columns are in the value and in `stats`, the coefficients then have
    minimum norm, and `detail` says so. Fewer samples than columns: the same with status
    `too_short`. Numbers that are not finite: `DataError` with column and row. Status
    `unidentifiable` where long forgetting has left nothing in some direction.
    """
    method = LeastSquares() if method is None else method
    x, target, labels = require_numbers(columns, y, names)
    weight = require_weights(weights, target)
    data = jnp.asarray(x.T), jnp.asarray(target), jnp.asarray(weight)
    dtype = target.dtype
    recursive = method.algorithm == "recursive"
    # A cut-off of None is part of the program, a number is not.
    settings = (method.ridge, method.cutoff, method.forgetting)
    swept = (None if v is None else jnp.asarray(v, dtype) for v in settings)
    fit = _fit(*data, *swept, algorithm=method.algorithm, scaling=method.scaling)
    fade = _fade(weight, method.forgetting) if recursive else np.ones_like(weight)
    parts = _figures(*data, jnp.asarray(fade), fit)
    value = _regression(labels, target, weight, fade, fit, parts, method)
    status, detail = _status(value, int(np.sum(weight > 0)))
    stats = {"rank": value.rank, "cond": value.condition}
    return Solution(value, status, stats, detail)


def _fade(weight: Float[np.ndarray, " time"], forgetting: float) -> np.ndarray:
    """The weight that forgetting leaves of each sample at the end."""
    used = weight > 0
    later = np.sum(used) - np.cumsum(used)
    return (float(forgetting) ** later).astype(weight.dtype)


def _regression(
    names, y, weight, fade, fit: LeastSquaresFit, parts, method
) -> Regression:
    residual, hat, spread = (np.asarray(part) for part in parts)
    root, used = np.asarray(fit.root), weight > 0
    plain = method.ridge == 0.0 and bool(np.all(fade == 1.0))
    # To rounding the factor is one then, and the rounding is better left out.
    covariance = root @ root.T if plain else root @ spread @ root.T
    spent = float(fit.rank) if plain else float(np.trace(spread))
    degrees = float(np.sum(fade[used])) - spent
    enough = degrees > 1e-9 * len(y)
    total = weight * fade
    variance = float(total @ residual**2) / degrees if enough else np.nan
    sigma = float(np.sqrt(variance))
    studentised, cook = _influence(residual, weight, hat, sigma, degrees, np.sum(hat))
    return Regression(
        names=names,
        coefficient=np.asarray(fit.coefficient),
        covariance=variance * covariance,
        rank=int(fit.rank),
        condition=float(fit.condition),
        degrees=degrees,
        sigma=sigma,
        r2=_r2(y, residual, total),
        residual=residual,
        leverage=hat,
        studentised=studentised,
        cook=cook,
        method=method,
    )


def _influence(residual, weight, hat, sigma, degrees, terms):
    """Externally studentised residuals and Cook's distances."""
    spare = 1.0 - hat
    # Below, rounding decides; such a sample determines a coefficient alone.
    spare = np.where(spare > np.sqrt(np.finfo(hat.dtype).eps), spare, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        inside = residual * np.sqrt(weight) / (sigma * np.sqrt(spare))
        left = (degrees - inside**2) / (degrees - 1.0)
        outside = inside / np.sqrt(np.where(left > 0, left, np.nan))
        cook = inside**2 * hat / (spare * terms)
    return outside, cook


def _r2(y, residual, total) -> float:
    whole = np.sum(total)
    mean = total @ y / whole if whole > 0 else 0.0
    spread = float(total @ (y - mean) ** 2)
    return 1.0 - float(total @ residual**2) / spread if spread > 0 else float("nan")


def _status(value: Regression, samples: int) -> tuple[RESULTS, str]:
    """The status by rank, condition and number of samples."""
    terms = len(value.names)
    if not np.all(np.isfinite(value.coefficient)):
        return RESULTS.unidentifiable, (
            f"forgetting={value.method.forgetting:g} has left nothing to tell some "
            "coefficients from; use a larger one, or leave collinear columns out"
        )
    if samples < terms:
        return RESULTS.too_short, (
            f"{samples} samples for {terms} coefficients: these are the ones of "
            "minimum norm, and they have no standard errors; give more samples or "
            "fewer columns"
        )
    if value.rank < terms:
        return RESULTS.ok, (
            f"the columns have rank {value.rank} of {terms}: the coefficients are "
            "those of minimum norm, and their standard errors leave out the "
            "directions that the data do not tell"
        )
    if value.condition > 1.0 / np.sqrt(np.finfo(value.residual.dtype).eps):
        return RESULTS.ok, (
            f"the scaled columns have condition {value.condition:.1e}: nearly "
            "collinear, half of the digits or more are lost"
        )
    return RESULTS.ok, ""
