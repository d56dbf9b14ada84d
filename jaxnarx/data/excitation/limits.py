"""Range and slew-rate limits of an actuator, applied to any signal."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.data.excitation.require import Number, positive
from jaxnarx.errors import SpecError


def limited(
    signal: Float[Array, " time"],
    *,
    rate: Number | None = None,
    low: Number | None = None,
    high: Number | None = None,
    sample_time: Number | None = None,
) -> Float[Array, " time"]:
    """`signal` as an actuator follows it that stays in range and has a largest slope.

        x_0 = c(u_0),  x_t = x_{t-1} + clip(c(u_t) - x_{t-1}, -d, d),  d = rate dt

    with c the clip to `low` and `high` and dt the `sample_time` in s. `rate` is in
    units of the input per second, up and down alike; `low` and `high` in its unit; what
    is `None` does not limit. A signal that keeps the limits comes back as it is. Pure
    in `signal`: goes through `jit`, `vmap` and `grad`.
    """
    bottom, top = _range(low, high)
    if rate is not None and sample_time is None:
        raise SpecError(
            "a rate limit, in units per second, needs sample_time=... in s",
            field="sample_time",
        )
    target = jnp.clip(signal, bottom, top)
    if rate is None or sample_time is None:
        return target
    move = positive(rate, "rate") * positive(sample_time, "sample_time")

    def follow(now, aim):
        gap = aim - now
        # Not now + gap: what is reached is reached to the last bit.
        now = jnp.where(jnp.abs(gap) <= move, aim, now + jnp.clip(gap, -move, move))
        return now, now

    return jax.lax.scan(follow, target[0], target)[1]


def _range(low: Number | None, high: Number | None) -> tuple[float, float]:
    bottom = -math.inf if low is None else float(low)
    top = math.inf if high is None else float(high)
    if not bottom <= top or bottom == math.inf or top == -math.inf:
        raise SpecError(
            f"low must not be above high, and neither NaN, got {low} and {high}",
            field="low",
        )
    return bottom, top
