"""Integration inside one sampling event and transport delays counted in events."""

from collections.abc import Callable

import diffrax
import jax.numpy as jnp
from jaxtyping import Array, Float


def integrate(
    derivative: Callable[[Float[Array, " states"]], Float[Array, " states"]],
    state: Float[Array, " states"],
    duration: Float[Array, ""],
    *,
    steps: int,
) -> Float[Array, " states"]:
    """The state after `duration` seconds in `steps` equal steps; inputs are held.

    Explicit, fifth order. Differentiable in forward and reverse mode.

    Reference: Ch. Tsitouras, Computers and Mathematics with Applications 62, 2011.
    """
    # The event is mapped to [0, 1], where the step is the same for every event and
    # rounding cannot ask for one step more.
    zero = jnp.zeros_like(duration)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: duration * derivative(y)),
        diffrax.Tsit5(),
        t0=zero,
        t1=zero + 1,
        dt0=zero + 1 / steps,
        y0=state,
        saveat=diffrax.SaveAt(t1=True),
        adjoint=diffrax.DirectAdjoint(),
        max_steps=steps,
        throw=False,
    )
    assert solution.ys is not None
    return solution.ys[0]


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
