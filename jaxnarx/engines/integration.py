"""Fixed steps in time, steady states, and actuators with dead time, for the beds."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

SETTLING_STEPS = 152  # 10 ms long at first, then 0.3 s; 40 s in all
NEWTON_STEPS = 8


def rk4(
    derivative: Callable[
        [Float[Array, " states"], Float[Array, " forcing"]], Float[Array, " states"]
    ],
    state: Float[Array, " states"],
    step: Float[Array, ""],
    forcing: Float[Array, "steps 3 forcing"],
) -> Float[Array, " states"]:
    """The state after equal Runge-Kutta steps of `step` seconds, one per forcing row.

    `forcing` holds what `derivative` depends on besides the state, at the start, the
    middle and the end of each step. Classical fourth order, no error control.
    """

    ahead = jnp.asarray([0.0, 0.5, 0.5, 1.0], state.dtype)
    share = jnp.asarray([1.0, 2.0, 2.0, 1.0], state.dtype) / 6.0
    place = jnp.asarray([0, 1, 1, 2])

    # A loop over the stages too: `derivative` is compiled once instead of four times.
    def advance(y: Float[Array, " states"], w: Float[Array, "3 forcing"]):
        def stage(carry, row):
            slope, reached = carry
            a, b, now = row
            slope = derivative(y + step * a * slope, now)
            return (slope, reached + step * b * slope), None

        carry = jnp.zeros_like(y), y
        return jax.lax.scan(stage, carry, (ahead, share, w[place]))[0][1], None

    return jax.lax.scan(advance, state, forcing)[0]


def settled(
    rate: Callable[[Float[Array, " states"], Any], Float[Array, " states"]],
    start: Float[Array, " states"],
    given: PyTree[Float[Array, "..."]],
) -> Float[Array, " states"]:
    """Where `rate(x, given)` vanishes, sought along the transient from `start`.

    Linearly implicit Euler steps,

        x <- x + (I/h - J)^-1 rate(x),

    growing from 10 ms to 0.3 s, follow the transient; the last ones have h infinite and
    are Newton's method. Growing further without end went astray at hard limits. NaN
    where it does not converge.

    No derivative runs through the iteration: one more Newton step with x and J held has
    the derivatives of the implicit function theorem. The first ones by `given` are
    exact, second ones and those by anything else are not.

    Reference: C. T. Kelley and D. E. Keyes, SIAM J. Numer. Anal. 35, 1998
    (pseudo-transient continuation).
    """
    frozen = jax.lax.stop_gradient(given)
    scale = jax.lax.stop_gradient(jnp.abs(start))

    def scaled(z: Float[Array, " states"]) -> Float[Array, " states"]:
        return rate(z * scale, frozen) / scale

    def advance(carry, pace: Float[Array, ""]):
        z, _ = carry
        slope = jax.jacfwd(scaled)(z)
        step = jnp.linalg.solve(jnp.diag(jnp.full(z.shape, pace)) - slope, scaled(z))
        return (z + step, slope), jnp.max(jnp.abs(step))

    pace = 100.0 * 1.1 ** -jnp.arange(SETTLING_STEPS, dtype=start.dtype)
    pace = jnp.concatenate(
        [jnp.maximum(pace, 3.0), jnp.zeros(NEWTON_STEPS, start.dtype)]
    )
    carry = (start / scale, jnp.zeros((start.size, start.size), start.dtype))
    (z, slope), sizes = jax.lax.scan(advance, carry, pace)
    small = float(jnp.finfo(start.dtype).eps) ** 0.6
    z = jnp.where(sizes[-1] < small, z, jnp.nan)
    return z * scale - scale * jnp.linalg.solve(slope, rate(z * scale, given) / scale)


def delayed_lag(
    start: Float[Array, ""],
    commands: Float[Array, " held"],
    delay: Float[Array, ""],
    lag: Float[Array, ""],
    interval: float,
    times: Float[Array, " times"],
) -> Float[Array, " times"]:
    """First-order lag behind a dead time, at `times` of a sample [s], exactly.

    `start` is the position at the sample's start. `commands` are the held inputs of the
    last samples, oldest first, the present one last, each `interval` seconds long. The
    command given j samples ago arrives at `delay` - j `interval`, so

        x(s) = d_0 + (x_0 - d_0) e^(-s/T) + sum_j D_j (1 - e^(-(s - a_j)/T)),

    d_0 the delayed command at s = 0, D_j the change that arrives at 0 < a_j < s. In
    closed form because an arrival inside a Runge-Kutta step would cost its order.
    """
    ago = jnp.arange(commands.shape[0] - 2, -1, -1, dtype=times.dtype)
    arrival = delay - ago * interval
    change = jnp.diff(commands)
    early = arrival <= 0
    held = commands[0] + jnp.sum(jnp.where(early, change, 0.0))
    since = jnp.maximum(times[:, None] - arrival[None], 0.0)
    late = jnp.where(early[None], 0.0, change[None] * -jnp.expm1(-since / lag))
    return held + (start - held) * jnp.exp(-times / lag) + jnp.sum(late, axis=1)


def root(x: Float[Array, ""]) -> Float[Array, ""]:
    """Square root of max(0, x), with slope zero where x is not positive."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)
