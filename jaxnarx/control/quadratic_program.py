"""Quadratic programs of a few variables, by Mehrotra's predictor and corrector.

    min_z  z' H z / 2 + g' z   with   G z <= h ,

from the conditions H z + g + G' l = 0, G z + s = h, s_i l_i = 0, s, l >= 0: a step to
these conditions (predictor) tells how far complementarity can fall, a second with the
same factors goes there (S. Mehrotra, SIAM J. Optim. 2, 1992, 575-601; J. Nocedal, S. J.
Wright, Numerical Optimization, 2006, algorithm 16.4). Dense, for some dozens of
variables and some hundreds of limits.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

MOST_STEPS = 25
TOLERANCE = 1e-9
"""Largest residual and complementarity, in the unit of the gradient and the limits."""
NEAR_BORDER = 0.995
"""Share of the way to the border that a step takes."""


class QuadraticSolution(NamedTuple):
    """Where a quadratic program has its least value; `residual` is the largest of the
    conditions, `steps` how many were taken: all there are where one has failed."""

    z: Float[Array, " n"]
    multipliers: Float[Array, " limits"]
    residual: Float[Array, ""]
    steps: Int[Array, ""]


class _Iterate(NamedTuple):
    z: Array
    slack: Array
    multipliers: Array
    residual: Array
    steps: Array


def solve_quadratic(
    h: Float[Array, "n n"],
    g: Float[Array, " n"],
    rows: Float[Array, "limits n"],
    bound: Float[Array, " limits"],
    z: Float[Array, " n"],
) -> QuadraticSolution:
    """The least value of z' h z / 2 + g' z where rows z <= bound, from `z`.

    Pure; `h` must be positive definite. A bound may be infinite. Where the limits
    contradict each other the residual stays above `TOLERANCE`.
    """
    there = jnp.isfinite(bound)
    rows = jnp.where(there[:, None], rows, 0.0)
    bound = jnp.where(there, bound, 1.0)

    def residuals(z, slack, multipliers):
        return h @ z + g + rows.T @ multipliers, rows @ z + slack - bound

    def worst(z, slack, multipliers):
        dual, primal = residuals(z, slack, multipliers)
        parts = jnp.abs(dual).max(), jnp.abs(primal).max(), (slack * multipliers).max()
        return jnp.stack(parts).max()

    def longest(now, move):
        """How far `now` may move before an entry is zero."""
        ends = jnp.where(move < 0, -now / jnp.where(move < 0, move, -1.0), jnp.inf)
        return jnp.minimum(1.0, ends.min())

    def step(at: _Iterate) -> _Iterate:
        z, slack, multipliers = at.z, at.slack, at.multipliers
        dual, primal = residuals(z, slack, multipliers)
        weight = multipliers / slack
        factor = jax.scipy.linalg.cho_factor(h + (rows.T * weight[None]) @ rows)

        def towards(product):
            """The step after which slack times multiplier is that much lower."""
            inner = weight * primal - product / slack
            dz = jax.scipy.linalg.cho_solve(factor, -dual - rows.T @ inner)
            ds = -primal - rows @ dz
            return dz, ds, -(product + multipliers * ds) / slack

        dz, ds, dl = towards(slack * multipliers)
        free = jnp.minimum(longest(slack, ds), longest(multipliers, dl))
        now = jnp.mean(slack * multipliers)
        then = jnp.mean((slack + free * ds) * (multipliers + free * dl))
        centre = (then / now) ** 3 * now
        dz, ds, dl = towards(slack * multipliers + ds * dl - centre)
        free = jnp.minimum(longest(slack, ds), longest(multipliers, dl))
        free = jnp.where(free < 1.0, NEAR_BORDER * free, free)
        z = z + free * dz
        slack, multipliers = slack + free * ds, multipliers + free * dl
        found = z, slack, multipliers
        new = _Iterate(*found, worst(*found), at.steps + 1)
        # Near the solution a factorisation may fail: what there is stays.
        stays = at._replace(steps=jnp.full_like(at.steps, MOST_STEPS))
        good = jnp.isfinite(new.residual)
        return jax.tree.map(lambda a, b: jnp.where(good, a, b), new, stays)

    def goes_on(at: _Iterate):
        return (at.residual > TOLERANCE) & (at.steps < MOST_STEPS)

    slack = jnp.maximum(bound - rows @ z, 1.0)
    begin = z, slack, jnp.ones_like(bound)
    first = _Iterate(*begin, worst(*begin), jnp.zeros((), int))
    end = jax.lax.while_loop(goes_on, step, first)
    return QuadraticSolution(end.z, end.multipliers, end.residual, end.steps)
