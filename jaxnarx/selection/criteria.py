"""Criteria of every nested size of a selection, all from one search."""

import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import information

GREATER_IS_BETTER = ("r2", "adjusted_r2", "overall_f")


def criteria(
    sse: Float[np.ndarray, " sizes"],
    samples: int,
    *,
    total: float | None = None,
    press: Float[np.ndarray, " sizes"] | None = None,
    variance: float | None = None,
    gain: float = 1.0,
) -> dict[str, Float[np.ndarray, " sizes"]]:
    """Criteria of models with 1, 2, ... terms from their sums of squared errors.

    With N samples and n terms those of `information`, of errors times `gain`: in the
    output's unit where that undoes its scaling.

    With `variance`, that of the residuals of the largest candidate model, in the units
    of `sse`, also Mallows' Cp (5.33, 5.34) = SSE/s^2 - N + 2 n. The largest size of a
    search does not stand in for that model: Cp = n there, whatever the search has left
    out.

    With `total`, the sum of squares about the mean, also R2 = 1 - SSE/total (4.44), its
    adjusted form 1 - (SSE/(N - n)) / (total/(N - 1)), and the overall F (5.9) =
    ((total - SSE)/(n - 1)) / (SSE/(N - n)), where one of the n terms is the constant;
    `press` is passed on.
    """
    n = np.arange(1, len(sse) + 1)
    tiny = np.finfo(sse.dtype).tiny
    positive = np.maximum(sse, tiny)
    unit = 2 * samples * np.log(gain)  # ln(SSE gain^2), without overflow
    table = {k: x + unit for k, x in information(sse, n, samples).items()}
    if variance is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            table["cp"] = sse / max(variance, tiny) - samples + 2 * n
    if press is not None:
        table["press"] = press
    if total is not None:
        table |= _explained_share(positive, n, samples, max(total, tiny))
    return table


def _explained_share(sse, n, samples: int, total: float) -> dict:
    spare = np.maximum(samples - n, 1)
    gained = np.maximum(total - sse, 0.0) / np.maximum(n - 1, 1)
    with np.errstate(over="ignore"):
        overall = np.where(n > 1, gained / (sse / spare), 0.0)
    return {
        "r2": 1.0 - sse / total,
        "adjusted_r2": 1.0 - (sse / spare) / (total / max(samples - 1, 1)),
        "overall_f": np.minimum(overall, np.finfo(sse.dtype).max),
    }
