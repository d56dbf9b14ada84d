"""A free run by Newton's method over the whole trajectory, parallel in time.

The run solves F(y) = 0, F_t = y_t - clip(step(params, drive_t, history_t)). Newton's
method linearises it along a guess: with A_t = d y_t / d history_t there and c_t = -F_t,
the correction obeys the linear recursion

    delta_t = A_t delta_history + c_t ,

whose steps are affine maps s -> M_t s + m_t of the companion state, the last `depth`
corrections. Composition of affine maps is associative: a parallel scan of logarithmic
depth solves for all of them. Lim, Zhu, Selfridge, Kasim 2024 ("Parallelizing
non-linear sequential models over the sequence length"), there for recurrent networks.

An iteration takes time * (outputs * depth)^3 operations and time * (outputs * depth)^2
numbers, the loop time * outputs^2 * depth operations: it needs a machine that is much
wider than it is fast.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.recurrence import (
    Step,
    free_run,
    history_of,
    own_history,
    run_history,
    sensitivities,
)


def affine_recurrence(
    a: Float[Array, "time outputs outputs depth"],
    c: Float[Array, "time outputs"],
    anchor: Bool[Array, " time"],
) -> Float[Array, "time outputs"]:
    """delta_t[o] = c_t[o] + sum_(i,k) A_t[o, i, k] delta_(t-1-k)[i], from rest.

    At an anchor the past is forgotten, even where it has overflowed.
    """
    time, outputs, _, depth = a.shape
    size = outputs * depth
    top = jnp.swapaxes(a, 2, 3).reshape(time, outputs, size)
    shift = jnp.broadcast_to(
        jnp.eye(size - outputs, size, dtype=a.dtype), (time, size - outputs, size)
    )
    matrix = jnp.concatenate([top, shift], axis=1)
    matrix = jnp.where(anchor[:, None, None], 0.0, matrix)
    offset = jnp.pad(c, ((0, 0), (0, size - outputs)))

    def then(first, second):
        m1, c1, cut1 = first
        m2, c2, cut2 = second
        cut = cut1 | cut2
        m = jnp.where(cut[:, None, None], 0.0, m2 @ m1)
        passed = jnp.einsum("tij,tj->ti", m2, c1)
        return m, c2 + jnp.where(cut2[:, None], 0.0, passed), cut

    return jax.lax.associative_scan(then, (matrix, offset, anchor))[1][:, :outputs]


def newton_step(
    step: Step, params, drive, measured, anchor, lower, upper, y, *, depth: int
) -> tuple[Float[Array, "time outputs"], Float[Array, ""]]:
    """A better guess of the trajectory, and the largest correction, relative to 1 or y.

    Where the linear solution has overflowed, the image of the guess is taken instead:
    from an anchor on, every such iteration makes one more sample exact.
    """
    history = run_history(y, history_of(measured, depth), anchor)
    a, _ = sensitivities(step, params, drive, history, lower, upper)
    a = jnp.where(own_history(anchor, depth)[:, None, None], a, 0.0)
    image = jax.vmap(step, in_axes=(None, 0, 0))(params, drive, history)
    low, high = lower[None], upper[None]
    image = jnp.clip(image, low, high)
    new = jnp.clip(y + affine_recurrence(a, image - y, anchor), low, high)
    new = jnp.where(jnp.isfinite(new), new, image)
    return new, jnp.max(jnp.abs(new - y) / jnp.maximum(1.0, jnp.abs(y)))


def newton_run(
    step: Step,
    params: Any,
    drive: Any,
    measured: Float[Array, "time outputs"],
    anchor: Bool[Array, " time"],
    lower: Float[Array, " outputs"],
    upper: Float[Array, " outputs"],
    *,
    depth: int,
    iterations: int = 30,
    tolerance: float = 1e-10,
) -> tuple[Float[Array, "time outputs"], Bool[Array, ""], Int[Array, ""]]:
    """Newton's method from the measured outputs: run, converged, iterations used.

    Ends when no sample moves by more than `tolerance` relative to 1 or its value
    (at least 100 units of rounding). A correction of that size has passed through the
    linear solve, so the rounding that the run itself amplifies is in it: a run that
    cannot be computed to `tolerance` does not converge.
    """
    # What precedes the first anchor is meaningless; it must not keep the rest waiting.
    anchor = anchor | (jnp.cumsum(anchor) == 0)
    limit = jnp.maximum(tolerance, 100 * jnp.finfo(measured.dtype).eps)

    def unfinished(carry):
        _, moved, count = carry
        return (count < iterations) & ~(moved <= limit)

    def advance(carry):
        y, _, count = carry
        y, moved = newton_step(
            step, params, drive, measured, anchor, lower, upper, y, depth=depth
        )
        return y, moved, count + 1

    start = jnp.clip(measured, lower[None], upper[None])
    infinite = jnp.asarray(jnp.inf, measured.dtype)
    carry = (start, infinite, jnp.asarray(0))
    y, moved, count = jax.lax.while_loop(unfinished, advance, carry)
    return y, moved <= limit, count


def parallel_run(
    step: Step,
    params: Any,
    drive: Any,
    measured: Float[Array, "time outputs"],
    anchor: Bool[Array, " time"],
    lower: Float[Array, " outputs"],
    upper: Float[Array, " outputs"],
    *,
    depth: int,
    iterations: int = 30,
    tolerance: float = 1e-10,
) -> tuple[Float[Array, "time outputs"], Bool[Array, ""]]:
    """`free_run` by `newton_run`; where that has not converged, by the time loop.

    Arguments as for `free_run`. Returns the outputs, equal to those of the loop from
    the first anchor on, and whether Newton's method gave them. Under `vmap` both are
    computed: map over records instead. Not for reverse mode, use `free_run`.
    """
    args = (params, drive, measured, anchor, lower, upper)
    y, converged, _ = newton_run(
        step, *args, depth=depth, iterations=iterations, tolerance=tolerance
    )
    y = jax.lax.cond(converged, lambda: y, lambda: free_run(step, *args, depth=depth))
    return y, converged
