"""Delays in events and in seconds, actuators behind them, and a speed that lags."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def shift(
    register: Float[Array, " events"], value: Float[Array, ""]
) -> tuple[Float[Array, " events"], Float[Array, ""]]:
    """Push `value` into a delay line; returns the new line and the value that leaves.

    A line of length n delays by n events; length 0 is no delay.
    """
    line = jnp.concatenate([register, value[None]])
    return line[1:], line[0]


def event_duration(
    degrees: float, speed: Float[Array, ""], *, slowest: float
) -> Float[Array, ""]:
    """Duration D/(6 N) [s] of an event of `degrees` crank angle at `speed` [rpm].

    Below `slowest` [rpm] the duration stays at its value there, so that a fixed number
    of sub-steps always suffices.
    """
    return degrees / (6.0 * jnp.maximum(speed, slowest))


def lagging_speed(
    target: Float[Array, " time"], *, degrees: float, slowest: float, lag: float
) -> Float[Array, " time"]:
    """Speed [rpm] behind a first-order lag of `lag` [s] from the staircase `target`.

    One value for each event of `degrees` crank angle, exact for a target held through
    the event. Starts at the first target.
    """

    def follow(speed, aim):
        duration = event_duration(degrees, speed, slowest=slowest)
        return speed - (aim - speed) * jnp.expm1(-duration / lag), speed

    return jax.lax.scan(follow, target[0], target)[1]


def lag_and_delay(
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


def delay_staircase(
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
