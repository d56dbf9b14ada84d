"""APRBS: a staircase of random steps."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxnarx.data.excitation.holds import HoldDistribution, hold_times
from jaxnarx.data.excitation.levels import (
    LevelDistribution,
    drawn_levels,
    given_levels,
)
from jaxnarx.data.excitation.require import Number, Pair, hold_range, whole
from jaxnarx.errors import SpecError


def aprbs(
    key: PRNGKeyArray,
    length: int,
    *,
    hold: tuple[int, int],
    amplitude: Pair | None = None,
    levels: Sequence[Number] | None = None,
    hold_distribution: HoldDistribution = "uniform",
    level_distribution: LevelDistribution = "uniform",
) -> Float[Array, " time"]:
    """Amplitude-modulated pseudo-random binary sequence.

    A staircase whose hold times are whole numbers from `hold[0]` to `hold[1]`, both
    included, in samples, and whose levels lie in `amplitude` = (low, high), in the unit
    of the input. The last hold may be cut short by the end.

    `hold_distribution`: "uniform", "geometric" or "log-uniform", see `hold_times`.
    `level_distribution`: "uniform"; "latin", in which each of as many equal strata as
    there are segments is visited once; "arcsine", which visits the ends most, see
    `drawn_levels`. `levels` instead of `amplitude` gives the levels themselves: all of
    them in random order, then all again.

    Long holds show gains, short ones dynamics, and the levels visit the whole range,
    which a binary sequence does not; nonlinear identification needs all three.

    Reference: O. Nelles, Nonlinear System Identification, Springer 2001, section 17.7.
    """
    length = whole(length, "length")
    most = -(-length // hold_range(hold)[0])
    if (amplitude is None) == (levels is None):
        raise SpecError(
            "give either amplitude=(low, high) or levels=[...], one of the two",
            field="amplitude",
        )
    time_key, level_key = jax.random.split(key)
    holds = hold_times(time_key, most, hold=hold, distribution=hold_distribution)
    ends = jnp.cumsum(holds)
    used: Bool[Array, " segments"] = ends - holds < length
    if amplitude is not None:
        staircase = drawn_levels(level_key, used, amplitude, level_distribution)
    else:
        assert levels is not None
        staircase = given_levels(level_key, most, levels)
    return staircase[jnp.searchsorted(ends, jnp.arange(length), side="right")]
