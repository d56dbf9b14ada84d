"""Actuators behind a dead time, in closed form."""

import jax.numpy as jnp
from jaxtyping import Array, Float


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
