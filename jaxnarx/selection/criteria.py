"""Information criteria along a path of nested models."""

import numpy as np
from jaxtyping import Float


def criteria(
    sse: Float[np.ndarray, " sizes"], samples: int
) -> dict[str, Float[np.ndarray, " sizes"]]:
    """Criteria of models with 1, 2, ... terms from their sums of squared errors.

    With N samples and n terms: AIC = N ln(SSE/N) + 2 n, AICc = AIC + 2 n (n + 1) /
    (N - n - 1), BIC = N ln(SSE/N) + n ln N, FPE (5.35) = N ln(SSE/N) + N ln((N + n) /
    (N - n)), Cp (5.33, 5.34) = SSE/s^2 - N + 2 n with s^2 = SSE/(N - n) of the largest
    model. Sizes for which N is too small give `inf`; a perfect fit -inf is cut at the
    smallest positive number's logarithm.
    """
    n = np.arange(1, len(sse) + 1)
    tiny = np.finfo(sse.dtype).tiny
    fit = samples * np.log(np.maximum(sse, tiny) / samples)
    spare = samples - n
    with np.errstate(divide="ignore", invalid="ignore"):
        aic = fit + 2 * n
        correction = np.where(spare > 1, 2 * n * (n + 1) / (spare - 1), np.inf)
        fpe = fit + samples * np.log(np.where(spare > 0, (samples + n) / spare, np.inf))
        variance = max(sse[-1], tiny) / max(samples - len(sse), 1)
        cp = sse / variance - samples + 2 * n
    return {
        "aic": aic,
        "aicc": aic + correction,
        "bic": fit + n * np.log(samples),
        "fpe": fpe,
        "cp": cp,
    }
