"""Factorisations on the host: the triangle of many rows, and directions with rank.

NumPy, for what is decided outside of programs; `arrays.least_squares` is the same for
what is traced.
"""

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

ROWS_AT_ONCE = 16384
"""Rows factorised at once."""


def triangle(
    columns: Float[np.ndarray, "columns rows"],
) -> Float[np.ndarray, "_ columns"]:
    """R of X = Q R, block of rows by block; `columns` is X'.

    Least squares of one column by any others is the same problem in the columns of R,
    which has at most as many rows as there are columns: 10,000 samples become 31.
    """
    width, rows = columns.shape
    blocks = (columns[:, k : k + ROWS_AT_ONCE].T for k in range(0, rows, ROWS_AT_ONCE))
    return accumulate(blocks, width)


def accumulate(
    parts: Iterable[Float[np.ndarray, "_ columns"]], columns: int
) -> Float[np.ndarray, "_ columns"]:
    """R of the rows of all `parts` below one another, which are never held at once.

    Parts with few rows are gathered to blocks.
    """
    r, held, rows = np.zeros((0, columns)), [], 0
    for part in parts:
        held.append(part)
        rows += len(part)
        if rows >= ROWS_AT_ONCE:
            r, held, rows = _upper([r, *held]), [], 0
    return _upper([r, *held]) if held else r


def _upper(parts: list[np.ndarray]) -> np.ndarray:
    return np.asarray(np.linalg.qr(np.concatenate(parts), mode="r"))


@dataclasses.dataclass(frozen=True, eq=False)
class Directions:
    """X = U T for the directions of X that are more than rounding.

    U is the orthonormal `basis`, `inverse` the pseudo-inverse of T: inverse U'y solves
    least squares of y with minimum norm, inverse inverse' is the one of X'X.
    `condition` is the ratio of the largest singular value to the smallest, infinite
    where the rank falls short; `weakest` the combination of columns of the smallest.
    """

    basis: Float[np.ndarray, "rows rank"]
    inverse: Float[np.ndarray, "columns rank"]
    condition: float
    weakest: Float[np.ndarray, " columns"]

    @property
    def rank(self) -> int:
        """Number of directions."""
        return self.basis.shape[1]


def directions(
    columns: Float[np.ndarray, "rows columns"], *, rounding: float | None = None
) -> Directions:
    """Factorise columns of about equal norm; they may depend on one another or be zero.

    Singular values up to `rounding` times the largest are left out: by default what the
    rounding of a factorisation makes of a zero, max(rows, columns) eps.
    """
    rows, count = columns.shape
    small = max(rows, count) * np.finfo(columns.dtype).eps
    tall = rows > 2 * count
    q, r = np.linalg.qr(columns) if tall else (None, columns)
    u, s, vt = np.linalg.svd(r, full_matrices=False)
    cut = small if rounding is None else rounding
    kept = s > cut * s.max(initial=0.0)
    basis = u[:, kept] if q is None else q @ u[:, kept]
    full = kept.sum() == count > 0
    return Directions(
        basis,
        (vt[kept] / s[kept][:, None]).T,
        float(s[0] / s[-1]) if full else np.inf,
        vt[-1] if len(vt) else np.zeros(count),
    )


def quadratic(
    v: Float[np.ndarray, "n n"], x: Float[np.ndarray, " n"], *, least: float
) -> tuple[float, int]:
    """x'V^+ x and the rank of V; eigenvalues up to `least` of the largest count not."""
    values, vectors = np.linalg.eigh(v)
    kept = values > least * max(values.max(initial=0.0), np.finfo(float).tiny)
    parts = (vectors.T @ x)[kept] ** 2 / values[kept]
    return float(parts.sum()), int(kept.sum())
