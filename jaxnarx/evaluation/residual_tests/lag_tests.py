"""Correlations of a residual with something else at lags, with bounds that hold.

Every test has the form T_k = sum_t z_t eta_t, with an instrument z known before sample
t (a residual, an input or a square k samples ago) and eta the residual or a product of
it. If the model is right and its noise independent with one variance, the variance of
T_k follows from the instruments as they are; see `linear_test` and `product_test`.
"""

import dataclasses

import numpy as np
import scipy.linalg
import scipy.special
from jaxtyping import Bool, Float, Int

from jaxnarx.evaluation.residual_tests.bounds import (
    NORMAL_SCORE_GRID,
    bent_quantile,
    correlation_quantile,
    correlation_score,
    joint_p,
    joint_score,
)
from jaxnarx.evaluation.residual_tests.lagged import lagged_products, lagged_rows
from jaxnarx.evaluation.residual_tests.residual import Residual

FIXED_SQUARE_SHARE = 1e-6
"""Instruments of which the fit leaves less than this share of their square have a
correlation of zero by construction, and nothing to test."""


@dataclasses.dataclass(frozen=True, eq=False)
class LagTest:
    """A correlation at every lag, its bounds, and how likely the largest one is.

    `low` and `high` hold a right model's correlation at each single lag with
    probability 1 - level, `joint_low` and `joint_high` at all lags of `tested`
    together; both are asymmetric where the products are skewed. `tested` leaves out
    lags whose correlation the fit has made zero, and those that `shown_only` says. `p`
    belongs to the joint statement, `covariance` to the values.
    """

    name: str
    signal: str
    lags: Int[np.ndarray, " lags"]
    value: Float[np.ndarray, " lags"]
    low: Float[np.ndarray, " lags"]
    high: Float[np.ndarray, " lags"]
    joint_low: Float[np.ndarray, " lags"]
    joint_high: Float[np.ndarray, " lags"]
    tested: Bool[np.ndarray, " lags"]
    p: float
    covariance: Float[np.ndarray, "lags lags"]

    @property
    def outside(self) -> Int[np.ndarray, " found"]:
        """Lags of `tested` at which the joint band is left."""
        out = (self.value < self.joint_low) | (self.value > self.joint_high)
        return self.lags[out & self.tested]

    @property
    def effect(self) -> float:
        """Share of the variance that the strongest tested lag alone explains."""
        return float(np.max(self.value[self.tested] ** 2, initial=0.0))

    @property
    def together(self) -> float:
        """Share of the variance that the tested lags of an autocorrelation explain.

        r'R^-1 r of Yule and Walker's equations; lags that are not tested count as zero.
        """
        r = np.eye(1, self.lags.max(initial=0) + 1)[0]
        r[self.lags] = np.where(self.tested, self.value, 0.0)
        weights, *_ = np.linalg.lstsq(scipy.linalg.toeplitz(r[:-1]), r[1:])
        return float(np.clip(r[1:] @ weights, 0.0, 1.0))

    @property
    def worst(self) -> int:
        """The lag furthest out by its own bounds; 0 where none is tested."""
        edge = np.where(self.value < 0, -self.low, self.high)
        far = np.abs(self.value) / np.where(edge > 0, edge, 1.0)
        far = np.where(self.tested, far, 0.0)
        return int(self.lags[np.argmax(far)]) if self.tested.any() else 0


def linear_test(
    residual: Residual,
    earlier: Float[np.ndarray, "records time"],
    lags: Int[np.ndarray, " lags"],
    *,
    name: str,
    signal: str = "",
    level: float = 0.05,
    shown_only: Bool[np.ndarray, " lags"] | None = None,
    itself: bool = False,
) -> LagTest:
    """Correlation of the residual with `earlier[t - k]`.

    T_k = z'(residual) = w'e with w what the fit leaves of z, so that var T_k = s^2
    |w_k|^2 and cov(T_j, T_k) = s^2 w_j'w_k. T_k/(|w_k| |residual|) is a partial
    correlation, Beta distributed for normal noise and a z that is given; other noise
    bends its quantiles by its skewness g and excess h through those of w, g_w g/sqrt(N)
    and h_w h/N (Pitman 1937).

    `earlier` has no mean and is zero where it is not known. Where it is the residual
    `itself`, |w| and |residual| grow together, and for N samples of raw white noise var
    r_k is (N - k)/(N (N + 2)) instead of (N - k)/N^2.
    """
    total = lagged_products(earlier, residual.value, lags)
    norm = np.sqrt(np.sum(earlier[residual.known] ** 2) * residual.squares)
    z = lagged_rows(earlier * 1.0, residual.at, lags)
    w = residual.remove_fit_and_mean(z)
    gram = w.T @ w * residual.share
    skewness, excess = moments(w)
    g, h = moments(residual.value[residual.known][:, None])
    samples = residual.samples
    return _lag_test(
        value=total / (norm or 1.0),
        deviation=np.sqrt(np.diagonal(gram) * residual.squares) / (norm or 1.0),
        covariance=gram,
        skewness=skewness * g / np.sqrt(samples),
        excess=excess * h / samples,
        freedom=max(residual.freedom + (1 if itself else -1), 1.0),
        fixed=np.sum(w**2, axis=0) <= FIXED_SQUARE_SHARE * np.sum(z**2, axis=0),
        shown_only=shown_only,
        lags=lags,
        name=name,
        signal=signal,
        level=level,
    )


def product_test(
    residual: Residual,
    output: Float[np.ndarray, "records time"],
    earlier: Float[np.ndarray, "records time"],
    lags: Int[np.ndarray, " lags"],
    *,
    name: str,
    signal: str = "",
    level: float = 0.05,
) -> LagTest:
    """Correlation of output times residual with `earlier[t - k]`.

    With y = f + e, f known before the sample, y e = f e + e^2, and estimating the
    coefficients takes from z f what the regressors explain:

        T_k = sum_t z_t (y e)_t = sum_t z_t (e_t^2 - s^2) + sum_t q_t e_t,
        q = what the fit leaves of z f.

    Given the past a summand has variance z^2 m40 + 2 z q m12 + q^2 s^2, with m the
    moments of e; 1/N for the squared correlation would hold only if f and z were
    independent. Third and fourth cumulants bend the quantiles likewise.

    `output` and `earlier` have no mean and are zero where they are not known.
    """
    product = np.where(residual.known, output * residual.value, 0.0)
    product = np.where(residual.known, product - product[residual.known].mean(), 0.0)
    total = lagged_products(earlier, product, lags)
    norm = np.sqrt(np.sum(earlier[residual.known] ** 2) * np.sum(product**2)) or 1.0
    z = lagged_rows(earlier, residual.at, lags)
    z = z - z.mean(axis=0)[None]
    f = (output - residual.value).reshape(-1)[residual.at]
    q = residual.remove_fit_and_mean(z * f[:, None])
    e = residual.value.reshape(-1)[residual.at]
    m = _noise_moments(e * np.sqrt(residual.samples / residual.freedom))
    share = residual.samples / len(residual.at)
    cross = z.T @ q
    covariance = m[2, 0] * z.T @ z + m[1, 1] * (cross + cross.T) + m[0, 2] * q.T @ q
    variance = np.diagonal(covariance)
    safe = np.where(variance > 0, variance, 1.0)
    third = _sums(z, q, 3, m)
    each = m[2, 0] * z**2 + 2 * m[1, 1] * z * q + m[0, 2] * q**2
    fourth = _sums(z, q, 4, m) - 3 * np.sum(each**2, axis=0)
    return _lag_test(
        value=total / norm,
        deviation=np.sqrt(variance * share) / norm * np.sqrt(residual.samples),
        covariance=covariance,
        skewness=third / safe**1.5 / np.sqrt(share),
        excess=fourth / safe**2 / share,
        freedom=float(residual.samples),
        fixed=variance <= 0,
        shown_only=None,
        lags=lags,
        name=name,
        signal=signal,
        level=level,
    )


def moments(
    x: Float[np.ndarray, "rows columns"],
) -> tuple[Float[np.ndarray, " columns"], Float[np.ndarray, " columns"]]:
    """Skewness and excess kurtosis about zero of every column; zero for zeros."""
    square = x * x
    scale = square.mean(axis=0)
    safe = np.where(scale > 0, scale, 1.0)
    third = np.einsum("nk,nk->k", square, x) / len(x) / safe**1.5
    fourth = np.einsum("nk,nk->k", square, square) / len(x) / safe**2
    return third, np.where(scale > 0, fourth - 3.0, 0.0)


def _noise_moments(e: Float[np.ndarray, " rows"]) -> Float[np.ndarray, "5 5"]:
    """E square^a e^b with square = e^2 - E e^2, for a and b from 0 to 4."""
    powers = np.vander(e, 5, increasing=True)
    square = np.vander(e**2 - np.mean(e**2), 5, increasing=True)
    return square.T @ powers / len(e)


def _sums(
    z: Float[np.ndarray, "rows lags"],
    q: Float[np.ndarray, "rows lags"],
    power: int,
    m: Float[np.ndarray, "5 5"],
) -> Float[np.ndarray, " lags"]:
    """sum_t E (z square + q e)^power, by the binomial theorem."""
    up, down = [np.ones_like(z)], [np.ones_like(q)]
    for _ in range(power):
        up.append(up[-1] * z)
        down.append(down[-1] * q)
    count = [scipy.special.comb(power, a, exact=True) for a in range(power + 1)]
    return sum(
        (
            count[a] * m[a, power - a] * np.einsum("tl,tl->l", up[a], down[power - a])
            for a in range(power + 1)
        ),
        start=np.zeros(z.shape[1]),
    )


def _lag_test(
    *,
    value: Float[np.ndarray, " lags"],
    deviation: Float[np.ndarray, " lags"],
    covariance: Float[np.ndarray, "lags lags"],
    skewness: Float[np.ndarray, " lags"],
    excess: Float[np.ndarray, " lags"],
    freedom: float,
    fixed: Bool[np.ndarray, " lags"],
    shown_only: Bool[np.ndarray, " lags"] | None,
    lags: Int[np.ndarray, " lags"],
    name: str,
    signal: str,
    level: float,
) -> LagTest:
    """Bounds and the joint statement from moments.

    `deviation` times a partial correlation with `freedom` is a value.
    """
    tested = ~fixed if shown_only is None else ~fixed & ~shown_only
    deviation = np.where(fixed, 0.0, deviation)
    spread = np.sqrt(np.diagonal(covariance))
    spread = np.where(spread > 0, spread, 1.0)
    correlation = covariance / np.outer(spread, spread)
    critical = joint_score(correlation[np.ix_(tested, tested)], level)
    one = float(scipy.special.ndtri(1 - level / 2))
    ends = np.array([-one, one, -critical, critical])
    bent = bent_quantile(NORMAL_SCORE_GRID, skewness, excess)
    edges = np.array([np.interp(ends, NORMAL_SCORE_GRID, row) for row in bent])
    edges = correlation_quantile(edges, freedom) * deviation[:, None]
    plain = correlation_score(
        value / np.where(deviation > 0, deviation, np.inf), freedom
    )
    scores = [
        np.interp(x, row, NORMAL_SCORE_GRID) for x, row in zip(plain, bent, strict=True)
    ]
    largest = float(np.max(np.abs(np.array(scores)[tested]), initial=0.0))
    return LagTest(
        name=name,
        signal=signal,
        lags=lags,
        value=value,
        low=edges[:, 0],
        high=edges[:, 1],
        joint_low=edges[:, 2],
        joint_high=edges[:, 3],
        tested=tested,
        p=joint_p(largest, critical, level) if tested.any() else 1.0,
        covariance=correlation * np.outer(deviation, deviation) / (freedom + 1),
    )
