"""Normal equations of least squares: their matrix, and their solution with a ridge."""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Arrays = TypeVar("Arrays", np.ndarray, Array)

PANEL_COLUMNS, PANEL_COUNT = 150, 3
"""Columns from which the products above the diagonal alone are formed, in so many
panels: on a CPU four fifths of the time at 512 columns. Narrower ones lose as much by
narrower products."""

LEAST_RIDGE = 1e-12, 10
"""Least ridge in float64, and in a coarser type so many times its precision."""


def gram(a: Float[Array, "rows columns"]) -> Float[Array, "columns columns"]:
    """A'A."""
    columns = a.shape[1]
    if columns < PANEL_COLUMNS:
        return a.T @ a
    ends = [round(columns * n / PANEL_COUNT) for n in range(PANEL_COUNT + 1)]
    upper = jnp.concatenate(
        [
            jnp.pad(a[:, start:stop].T @ a[:, start:], ((0, 0), (start, 0)))
            for start, stop in zip(ends, ends[1:], strict=False)
        ]
    )
    return jnp.triu(upper) + jnp.triu(upper, 1).T


def ridge_solve(
    gram: Float[Arrays, "terms terms"],
    moment: Float[Arrays, "terms *columns"],
    ridge: Float[Arrays, "*terms"] | float = 0.0,
    *,
    least: float | None = None,
) -> Float[Arrays, "terms *columns"]:
    """Solve symmetric positive normal equations, scaled to a unit diagonal.

    `ridge`, one for all or one for each term, is added to that diagonal, and `least` at
    least: by default what keeps collinear terms finite in the type of the numbers. Zero
    rows (padding) give zero. NumPy in, NumPy out; in programs Cholesky's factorisation,
    for many small problems on the same long columns, where a factorisation of each
    would cost the whole run.
    """
    xp = np if isinstance(gram, np.ndarray) else jnp
    if least is None:
        exact = gram.dtype == np.float64
        least = (
            LEAST_RIDGE[0]
            if exact
            else LEAST_RIDGE[1] * float(xp.finfo(gram.dtype).eps)
        )
    diagonal = xp.diagonal(gram)
    alive = diagonal > 0
    scale = xp.where(alive, xp.sqrt(xp.where(alive, diagonal, 1.0)), 1.0)
    system = gram / (scale[:, None] * scale[None])
    system = system + xp.diag(xp.where(alive, xp.maximum(ridge, least), 1.0))
    unit = scale if moment.ndim == 1 else scale[:, None]
    if isinstance(gram, np.ndarray):
        return np.linalg.solve(system, moment / unit) / unit
    factor = jax.scipy.linalg.cho_factor(system, lower=True)
    return jax.scipy.linalg.cho_solve(factor, moment / unit) / unit
