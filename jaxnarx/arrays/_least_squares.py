"""Weighted linear least squares: Householder QR, SVD and normal equations.

All minimise, for columns x_k with weights w_n and ridge r,

    sum_n w_n (y_n - sum_k theta_k x_kn)^2 + r sum_k theta_k^2 sum_n w_n x_kn^2 .

The pull of the ridge is a share of each column's own squared norm, so that units do not
matter. The same problem sample by sample is `arrays.recursive_least_squares`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.accurate_product import accurate_product, slices
from jaxnarx.arrays.column_scaling import column_norm, column_scale, power_of_two
from jaxnarx.arrays.normal_equations import ridge_solve


class LeastSquaresFit(eqx.Module):
    """Result of a linear least-squares problem.

    `rank` and `condition` belong to the scaled columns (and the ridge's rows): the
    number of singular values above the cut-off, and the ratio of the largest to the
    smallest, `inf` when rank-deficient. `root` holds the covariance of the coefficients
    per unit of noise variance: root root' is the pseudo-inverse of X'WX plus ridge.
    """

    coefficient: Float[Array, " terms"]
    rank: Int[Array, ""]
    condition: Float[Array, ""]
    root: Float[Array, "terms terms"]


class Factors(eqx.Module):
    """A problem after factorisation: A = basis B, and `inverse` is B's pseudo-inverse.

    `coefficient` solves it for A's scaled columns before any refinement.
    """

    basis: Float[Array, "rows terms"]
    inverse: Float[Array, "terms terms"]
    coefficient: Float[Array, " terms"]
    rank: Int[Array, ""]
    condition: Float[Array, ""]


def solve_least_squares(
    columns: Float[Array, "terms time"],
    y: Float[Array, " time"],
    weight: Float[Array, " time"],
    *,
    algorithm: str = "qr",
    scaling: str = "norm",
    ridge: Float[Array, ""] | float = 0.0,
    cutoff: Float[Array, ""] | float | None = None,
    refinements: int = 2,
) -> LeastSquaresFit:
    """Coefficients of least squares by `algorithm`, with rank and condition.

    `"qr"`: Householder QR and back-substitution (thesis 4.14 to 4.18). `"svd"`:
    singular value decomposition of the columns (4.19). `"normal"`: normal equations by
    Cholesky (4.13), which square the condition. The columns are scaled first, see
    `column_scaling.column_scale`, by powers of two, so that scaling rounds nothing; the
    remaining factor near one enters with the singular values only.

    Directions whose singular value is below `cutoff` times the largest are left out and
    the coefficients of scaled columns have minimum norm. The default, `max(time, terms)
    eps`, bounds what the rounding of a factorisation makes of a zero singular value;
    anything above it may be information. For the normal equations it is the square root
    of that: they hold the squares. Columns of zeros have coefficient zero and do not
    count in the rank, samples of weight zero have no effect.

    `refinements` steps of A. Bjorck, BIT 7 (1967), on theta and the residual together
    follow `"qr"` and `"svd"`: they matter where the residual is large.
    """
    root = jnp.sqrt(weight)
    a = (columns * root[None]).T
    scale = column_scale(a, root, scaling)
    exact = power_of_two(scale) if scaling != "none" else scale
    # Rows for the ridge, also where it is zero: there are then never too few.
    pull = jnp.sqrt(jnp.asarray(ridge, a.dtype)) * column_norm(a) / exact
    a = jnp.concatenate([a / exact[None], jnp.diag(pull)])
    target = jnp.concatenate([y * root, jnp.zeros_like(pull)])
    rest = exact / scale
    small = max(columns.shape) * float(jnp.finfo(a.dtype).eps)
    if algorithm == "normal":
        cut = small**0.5 if cutoff is None else cutoff
        fit = _normal(a, target, rest, cut)
    elif algorithm in ("qr", "svd"):
        factorise = _qr if algorithm == "qr" else _svd
        f = factorise(a, target, rest, small if cutoff is None else cutoff)
        theta = _refine_solution(a, target, f, refinements)
        fit = LeastSquaresFit(theta, f.rank, f.condition, f.inverse)
    else:
        raise ValueError(
            f'algorithm must be "qr", "svd" or "normal", got {algorithm!r}'
        )
    return LeastSquaresFit(
        fit.coefficient / exact, fit.rank, fit.condition, fit.root / exact[:, None]
    )


def _qr(a, target, rest, cut) -> Factors:
    """QR of the columns beside the target, whose last column is Q'y.

    Where the triangular factor is rank-deficient its SVD gives the minimum norm.
    """
    k = a.shape[1]
    q, r = jnp.linalg.qr(jnp.concatenate([a, target[:, None]], axis=1))
    r, moment = r[:k, :k], r[:k, k]
    u, s, vt = jnp.linalg.svd(r * rest[None], full_matrices=False)
    keep, rank, condition = _choose_rank(s, cut)
    shortest = rest[:, None] * (vt.T * _inverse(s, keep)[None]) @ u.T
    full = rank == k
    safe = jnp.where(full, r, jnp.eye(k, dtype=r.dtype))
    unit = jnp.eye(k, dtype=r.dtype)
    inverse = jax.scipy.linalg.solve_triangular(safe, unit)
    # The explicit inverse would not leave the smallest residual.
    theta = jax.scipy.linalg.solve_triangular(safe, moment)
    return Factors(
        q[:, :k],
        jnp.where(full, inverse, shortest),
        jnp.where(full, theta, shortest @ moment),
        rank,
        condition,
    )


def _svd(a, target, rest, cut) -> Factors:
    """Singular value decomposition of the scaled columns themselves."""
    u, s, vt = jnp.linalg.svd(a * rest[None], full_matrices=False)
    keep, rank, condition = _choose_rank(s, cut)
    inverse = rest[:, None] * (vt.T * _inverse(s, keep)[None])
    return Factors(u, inverse, inverse @ (u.T @ target), rank, condition)


def _normal(a, target, rest, cut) -> LeastSquaresFit:
    """Cholesky where the eigenvalues allow it, else the minimum norm from them."""
    gram, moment = a.T @ a, a.T @ target
    values, vectors = jnp.linalg.eigh(gram * rest[:, None] * rest[None])
    s = jnp.sqrt(jnp.maximum(values[::-1], 0.0))
    keep, rank, condition = _choose_rank(s, cut)
    root = rest[:, None] * vectors[:, ::-1] * _inverse(s, keep)[None]
    full = rank == len(s)
    safe = jnp.where(full, gram, jnp.diag(jnp.diagonal(gram)))
    theta = ridge_solve(safe, moment, least=0.0)
    theta = jnp.where(full, theta, root @ (root.T @ moment))
    return LeastSquaresFit(theta, rank, condition, root)


def _choose_rank(
    s: Float[Array, " terms"], cut: Float[Array, ""] | float
) -> tuple[Bool[Array, " terms"], Int[Array, ""], Float[Array, ""]]:
    """Singular values to keep, their number, and the condition number."""
    keep = s > cut * s[0]
    full = keep[-1]
    condition = jnp.where(full, s[0] / jnp.where(full, s[-1], 1.0), jnp.inf)
    return keep, jnp.sum(keep), condition


def _inverse(s, keep):
    return jnp.where(keep, 1.0 / jnp.where(keep, s, 1.0), 0.0)


def _refine_solution(a, target, f: Factors, steps: int) -> Float[Array, " terms"]:
    """Corrections from the residuals of r + A theta = y and A'r = 0 together.

    Correcting theta alone would round like the first solution, whose error grows with
    the square of the condition times the residual.
    """
    theta = f.coefficient
    if not steps:
        return theta
    across, along = slices(a), slices(a.T)

    def step(_, pair):
        theta, residual = pair
        miss = accurate_product(across, -theta, target - residual)
        slope = accurate_product(along, residual)
        change = f.inverse @ (f.basis.T @ miss + f.inverse.T @ slope)
        return theta + change, residual + (miss - a @ change)

    start = (theta, target - a @ theta)
    return jax.lax.fori_loop(0, steps, step, start)[0]


def least_squares(
    columns: Float[Array, "terms time"],
    y: Float[Array, " time"],
    weight: Float[Array, " time"],
) -> tuple[Float[Array, " terms"], Int[Array, ""], Float[Array, ""]]:
    """Coefficients, rank and condition by QR, without the steps of refinement.

    Without them no orthonormal basis is formed, which saves half of the time.
    """
    fit = solve_least_squares(columns, y, weight, refinements=0)
    return fit.coefficient, fit.rank, fit.condition


def leverage(
    columns: Float[Array, "terms time"],
    weight: Float[Array, " time"],
    root: Float[Array, "terms terms"],
) -> Float[Array, " time"]:
    """Diagonal of the hat matrix: how much each fitted value follows its own sample.

    `root` is that of a `LeastSquaresFit` with these columns and weights. Between 0 and
    1; the sum is the rank, with a ridge the effective number of parameters.
    """
    return weight * jnp.sum((root.T @ columns) ** 2, axis=0)
