"""Hold times: for how many samples a staircase keeps each of its levels."""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, PRNGKeyArray

from jaxnarx.data.excitation.require import hold_range, member, whole

HoldDistribution = Literal["uniform", "geometric", "log-uniform"]
HOLD_DISTRIBUTIONS = ("uniform", "geometric", "log-uniform")

_CUT = 0.05


def hold_times(
    key: PRNGKeyArray,
    count: int,
    *,
    hold: tuple[int, int],
    distribution: HoldDistribution = "uniform",
) -> Int[Array, " segments"]:
    """`count` independent whole numbers from `hold[0]` to `hold[1]`, both included.

    In samples. "uniform": all equally likely. "geometric": after the shortest hold, the
    chance to switch is the same at every sample, as in a random telegraph signal; it is
    such that one uncut hold in twenty would be longer than the longest [O]. Most holds
    are short. "log-uniform": as many holds in every octave, so that fast and slow
    dynamics get the same number of steps; for `hold` over more than a decade.

    All three invert the distribution function; the last two round down.
    """
    shortest, longest = hold_range(hold)
    count = whole(count, "count")
    member(distribution, HOLD_DISTRIBUTIONS, "hold_distribution")
    if distribution == "uniform":
        return jax.random.randint(key, (count,), shortest, longest + 1)
    u = jax.random.uniform(key, (count,), float)
    if distribution == "geometric":
        scale = (longest + 1 - shortest) / -jnp.log(_CUT)
        exact = shortest - scale * jnp.log1p(-u * (1 - _CUT))
    else:
        exact = shortest * ((longest + 1) / shortest) ** u
    # Rounding may put u next to one onto longest + 1.
    return jnp.clip(jnp.floor(exact).astype(int), shortest, longest)
