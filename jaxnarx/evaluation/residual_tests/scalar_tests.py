"""Tests of a residual with one number each: Ljung-Box, runs, normality, mean."""

import dataclasses

import numpy as np
import scipy.special
from jaxtyping import Float

from jaxnarx.evaluation.residual_tests.lag_tests import LagTest
from jaxnarx.evaluation.residual_tests.lagged import lagged_products, lagged_rows
from jaxnarx.evaluation.residual_tests.residual import Residual

FEWEST_MOMENT_SAMPLES = 20
"""Samples below which the moments of the normality test are not to be trusted."""


@dataclasses.dataclass(frozen=True)
class ScalarTest:
    """A statistic and the probability of one as extreme if the model is right.

    `freedom` are its degrees of freedom where it has some, `remark` says what it means.
    """

    name: str
    statistic: float
    freedom: float | None
    p: float
    remark: str


def ljung_box(residual: Residual, test: LagTest) -> ScalarTest:
    """Q = N (N + 2) sum_k r_k^2/N_k over the lags of the autocorrelation `test`.

    N_k counts the pairs at lag k: N - k of one record without gaps. With the covariance
    V of r the distribution is that of sum_i lambda_i chi2(1), lambda the eigenvalues of
    V weighted likewise; it is taken for a chi2(b) with both moments right, a = sum
    lambda^2/sum lambda, b = (sum lambda)^2/sum lambda^2 (Satterthwaite 1946). For an
    autoregression of order p that is nearly the K - p of Ljung and Box 1978; for other
    models nobody has to count.
    """
    known = residual.known.astype(float)
    pairs = np.maximum(np.round(lagged_products(known, known, test.lags)), 1.0)
    n = residual.samples
    weight = np.sqrt(n * (n + 2) / pairs)
    statistic = float(np.sum((weight * test.value) ** 2))
    spread = weight[:, None] * test.covariance * weight[None]
    own = np.maximum(np.linalg.eigvalsh(spread), 0.0)
    total, square = float(own.sum()), float(np.sum(own**2))
    if total <= 0:
        return ScalarTest("Ljung-Box", statistic, None, 1.0, "no lag to test")
    freedom = total**2 / square
    p = scipy.special.chdtrc(freedom, statistic * total / square)
    return ScalarTest("Ljung-Box", statistic, freedom, float(p), "autocorrelation")


def runs_test(residual: Residual) -> ScalarTest:
    """Number of runs of equal sign against its expectation; the score is normal.

    In a stretch without gaps with a positive and b negative residuals the number of
    runs has mean 1 + 2ab/n and variance 2ab(2ab - n)/(n^2 (n - 1)), n = a + b (Wald and
    Wolfowitz 1940); stretches add up. Estimation makes neighbouring signs less alike:
    of the variance the share (2/pi) R^2 is gone, where R^2 is what the fit explains of
    the sign before (exact to first order for normal noise).
    """
    sign = np.where(residual.known, np.where(residual.value > 0, 1.0, -1.0), 0.0)
    runs = expected = variance = 0.0
    for a, b, changes in _stretches(sign):
        n = a + b
        runs += changes + 1
        expected += 1 + 2 * a * b / n
        if n > 1:
            variance += 2 * a * b * (2 * a * b - n) / (n**2 * (n - 1))
    before = lagged_rows(sign, residual.at, np.array([1]))
    whole = before - before.mean(axis=0)[None] if residual.centred else before
    left = float(
        np.sum(residual.remove_fit_and_mean(before) ** 2)
        / max(np.sum(whole**2), 1e-300)
    )
    variance *= max(1 - 2 / np.pi * (1 - min(left, 1.0)), 0.0)
    score = (runs - expected) / np.sqrt(variance) if variance > 0 else 0.0
    remark = "too few" if score < 0 else "too many"
    p = 2 * scipy.special.ndtr(-abs(score))
    return ScalarTest("runs", float(score), None, float(p), f"{remark} sign changes")


def _stretches(sign: Float[np.ndarray, "records time"]) -> list[tuple[int, int, int]]:
    """(positive, negative, changes) of every stretch of known samples."""
    padded = np.concatenate([sign, np.zeros((len(sign), 1))], axis=1).reshape(-1)
    start = np.flatnonzero((padded != 0) & (np.concatenate([[0], padded[:-1]]) == 0))
    end = np.flatnonzero((padded == 0) & (np.concatenate([[0], padded[:-1]]) != 0))
    changed = np.concatenate([[0], (padded[1:] * padded[:-1]) < 0]).cumsum()
    above = (padded > 0).cumsum()
    found = []
    for s, e in zip(start.tolist(), end.tolist(), strict=True):
        a = int(above[e - 1] - above[s] + (padded[s] > 0))
        found.append((a, e - s - a, int(changed[e - 1] - changed[s])))
    return found


def normality(residual: Residual) -> ScalarTest | None:
    """Skewness and kurtosis together: K^2 of D'Agostino and Pearson 1973.

    Both are brought to normal scores by their finite-sample moments (D'Agostino 1970;
    Anscombe and Glynn 1983). None below 20 samples. With many samples any deviation
    shows: the bounds of the correlations do not need normal noise, see `linear_test`.
    """
    values = residual.value[residual.known]
    if len(values) < FEWEST_MOMENT_SAMPLES:
        return None
    error = values - values.mean()
    error = error / (np.sqrt(np.mean(error**2)) or 1.0)
    g, k = float(np.mean(error**3)), float(np.mean(error**4))
    remark = f"skewness {g:.2f}, excess kurtosis {k - 3:.2f}"
    scores = skewness_score(g, len(values)), kurtosis_score(k, len(values))
    statistic = scores[0] ** 2 + scores[1] ** 2
    p = float(np.exp(-0.5 * statistic))  # chi-squared of two degrees of freedom
    return ScalarTest("normality (K²)", statistic, 2.0, p, remark)


def skewness_score(skewness: float, n: int) -> float:
    """The normal score of the skewness of n normal samples: D'Agostino 1970."""
    y = skewness * np.sqrt((n + 1) * (n + 3) / (6.0 * (n - 2)))
    peak = 3.0 * (n**2 + 27 * n - 70) * (n + 1) * (n + 3)
    peak /= (n - 2.0) * (n + 5) * (n + 7) * (n + 9)
    w = np.sqrt(2 * (peak - 1)) - 1
    return float(np.arcsinh(y / np.sqrt(2 / (w - 1))) / np.sqrt(0.5 * np.log(w)))


def kurtosis_score(kurtosis: float, n: int) -> float:
    """The normal score of the kurtosis of n normal samples, whose mean is near three:
    Anscombe and Glynn 1983."""
    mean = 3.0 * (n - 1) / (n + 1)
    variance = 24.0 * n * (n - 2) * (n - 3) / ((n + 1.0) ** 2 * (n + 3) * (n + 5))
    x = (kurtosis - mean) / np.sqrt(variance)
    bend = 6.0 * (n**2 - 5 * n + 2) / ((n + 7) * (n + 9))
    bend *= np.sqrt(6.0 * (n + 3) * (n + 5) / (n * (n - 2.0) * (n - 3)))
    a = 6 + 8 / bend * (2 / bend + np.sqrt(1 + 4 / bend**2))
    cube = (1 - 2 / a) / (1 + x * np.sqrt(2 / (a - 4)))
    return float((1 - 2 / (9 * a) - np.cbrt(cube)) / np.sqrt(2 / (9 * a)))


def mean_test(residual: Residual) -> ScalarTest | None:
    """Whether the mean is zero: t of Student; None where the fit has made it so."""
    raw = np.ones((len(residual.at), 1))
    left = float(np.sum(residual.fit.remove_fit(raw) ** 2)) / len(raw)
    if left < 1e-6:
        return None
    error = residual.deviation * np.sqrt(left / residual.samples)
    t = residual.mean / error if error > 0 else 0.0
    p = 2 * scipy.special.stdtr(residual.freedom, -abs(t))
    return ScalarTest("mean", float(t), residual.freedom, float(p), "offset")
