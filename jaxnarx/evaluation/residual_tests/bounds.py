"""Quantiles of a statistic that is nearly normal, alone and as one of several."""

import functools

import numpy as np
import scipy.special
from jaxtyping import Float

QUANTILE_POINTS = 2**12
"""Points of the normal distribution at which the largest of several is looked up: the
joint level is met to about 0.002."""
TAME_SKEWNESS = 0.5
"""Skewness at which the short tail of a distribution is no longer shortened."""
SMALLEST_PROBABILITY = 1e-150
"""Probabilities below are taken for this one: near 1e-290 scipy's quantile of Student's
distribution has the wrong sign (1.17), and squares overflow."""
NORMAL_SCORE_GRID = np.linspace(-12.0, 12.0, 241)
"""Normal scores between which others are interpolated; the last stands for the rest."""


def correlation_quantile(
    z: Float[np.ndarray, "*size"], freedom: float
) -> Float[np.ndarray, "*size"]:
    """The partial correlation that corresponds to the normal score z.

    The square of a sample correlation with a fixed vector is Beta(1/2, freedom/2): it
    is t/sqrt(freedom + t^2) with t of Student's distribution. Its variance is
    1/(freedom + 1), that of raw white noise at lag k thus (N - k)/(N (N + 2)).
    """
    tail = np.maximum(scipy.special.ndtr(-np.abs(z)), SMALLEST_PROBABILITY)
    t = -scipy.special.stdtrit(freedom, tail)
    return np.sign(z) * t / np.sqrt(freedom + t**2)


def correlation_score(
    correlation: Float[np.ndarray, "*size"], freedom: float
) -> Float[np.ndarray, "*size"]:
    """The normal score of a partial correlation: inverse of `correlation_quantile`."""
    r = np.clip(np.abs(correlation), 0.0, 1 - 1e-15)
    t = r * np.sqrt(freedom / (1 - r**2))
    tail = np.maximum(scipy.special.stdtr(freedom, -t), SMALLEST_PROBABILITY)
    return -np.sign(correlation) * scipy.special.ndtri(tail)


def bent_quantile(
    z: Float[np.ndarray, " points"],
    skewness: Float[np.ndarray, " lags"],
    excess: Float[np.ndarray, " lags"],
) -> Float[np.ndarray, "lags points"]:
    """Quantiles of standardised variables from those of the normal one.

    A shifted lognormal variable of skewness g, which rises with z however skewed it is:

        x = (exp(s z' - s^2/2) - 1)/sqrt(w - 1),  w = exp(s^2),  (w - 1)(w + 2)^2 = g^2

    The excess kurtosis that it lacks, h, goes into z' = z + h (z^3 - 3 z)/24 by Cornish
    and Fisher 1937. To first order in g and h both give the same; the g^2 of their
    expansion makes it fall where the skewness is above about 0.7. The short tail is
    never shorter than at a skewness of 0.5: it has an end there, and moments of wild
    noise do not tell where. `z` rises and is symmetric about zero.
    """
    g = np.abs(skewness)[:, None]
    bent = _lognormal(z, g, excess[:, None])
    tame = _lognormal(z, np.minimum(g, TAME_SKEWNESS), excess[:, None])
    bent = np.where(z[None] < 0, np.minimum(bent, tame), bent)
    return np.where(skewness[:, None] < 0, -bent[:, ::-1], bent)


def _lognormal(
    z: Float[np.ndarray, " points"],
    g: Float[np.ndarray, "lags 1"],
    excess: Float[np.ndarray, "lags 1"],
) -> Float[np.ndarray, "lags points"]:
    """`bent_quantile` of a skewness g that is not negative."""
    root = np.cbrt(1 + 0.5 * g**2 + g * np.sqrt(1 + 0.25 * g**2))
    w = root + 1 / root - 1
    h = np.clip(excess - (w**4 + 2 * w**3 + 3 * w**2 - 6), -1.0, 3.0)
    x = z[None] + h * (z**3 - 3 * z)[None] / 24
    # For negative h it falls far out: held there.
    middle = z.size // 2
    up = np.maximum.accumulate(x[:, middle:], axis=1)
    down = np.minimum.accumulate(x[:, middle::-1], axis=1)[:, ::-1]
    x = np.concatenate([down[:, :-1], up], axis=1)
    small = g < 1e-4
    s = np.where(small, 1.0, np.sqrt(np.log(w)))
    bent = np.expm1(np.minimum(s * x - 0.5 * s**2, 300.0))
    return np.where(small, x, bent / np.sqrt(np.where(small, 1.0, w - 1)))


@functools.lru_cache(maxsize=16)
def _normal_points(dims: int) -> Float[np.ndarray, "dims points"]:
    """Evenly spread points of the standard normal distribution, always the same: a
    Latin hypercube (McKay, Beckman and Conover 1979)."""
    rng = np.random.default_rng(1)
    strata = np.tile(np.arange(QUANTILE_POINTS), (dims, 1))
    share = rng.permuted(strata, axis=1) + rng.random(strata.shape)
    share = np.clip(share / QUANTILE_POINTS, 1e-12, 1 - 1e-12)
    return np.asarray(scipy.special.ndtri(share))


def joint_score(correlation: Float[np.ndarray, "lags lags"], level: float) -> float:
    """c with P(max |Z_k| > c) = level for normal Z of this correlation.

    The band of that many standard deviations holds all lags together with probability
    1 - level. Without lags it is the score of one.
    """
    lags = len(correlation)
    if lags < 2:
        return float(-scipy.special.ndtri(level / 2))
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[None]
    points = root @ _normal_points(lags)
    largest = np.maximum(points.max(axis=0), -points.min(axis=0))
    return float(np.quantile(largest, 1 - level))


def joint_p(score: float, critical: float, level: float) -> float:
    """P(max |Z_k| > score), from the one point where it is known.

    It is that of m independent lags, 1 - (1 - 2 Phi(-c))^m, with m such that the
    critical score has its level. Exact there and for independent lags (Sidak 1967).
    """
    one = 2 * scipy.special.ndtr(-critical)
    tail = 2 * scipy.special.ndtr(-score)
    number = np.log1p(-level) / np.log1p(-one)
    return float(-np.expm1(number * np.log1p(-min(tail, 1 - 1e-12))))
