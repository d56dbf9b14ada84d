"""Information criteria: fit and number of parameters weighed against each other."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

Numbers = Float[np.ndarray | Array, " models"]


def information(
    sse: Numbers,
    parameters: Numbers | Int[np.ndarray | Array, " models"],
    samples: float | int | Float[Array, ""],
    *,
    least: float | int | None = None,
) -> dict[str, Any]:
    """`aic`, `aicc`, `bic` and `fpe` of models with n parameters on N samples.

    With fit = N ln(SSE/N): AIC = fit + 2 n (Akaike 1974), AICc = AIC + 2 n (n + 1) /
    (N - n - 1) (Hurvich and Tsai 1989), BIC = fit + n ln N (Schwarz 1978; Rissanen's
    MDL), FPE = fit + N ln((N + n)/(N - n)) (thesis 5.35). n may be an effective number.
    A sum of squares below `least` counts as that (default: the smallest positive
    number). Where N is too small for a correction it is infinite.
    Arrays of numpy give those, arrays of jax theirs.
    """
    xp: Any = jnp if isinstance(sse, jax.Array) else np
    n, sse = xp.asarray(parameters), xp.asarray(sse)
    least = float(np.finfo(sse.dtype).tiny) if least is None else least
    fit = samples * xp.log(xp.maximum(sse, least) / samples)
    spare = samples - n
    with np.errstate(divide="ignore", invalid="ignore"):
        more = xp.where(spare > 1, 2 * n * (n + 1) / (spare - 1), np.inf)
        odds = xp.where(spare > 0, (samples + n) / spare, np.inf)
    return {
        "aic": fit + 2 * n,
        "aicc": fit + 2 * n + more,
        "bic": fit + n * xp.log(samples),
        "fpe": fit + samples * xp.log(odds),
    }
