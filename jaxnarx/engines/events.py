"""Sampling events: their duration, delays counted in them, a held speed that lags."""

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
