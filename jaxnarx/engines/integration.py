"""Solutions in time, by fixed steps or with error control, and steady states."""

from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree

CHANGE = 0.1  # largest change of a settling step, relative to the state
DEFECT = 0.02  # largest error of a linearised implicit step, likewise
FLOOR = 0.1  # states below this share of their start count as this share of it
SETTLING_STEPS = 400  # the worst operating point tried takes 170


def rk4(
    derivative: Callable[
        [Float[Array, " states"], Float[Array, " forcing"]], Float[Array, " states"]
    ],
    state: Float[Array, " states"],
    step: Float[Array, ""],
    forcing: Float[Array, "steps 3 forcing"],
    *,
    count: Int[Array, ""] | None = None,
) -> Float[Array, " states"]:
    """The state after equal Runge-Kutta steps of `step` seconds, one per forcing row.

    `forcing` holds what `derivative` depends on besides the state, at the start, the
    middle and the end of each step. Rows from `count` on are left out, which saves
    their time unless the call is vectorised. Classical fourth order, no error control.
    """

    ahead = jnp.asarray([0.0, 0.5, 0.5, 1.0], state.dtype)
    share = jnp.asarray([1.0, 2.0, 2.0, 1.0], state.dtype) / 6.0
    place = jnp.asarray([0, 1, 1, 2])

    # A loop over the stages too: `derivative` is compiled once instead of four times.
    def move(y: Float[Array, " states"], w: Float[Array, "3 forcing"]):
        def stage(carry, row):
            slope, reached = carry
            a, b, now = row
            slope = derivative(y + step * a * slope, now)
            return (slope, reached + step * b * slope), None

        carry = jnp.zeros_like(y), y
        return jax.lax.scan(stage, carry, (ahead, share, w[place]))[0][1]

    if count is None:
        return jax.lax.scan(lambda y, w: (move(y, w), None), state, forcing)[0]

    def perhaps(y: Float[Array, " states"], row):
        k, w = row
        return jax.lax.cond(k < count, move, lambda y, w: y, y, w), None

    rows = jnp.arange(len(forcing)), forcing
    return jax.lax.scan(perhaps, state, rows)[0]


def hold_inputs(
    derivative: Callable[[Float[Array, " states"]], Float[Array, " states"]],
    state: Float[Array, " states"],
    duration: Float[Array, ""],
    *,
    steps: int,
) -> Float[Array, " states"]:
    """The state after `duration` seconds in `steps` steps of `rk4`; inputs are held."""
    nothing = jnp.zeros((steps, 3, 0), state.dtype)
    return rk4(lambda y, _: derivative(y), state, duration / steps, nothing)


def solve(
    derivative: Callable[[Float[Array, " states"]], Float[Array, " states"]],
    state: Float[Array, " states"],
    times: Float[Array, " times"],
    *,
    rtol: float = 1e-8,
    atol: PyTree[Float[Array, "..."]] | float = 1e-8,
    max_steps: int = 100_000,
) -> Float[Array, "times states"]:
    """States at `times` [s], counted from `state`, by steps under error control.

    The accurate way beside `rk4`, with the same `derivative` and inputs held: explicit
    fifth order, each step's error kept under atol + rtol |x|; `atol` may have one entry
    for each state. Differentiable in forward and reverse mode where `max_steps` is
    small. NaN where `max_steps` do not suffice.

    Reference: Ch. Tsitouras, Computers and Mathematics with Applications 62, 2011.
    """
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: derivative(y)),
        diffrax.Tsit5(),
        t0=0.0,
        t1=times[-1],
        dt0=None,
        y0=state,
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=atol),
        max_steps=max_steps,
        throw=False,
    )
    assert solution.ys is not None
    okay = solution.result == diffrax.RESULTS.successful
    return jnp.where(okay, solution.ys, jnp.nan)


def find_rest(
    rate: Callable[[Float[Array, " states"], Any], Float[Array, " states"]],
    start: Float[Array, " states"],
    given: PyTree[Float[Array, "..."]],
) -> Float[Array, " states"]:
    """A stable rest of x' = rate(x, given), reached from `start`; NaN where none is.

    Implicit Euler steps, linearised: (I/d - rate'(x)) s = rate(x). The step d starts at
    1 ms, grows by half and becomes infinite, so that the last steps are Newton's; it
    shrinks to a quarter where s changes x by more than a tenth or leaves a defect
    d rate(x + s) - s above a fiftieth. Surge and hard limits, where a Newton step alone
    goes anywhere, are passed like this. `start` must not have a zero; states nearer to
    zero than a tenth of it count as that much in both shares.

    No derivative runs through the iteration: the last Newton step alone is
    differentiated, by `given`, which is the implicit function theorem. First
    derivatives are exact, second ones and those by anything else are not.

    Reference: C. T. Kelley and D. E. Keyes, SIAM J. Numer. Anal. 35, 508-523, 1998
    (pseudo-transient continuation).
    """
    frozen = jax.lax.stop_gradient(given)
    scale = jax.lax.stop_gradient(jnp.abs(start))
    # Newton doubles the digits in every step, so one more step is full precision.
    small = float(jnp.finfo(start.dtype).eps) ** 0.6
    one = jnp.ones((), start.dtype)
    unit = jnp.eye(start.size, dtype=start.dtype)

    def scaled_rate(z: Float[Array, " states"]):
        value = rate(z * scale, frozen) / scale
        return value, value

    def go_on(carry):
        _, _, duration, size, count = carry
        return ((size > small) | (duration < 100.0)) & (count < SETTLING_STEPS)

    def step(carry):
        z, _, duration, size, count = carry
        slope, now = jax.jacfwd(scaled_rate, has_aux=True)(z)
        change = jnp.linalg.solve(unit / duration - slope, now)
        defect = duration * scaled_rate(z + change)[0] - change
        near = jnp.maximum(jnp.abs(z), FLOOR)
        moved = jnp.max(jnp.abs(change / near))
        okay = (moved <= CHANGE) & (jnp.max(jnp.abs(defect / near)) <= DEFECT)
        z = jnp.where(okay, z + change, z)
        duration = jnp.where(okay, jnp.minimum(1.5 * duration, 1e6), duration / 4)
        return z, slope, duration, jnp.where(okay, moved, size), count + 1

    begin = jax.lax.stop_gradient(start) / scale, unit, 1e-3 * one, one, jnp.asarray(0)
    z, slope, _, size, _ = jax.lax.while_loop(go_on, step, begin)
    # The slope is one step old, and that step was small.
    found = z * scale - scale * jnp.linalg.solve(slope, rate(z * scale, given) / scale)
    return jnp.where(size <= small, found, jnp.nan)
