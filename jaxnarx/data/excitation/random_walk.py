"""The random walk: integrated uniform steps, kept in range by reflection."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.data.excitation.require import Number, Pair, positive, span, whole
from jaxnarx.errors import SpecError


def random_walk(
    key: PRNGKeyArray,
    length: int,
    *,
    amplitude: Pair,
    step: Number,
    hold: int = 1,
    start: Number | None = None,
) -> Float[Array, " time"]:
    """Every `hold` samples a step, uniform over -`step` to `step`, reflected in range.

    The free walk w_k = start + sum of the steps is folded into `amplitude` = (low,
    high) as a light ray between two mirrors,

        x_k = low + s - |((w_k - low) mod 2 s) - s|,  s = high - low,

    so |x_k - x_{k-1}| <= step, and in the long run all levels are equally likely.
    `step` in the unit of the input; `start` is the middle unless given.

    Reference: Z. Li, PhD thesis, University of Liverpool 2012, section 2.1: uniform
    pseudo-random numbers, a gain and an integrator.
    """
    low, high = span(amplitude, "amplitude")
    length, hold = whole(length, "length"), whole(hold, "hold")
    step = positive(step, "step")
    start = (low + high) / 2 if start is None else start
    if not low <= start <= high:
        raise SpecError(
            f"start must be in the range {low:g} to {high:g}, got {start}",
            field="start",
        )
    count = -(-length // hold)
    moves = jax.random.uniform(key, (count,), float, -step, step).at[0].set(0.0)
    walk = _folded(start - low + jnp.cumsum(moves), high - low)
    return jnp.repeat(jnp.clip(low + walk, low, high), hold)[:length]


def _folded(x: Float[Array, " time"], width: float) -> Float[Array, " time"]:
    """`x` reflected at 0 and at `width` until it lies between."""
    if width == 0:
        return jnp.zeros_like(x)
    return width - jnp.abs(jnp.mod(x, 2 * width) - width)
