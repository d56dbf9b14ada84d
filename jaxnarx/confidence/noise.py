"""The noise behind the residuals of a free run: its size and its colour."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


class OutputNoise(NamedTuple):
    """Stationary noise of every output, in scaled signals.

    An autoregression, e(t) = sum_k shape[o, k] e(t - 1 - k) + white noise of variance
    `innovation[o]`; `covariance[o, k]` is E e(t) e(t - k), k below the model's depth.
    White noise has no columns in `shape`. `samples` counts what it was estimated from,
    `freedom` is that less the parameters.
    """

    shape: Float[np.ndarray, "outputs order"]
    innovation: Float[np.ndarray, " outputs"]
    covariance: Float[np.ndarray, "outputs depth"]
    samples: Int[np.ndarray, " outputs"]
    freedom: Float[np.ndarray, " outputs"]

    def less(self, parameters: Float[np.ndarray, " outputs"]) -> "OutputNoise":
        """The noise when so many parameters of each output were estimated from the same
        samples.

        Variances become sums of squares over max(n - p, 1).
        """
        freedom = np.maximum(self.samples - parameters, 1.0)
        grown = self.freedom / freedom
        return self._replace(
            innovation=self.innovation * grown,
            covariance=self.covariance * grown[:, None],
            freedom=freedom,
        )


def autocovariance(
    residual: Float[np.ndarray, "records time"],
    scored: Bool[np.ndarray, "records time"],
    lags: int,
) -> Float[np.ndarray, " lags"]:
    """c(k) = sum_t e(t) e(t + k) / n for k below `lags`, within records.

    Residuals that are not scored count as zero. The sum over all n scored samples, not
    over the n - k pairs, keeps the sequence positive semidefinite.
    """
    e = np.where(scored, residual, 0.0)
    time = e.shape[1]
    sums = [np.vdot(e[:, k:], e[:, : time - k]) for k in range(min(lags, time))]
    found = np.zeros(lags, e.dtype)
    found[: len(sums)] = sums
    return found / max(int(scored.sum()), 1)


def autoregression(
    c: Float[np.ndarray, " lags"], count: int
) -> tuple[Float[np.ndarray, " order"], float]:
    """Coefficients and innovation variance of the autoregression of lowest AIC.

    Yule-Walker by Levinson's recursion: always stable. AIC = n log v_p + 2 p over the
    orders p the lags allow. No residuals at all give order zero.

    Reference: P. Brockwell and R. Davis, Time Series: Theory and Methods, Springer
    1991, sections 8.1, 8.2 and 9.3.
    """
    if c[0] <= 0:
        return np.zeros(0), 0.0
    a, v = np.zeros(0), float(c[0])
    best, least = (a, v), count * math.log(v)
    for p in range(1, len(c)):
        reflection = (c[p] - a @ c[p - 1 : 0 : -1]) / v
        a = np.concatenate([a - reflection * a[::-1], [reflection]])
        v *= 1 - reflection**2
        if v <= 1e-12 * c[0]:
            break
        score = count * math.log(v) + 2 * p
        if score < least:
            best, least = (a, v), score
    return best


def longest_order(count: int) -> int:
    """Largest order tried: 10 log10 n, and no more than a tenth of the samples."""
    return int(min(10 * math.log10(max(count, 1)), count / 10))


def estimate_noise(
    residual: Float[np.ndarray, "records time outputs"],
    scored: Bool[np.ndarray, "records time outputs"],
    *,
    coloured: bool,
    depth: int,
) -> OutputNoise:
    """Noise of every output from its residuals, mean squares over all samples.

    With `coloured` an autoregression of each output's residuals is fitted, see
    `autoregression`; outputs are taken as independent of one another.
    """
    count = scored.sum(axis=(0, 1))
    fits, covariance = [], []
    for o, n in enumerate(count.tolist()):
        order = longest_order(n) if coloured else 0
        c = autocovariance(residual[..., o], scored[..., o], max(order + 1, depth))
        fits.append(autoregression(c[: order + 1], n))
        covariance.append(c[:depth] if coloured else c[:depth] * (np.arange(depth) < 1))
    order = max(len(a) for a, _ in fits)
    shape = np.stack([np.pad(a, (0, order - len(a))) for a, _ in fits])
    innovation = np.array([v for _, v in fits])
    freedom = np.maximum(count, 1).astype(innovation.dtype)
    return OutputNoise(shape, innovation, np.stack(covariance), count, freedom)
