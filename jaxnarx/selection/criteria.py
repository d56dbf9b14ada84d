"""Criteria of every nested size of a selection, all from one search."""

import numpy as np
from jaxtyping import Float

GREATER_IS_BETTER = ("r2", "adjusted_r2", "overall_f")


def criteria(
    sse: Float[np.ndarray, " sizes"],
    samples: int,
    *,
    total: float | None = None,
    press: Float[np.ndarray, " sizes"] | None = None,
    variance: float | None = None,
) -> dict[str, Float[np.ndarray, " sizes"]]:
    """Criteria of models with 1, 2, ... terms from their sums of squared errors.

    With N samples and n terms: AIC = N ln(SSE/N) + 2 n, AICc = AIC + 2 n (n + 1) /
    (N - n - 1), BIC (Rissanen's MDL) = N ln(SSE/N) + n ln N, FPE (5.35) = N ln(SSE/N) +
    N ln((N + n) / (N - n)), Cp (5.33, 5.34) = SSE/s^2 - N + 2 n with s^2 = `variance`,
    that of the residuals of the largest candidate model; without it the largest of
    these sizes stands in, and Cp = n there. Sizes for which N is too small give `inf`;
    a perfect fit -inf is cut at the smallest positive number's logarithm.

    With `total`, the sum of squares about the mean, also R2 = 1 - SSE/total (4.44), its
    adjusted form 1 - (SSE/(N - n)) / (total/(N - 1)), and the overall F (5.9) =
    ((total - SSE)/(n - 1)) / (SSE/(N - n)), where one of the n terms is the constant;
    `press` is passed on.
    """
    n = np.arange(1, len(sse) + 1)
    tiny = np.finfo(sse.dtype).tiny
    positive = np.maximum(sse, tiny)
    fit = samples * np.log(positive / samples)
    spare = samples - n
    with np.errstate(divide="ignore", invalid="ignore"):
        aic = fit + 2 * n
        correction = np.where(spare > 1, 2 * n * (n + 1) / (spare - 1), np.inf)
        fpe = fit + samples * np.log(np.where(spare > 0, (samples + n) / spare, np.inf))
        if variance is None:
            variance = sse[-1] / max(samples - len(sse), 1)
        cp = sse / max(variance, tiny) - samples + 2 * n
    table = {
        "aic": aic,
        "aicc": aic + correction,
        "bic": fit + n * np.log(samples),
        "fpe": fpe,
        "cp": cp,
    }
    if press is not None:
        table["press"] = press
    if total is not None:
        table |= _explained(positive, n, samples, max(total, tiny))
    return table


def _explained(sse, n, samples: int, total: float) -> dict:
    spare = np.maximum(samples - n, 1)
    gained = np.maximum(total - sse, 0.0) / np.maximum(n - 1, 1)
    with np.errstate(over="ignore"):
        overall = np.where(n > 1, gained / (sse / spare), 0.0)
    return {
        "r2": 1.0 - sse / total,
        "adjusted_r2": 1.0 - (sse / spare) / (total / max(samples - 1, 1)),
        "overall_f": np.minimum(overall, np.finfo(sse.dtype).max),
    }
