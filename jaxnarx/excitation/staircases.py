"""Random staircases: hold times and levels, APRBS, binary sequences, random walks."""

import math
from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxnarx.checks import (
    Number,
    Pair,
    choice,
    finite,
    positive,
    require,
    span,
    whole,
)
from jaxnarx.errors import SpecError

HoldDistribution = Literal["uniform", "geometric", "log-uniform"]
HOLD_DISTRIBUTIONS = ("uniform", "geometric", "log-uniform")

_CUT_SHARE = 0.05


def hold_range(hold: tuple[int, int]) -> tuple[int, int]:
    """(shortest, longest) in samples, 1 <= shortest <= longest."""
    shortest, longest = (whole(h, "hold") for h in hold)
    require(
        shortest <= longest,
        "hold",
        "hold must be (shortest, longest) in samples with 1 <= shortest <= longest, "
        f"got {hold}",
    )
    return shortest, longest


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
    choice(distribution, HOLD_DISTRIBUTIONS, "hold_distribution")
    if distribution == "uniform":
        return jax.random.randint(key, (count,), shortest, longest + 1)
    u = jax.random.uniform(key, (count,), float)
    if distribution == "geometric":
        scale = (longest + 1 - shortest) / -jnp.log(_CUT_SHARE)
        exact = shortest - scale * jnp.log1p(-u * (1 - _CUT_SHARE))
    else:
        exact = shortest * ((longest + 1) / shortest) ** u
    # Rounding may put u next to one onto longest + 1.
    return jnp.clip(jnp.floor(exact).astype(int), shortest, longest)


LevelDistribution = Literal["uniform", "latin", "arcsine"]
LEVEL_DISTRIBUTIONS = ("uniform", "latin", "arcsine")


def draw_levels(
    key: PRNGKeyArray,
    used: Bool[Array, " segments"],
    amplitude: Pair,
    distribution: LevelDistribution = "uniform",
) -> Float[Array, " segments"]:
    """A level in `amplitude` for every segment; those not `used` have no meaning.

    "uniform": independent, all levels equally likely. "latin": the range is cut into as
    many equal strata as there are used segments, and each is visited once, in random
    order. "arcsine": low + (high - low) sin^2(pi u / 2) with u uniform, the amplitude
    distribution of a sine: a fifth of the levels lie in the lowest tenth of the range
    and a fifth in the highest, where a polynomial is determined worst.
    """
    low, high = span(amplitude, "amplitude")
    choice(distribution, LEVEL_DISTRIBUTIONS, "level_distribution")
    if distribution == "uniform":
        return jax.random.uniform(key, used.shape, float, low, high)
    if distribution == "arcsine":
        u = jax.random.uniform(key, used.shape, float)
        return low + (high - low) * jnp.sin(math.pi / 2 * u) ** 2
    order_key, within_key = jax.random.split(key)
    u = jnp.where(used, jax.random.uniform(order_key, used.shape, float), jnp.inf)
    stratum = jnp.argsort(jnp.argsort(u)).astype(u.dtype)
    within = jax.random.uniform(within_key, used.shape, float)
    share = (stratum + within) / jnp.sum(used).astype(u.dtype)
    return low + (high - low) * jnp.minimum(share, 1.0)


def repeat_levels(
    key: PRNGKeyArray, count: int, levels: Sequence[Number]
) -> Float[Array, " segments"]:
    """`count` of `levels`, in rounds: each once in random order, then each again."""
    if not len(levels):
        raise SpecError("levels must hold at least one number", field="levels")
    values = jnp.asarray([finite(v, "levels") for v in levels], float)
    keys = jax.random.split(key, -(-count // len(values)))
    rounds = jax.vmap(jax.random.permutation, (0, None))(keys, values)
    return rounds.ravel()[:count]


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
    `draw_levels`. `levels` instead of `amplitude` gives the levels themselves: all of
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
        staircase = draw_levels(level_key, used, amplitude, level_distribution)
    else:
        assert levels is not None
        staircase = repeat_levels(level_key, most, levels)
    return staircase[jnp.searchsorted(ends, jnp.arange(length), side="right")]


LARGEST_ORDER = 24


def prbs(
    length: int,
    *,
    amplitude: Pair,
    clock: int = 1,
    order: int | None = None,
    shift: int = 0,
) -> Float[Array, " time"]:
    """Maximum-length binary sequence between the two levels `amplitude`.

    The register of `order` n moves every `clock` samples, so a period has
    clock (2^n - 1) samples; the longest hold is n clocks. Without `order`, the smallest
    whose period is not shorter than `length`. `shift`, in clocks, begins later in the
    sequence: the same sequence shifted by a part of a period is a nearly uncorrelated
    second input. Deterministic.

    With m the middle and a half the distance of the levels, the autocorrelation of
    (x - m) / a over a full period is 1 at multiples of the period and -1 / (2^n - 1) at
    all other multiples of the clock. Power is flat up to about 0.44 / clock cycles per
    sample. Two levels cannot show a nonlinearity: use `aprbs` for that.

    Reference: S. W. Golomb, Shift Register Sequences, 1967; L. Ljung, System
    Identification, 2nd edition, 1999, section 13.3.
    """
    from scipy.signal import max_len_seq

    low, high = span(amplitude, "amplitude")
    length, clock = whole(length, "length"), whole(clock, "clock")
    ticks = -(-length // clock)
    order = max(2, ticks.bit_length()) if order is None else whole(order, "order", 2)
    if order > LARGEST_ORDER:
        raise SpecError(
            f"order must be from 2 to {LARGEST_ORDER}, got {order}", field="order"
        )
    shift = whole(shift, "shift", 0) % (2**order - 1)
    bits = max_len_seq(order, length=shift + ticks)[0][shift:]
    return jnp.repeat(jnp.where(bits, high, low).astype(float), clock)[:length]


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
    walk = _reflect(start - low + jnp.cumsum(moves), high - low)
    return jnp.repeat(jnp.clip(low + walk, low, high), hold)[:length]


def _reflect(x: Float[Array, " time"], width: float) -> Float[Array, " time"]:
    """`x` reflected at 0 and at `width` until it lies between."""
    if width == 0:
        return jnp.zeros_like(x)
    return width - jnp.abs(jnp.mod(x, 2 * width) - width)
