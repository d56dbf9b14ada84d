"""Recursive least squares with forgetting, in square-root form.

After every sample the coefficients minimise

    sum_i lambda^(n-i) w_i (y_i - x_i'theta)^2
        + lambda^n (theta - theta_0)' P_0^-1 (theta - theta_0) ,

by the updates of the thesis (4.40) to (4.42), extended by the factor lambda:

    theta <- theta + gamma P x (y - x'theta),      gamma = 1/(lambda/w + x'P x)
    P     <- (P - gamma P x x'P)/lambda .

(4.40) is printed without the first theta on the right. In this form rounding makes P
lose its symmetry and its sign on long or ill-conditioned records. Here P = S S' and S
is carried, so that P cannot become indefinite: with f = S'x and a = lambda + w f'f,

    S <- (S - w/(a + sqrt(lambda a)) S f f')/sqrt(lambda) .

J. E. Potter; G. Bierman, Factorization Methods for Discrete Sequential Estimation, 1977
(section II.4). Forgetting: L. Ljung, T. Soderstrom, Theory and Practice of Recursive
Identification, 1983.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays._least_squares import LeastSquaresFit
from jaxnarx.arrays.column_scaling import column_norm, column_scale, power_of_two

PRIOR_EXPONENT = 0.7
"""Without a ridge a recursion starts from eps to this power of each column's squared
norm (1e-11 in float64), which is taken out again at the end. More biases more before
that is done, less loses digits: both are even at a condition of some 1e5."""


class Recursion(eqx.Module):
    """State of a recursion: the rows of S', and below them the coefficients.

    One array, because a loop on a CPU pays for every array it carries.
    """

    packed: Float[Array, "terms_and_one terms"]

    @property
    def coefficient(self) -> Float[Array, " terms"]:
        """Estimate after the samples so far."""
        return self.packed[-1]

    @property
    def root(self) -> Float[Array, "terms terms"]:
        """S with P = S S'."""
        return self.packed[:-1].T

    @property
    def covariance(self) -> Float[Array, "terms terms"]:
        """P: the covariance of the coefficients per unit of noise variance."""
        return self.root @ self.root.T

    @property
    def trace(self) -> Float[Array, ""]:
        """Trace of P."""
        return jnp.sum(self.packed[:-1] ** 2)


class RecursionHistory(NamedTuple):
    """Estimates and errors of a recursion at every sample."""

    error: Float[Array, " time"]
    coefficient: Float[Array, "time terms"] | None


def begin(
    coefficient: Float[Array, " terms"], covariance: Float[Array, ""] | float
) -> Recursion:
    """A recursion at `coefficient` with P = `covariance` times the unit matrix."""
    size = jnp.sqrt(jnp.asarray(covariance, coefficient.dtype))
    root = size * jnp.eye(len(coefficient), dtype=coefficient.dtype)
    return Recursion(jnp.concatenate([root, coefficient[None]]))


def update_recursion(
    state: Recursion,
    x: Float[Array, " terms"],
    y: Float[Array, ""],
    weight: Float[Array, ""],
    forgetting: Float[Array, ""],
    least: Float[Array, ""] | float = 0.0,
) -> tuple[Recursion, Float[Array, ""], Bool[Array, ""]]:
    """The state after one more sample, the error of its prediction before, and if used.

    A sample counts if its weight is positive and the news in it, w x'P x, not below
    `least`. Any other changes nothing; nothing is forgotten at it either.
    """
    packed = state.packed
    below = jnp.arange(packed.shape[0]) == packed.shape[1]
    # A product written out: as a dot it costs a call in every turn of the loop.
    z = jnp.sum(packed * x[None], axis=1)
    error = y - z[-1]
    f = jnp.where(below, 0.0, z)
    news = weight * jnp.sum(f**2)
    used = (weight > 0) & (news >= least)
    weight = jnp.where(used, weight, 0.0)
    a = forgetting + news
    gain = jnp.sum(packed * f[:, None], axis=0)
    fade = jnp.where(used, 1.0 / jnp.sqrt(forgetting), 1.0)
    shrink = f * (weight * fade / (a + jnp.sqrt(forgetting * a)))
    change = jnp.where(below, weight * error / a, -shrink)
    kept = packed * jnp.where(below, 1.0, fade)[:, None]
    return Recursion(kept + change[:, None] * gain[None]), error, used


def recursive_least_squares(
    start: Recursion,
    columns: Float[Array, "terms time"],
    y: Float[Array, " time"],
    weight: Float[Array, " time"],
    *,
    forgetting: Float[Array, ""] | float = 1.0,
    history: bool = False,
) -> tuple[Recursion, RecursionHistory]:
    """All samples in order from `start`; the end, and every error before its update.

    With `history` also the coefficients after every sample. `forgetting` in (0, 1].
    """
    factor = jnp.asarray(forgetting, columns.dtype)

    def step(state, sample):
        x, y_now, weight_now = sample
        state, error, _ = update_recursion(state, x, y_now, weight_now, factor)
        return state, (error, state.coefficient if history else None)

    # Two steps per turn: a third faster on a CPU; more gain nothing.
    end, (error, path) = jax.lax.scan(step, start, (columns.T, y, weight), unroll=2)
    return end, RecursionHistory(error, path)


def solve_recursively(
    columns: Float[Array, "terms time"],
    y: Float[Array, " time"],
    weight: Float[Array, " time"],
    *,
    scaling: str = "norm",
    ridge: Float[Array, ""] | float = 0.0,
    forgetting: Float[Array, ""] | float = 1.0,
) -> LeastSquaresFit:
    """A least-squares problem from its first sample to its last.

    The ridge of `solve_least_squares` is the start P_0^-1, and forgotten like a sample
    before the first. Without one a small start is removed from the result, see
    `PRIOR_EXPONENT`; directions of which most of what is known at the end comes from
    that start do not count in the rank, and their coefficients are zero. Forgetting
    long in a direction without news overflows: the result is then not finite.
    """
    root = jnp.sqrt(weight)
    a = (columns * root[None]).T
    given = column_scale(a, root, scaling)
    scale = power_of_two(given) if scaling != "none" else given
    size = column_norm(a) / scale
    ridge = jnp.asarray(ridge, a.dtype)
    free = ridge == 0.0
    prior = jnp.where(free, jnp.finfo(a.dtype).eps ** PRIOR_EXPONENT, ridge)
    there = size > 0
    information = jnp.where(there, prior * size**2, 1.0)
    own = jnp.where(there, 1.0 / jnp.sqrt(information), 0.0)
    start = Recursion(jnp.concatenate([jnp.diag(own), jnp.zeros_like(a[:1])]))
    end, _ = recursive_least_squares(
        start, columns / scale[:, None], y, weight, forgetting=forgetting
    )
    count = jnp.sum(weight > 0).astype(a.dtype)
    least = float(jnp.finfo(a.dtype).tiny) ** 0.5
    left = jnp.maximum(jnp.asarray(forgetting, a.dtype) ** count, least) * information
    return _without_start(end, left, free, scale, given)


def _without_start(end: Recursion, left, free, scale, given) -> LeastSquaresFit:
    """The estimate without what it still holds of its start, information `left`.

    With E = diag(sqrt(left)), the singular values of E S squared are the shares of
    their directions' information that are owed to the start. With a ridge (`free`
    False) the start stays.
    """
    unit = jnp.sqrt(left)
    vectors, s, _ = jnp.linalg.svd(unit[:, None] * end.root, full_matrices=False)
    known = (s > 0) & ((s**2 < 0.5) | ~free)
    share = jnp.where(known & free, s**2, 0.0)
    more = jnp.where(known, 1.0 / (1.0 - share), 0.0)
    theta = vectors @ (more * (vectors.T @ (unit * end.coefficient)))
    width = vectors * (s * jnp.sqrt(more))[None]
    rank = jnp.sum(known)
    full = rank == len(s)
    back = 1.0 / (unit * scale)
    root = back[:, None] * width
    spread = jnp.linalg.svd(root * given[:, None], compute_uv=False)
    condition = jnp.where(full, spread[0] / jnp.where(full, spread[-1], 1.0), jnp.inf)
    return LeastSquaresFit(back * theta, rank, condition, root)
