"""A dead time in seconds on an input that is held for events."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def delayed(
    levels: Float[Array, " levels"],
    durations: Float[Array, " past"],
    step: Float[Array, ""],
    dead_time: Float[Array, ""],
    *,
    steps: int,
) -> Float[Array, " steps"]:
    """A staircase of commands `dead_time` [s] late, averaged over steps of `step` [s].

    `levels` are the commands of the last events, the present one last; `durations` [s]
    of the past events between the oldest and the present. The oldest level holds
    before, the present one on. Averages, because a switch inside a sub-step then
    moves smoothly with the dead time and with speed.
    """
    zero = jnp.zeros(1, durations.dtype)
    starts = -jnp.concatenate([jnp.cumsum(durations[::-1])[::-1], zero])
    times = jnp.arange(steps + 1, dtype=zero.dtype) * step - dead_time
    since = jnp.maximum(times[:, None] - starts[None], 0.0)
    area = levels[0] * times + since @ jnp.diff(levels)
    return jnp.diff(area) / step
