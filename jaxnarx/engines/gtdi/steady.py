"""A steady state found by pretending to wait for it."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

CHANGE = 0.1  # largest relative change in a step
DEFECT = 0.02  # largest relative error of a linearised implicit step
STEPS = 400  # the worst operating point tried takes 170


def rest_point(
    derivative: Callable[[Float[Array, " states"], PyTree], Float[Array, " states"]],
    start: Float[Array, " states"],
    args: PyTree,
) -> Float[Array, " states"]:
    """A stable rest of x' = f(x, args), reached from `start`; NaN where none is found.

    Implicit Euler steps, linearised: (I/d - f'(x)) s = f(x). The step d starts at 1 ms,
    grows by half and becomes infinite, so that the last steps are Newton's; it shrinks
    to a quarter where s changes x by more than a tenth or leaves a defect d f(x+s) - s
    above a fiftieth. Surge, where a Newton step alone goes anywhere, is passed like
    this. The states must not be near zero.

    The last Newton step alone is differentiated, by `args`: that is the implicit
    function theorem, in forward and reverse mode, for first derivatives.

    Reference: C. T. Kelley, D. E. Keyes, SIAM J. Numerical Analysis 35, 1998, 508-523.
    """
    frozen = jax.lax.stop_gradient(args)
    # Newton doubles the digits in every step, so one more step is full precision.
    small = float(jnp.finfo(start.dtype).eps) ** 0.6
    one = jnp.ones((), start.dtype)
    unit = jnp.eye(len(start), dtype=start.dtype)

    def rate(x):
        value = derivative(x, frozen)
        return value, value

    def go_on(carry):
        _, _, duration, size, count = carry
        return ((size > small) | (duration < 100.0)) & (count < STEPS)

    def step(carry):
        x, _, duration, size, count = carry
        slope, now = jax.jacfwd(rate, has_aux=True)(x)
        change = jnp.linalg.solve(unit / duration - slope, now)
        defect = duration * derivative(x + change, frozen) - change
        moved = jnp.max(jnp.abs(change / x))
        okay = (moved <= CHANGE) & (jnp.max(jnp.abs(defect / x)) <= DEFECT)
        x = jnp.where(okay, x + change, x)
        duration = jnp.where(okay, jnp.minimum(1.5 * duration, 1e6), duration / 4)
        return x, slope, duration, jnp.where(okay, moved, size), count + 1

    begin = (jax.lax.stop_gradient(start), unit, 1e-3 * one, one, jnp.asarray(0))
    x, slope, _, size, _ = jax.lax.while_loop(go_on, step, begin)
    # The slope is one step old, and that step was small.
    found = x - jnp.linalg.solve(slope, derivative(x, args))
    return jnp.where(size <= small, found, jnp.nan)
