"""Given courses: steps, ramps and a driving cycle, and the limits of an actuator."""

import math
from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.checks import Number, choice, finite, positive, whole
from jaxnarx.errors import SpecError


def steps(levels: Sequence[Number], *, hold: int) -> Float[Array, " time"]:
    """Each of `levels` in turn, for `hold` samples."""
    return jnp.repeat(jnp.asarray(_finite(levels), float), whole(hold, "hold"))


def ramps(
    levels: Sequence[Number],
    *,
    rate: Number | Sequence[Number],
    hold: int,
    sample_time: Number,
) -> Float[Array, " time"]:
    """Each of `levels` in turn, reached in a straight line and held for `hold` samples.

    `rate` is the slope in units of the input per second, one number, or one for each of
    the ramps; `sample_time` in s. The sample j of a ramp has moved by
    j rate sample_time, the last by what is left; it begins the hold. The length of the
    signal follows from the rates. A slow ramp shows a steady-state characteristic in
    one sweep, for quasi-stationary measurement.
    """
    values = _finite(levels)
    hold = whole(hold, "hold")
    slopes = [rate] * (len(values) - 1) if isinstance(rate, int | float) else list(rate)
    if len(slopes) != len(values) - 1:
        raise SpecError(
            f"rate must be one number or one for each of the {len(values) - 1} ramps, "
            f"got {len(slopes)}",
            field="rate",
        )
    each = [positive(r, "rate") * positive(sample_time, "sample_time") for r in slopes]
    pieces = [np.full(hold, values[0])]
    for start, end, slope in zip(values[:-1], values[1:], each, strict=True):
        count = max(int(np.ceil(abs(end - start) / slope * (1 - 1e-12))), 1)
        moved = np.minimum(slope * np.arange(1, count), abs(end - start))
        pieces += [start + np.sign(end - start) * moved, np.full(hold, end)]
    return jnp.asarray(np.concatenate(pieces), float)


def _finite(levels: Sequence[Number]) -> list[float]:
    if not len(levels):
        raise SpecError("levels must hold at least one number", field="levels")
    return [finite(v, "levels") for v in levels]


Phase = Literal["urban", "extra-urban"]

_COURSE_CORNERS = {
    "urban": (
        *((0, 0), (11, 0), (15, 15), (23, 15), (25, 10), (28, 0), (49, 0), (54, 15)),
        *((56, 15), (61, 32), (85, 32), (93, 10), (96, 0), (117, 0), (122, 15)),
        *((124, 15), (133, 35), (135, 35), (143, 50), (155, 50), (163, 35), (176, 35)),
        *((178, 32), (185, 10), (188, 0), (195, 0)),
    ),
    "extra-urban": (
        *((0, 0), (20, 0), (25, 15), (27, 15), (36, 35), (38, 35), (46, 50), (48, 50)),
        *((61, 70), (111, 70), (119, 50), (188, 50), (201, 70), (251, 70), (286, 100)),
        *((316, 100), (336, 120), (346, 120), (362, 80), (370, 50), (380, 0), (400, 0)),
    ),
}
"""Time [s] and speed [km/h] between which the speed is a straight line."""
WHOLE_COURSE: tuple[Phase, ...] = ("urban", "urban", "urban", "urban", "extra-urban")


def driving_cycle(
    *,
    sample_time: Number,
    phases: Sequence[Phase] = WHOLE_COURSE,
) -> Float[Array, " time"]:
    """Vehicle speed in km/h at 0, sample_time [s], ... over `phases` in turn.

    Without `phases` the whole cycle: four times the urban phase of 195 s (ECE 15, about
    1 km each) and the extra-urban one of 400 s (EUDC, about 7 km, up to 120 km/h), 1180
    s together. The last sample is at its end or less than `sample_time` before.

    Reference: UN/ECE Regulation No. 83, annex 4a, tables 1 and 2; gears are left out.
    """
    step = positive(sample_time, "sample_time")
    times, speeds, end = [0.0], [0.0], 0.0
    for phase in phases:
        corners = np.array(
            _COURSE_CORNERS[choice(phase, _COURSE_CORNERS, "phases")], float
        )
        times += (end + corners[1:, 0]).tolist()
        speeds += corners[1:, 1].tolist()
        end = times[-1]
    count = int(end / step * (1 + 1e-12)) + 1
    return jnp.asarray(np.interp(np.arange(count) * step, times, speeds), float)


def limit_slope(
    signal: Float[Array, " time"],
    *,
    rate: Number | None = None,
    low: Number | None = None,
    high: Number | None = None,
    sample_time: Number | None = None,
) -> Float[Array, " time"]:
    """Limit the range and the slope of `signal`, as an actuator does that follows it.

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


ROADS = {"urban": (0.0, 60.0), "rural": (60.0, 90.0), "motorway": (90.0, 145.0)}
"""Vehicle speeds of a road [km/h]."""
_STANDING_SHARE = 0.25
"""Share of the urban speeds that are stops."""
_ACCELERATIONS = 0.3, 1.3
"""Least and largest acceleration, and deceleration, of a random drive [m/s2]."""
_HOLDS = 4.0, 40.0
"""Shortest and longest time for which a speed is held [s]."""


def random_drive(
    key: PRNGKeyArray,
    *,
    sample_time: Number,
    duration: Number,
    shares: tuple[Number, Number, Number] = (0.34, 0.33, 0.33),
) -> Float[Array, " time"]:
    """Vehicle speed in km/h of a random drive: town, then country roads, then motorway.

    Each takes its share of `duration` [s]. On a road speeds are drawn evenly from its
    range (in town every fourth is a stop), held for 4 to 40 s, and reached with 0.3 to
    1.3 m/s2, up or down; the drive begins and ends at rest. That is the shape of a test
    of real driving emissions, not one that its trip requirements would accept:
    Regulation (EU) 2017/1151, annex IIIA, section 6 (speeds of 60 and 90 km/h part the
    roads; about a third of the distance each).
    """
    step, end = positive(sample_time, "sample_time"), positive(duration, "duration")
    if len(shares) != 3 or min(shares) < 0 or sum(shares) <= 0:
        raise SpecError(
            "shares must be three numbers from zero on, not all zero, for town, "
            f"country and motorway, got {shares}",
            field="shares",
        )
    ends = end * np.cumsum(shares) / sum(shares)
    # As many as there can be: the shortest hold, and no time to change the speed.
    count = math.ceil(end / _HOLDS[0])
    keys = jax.random.split(key, 4)
    level, hold, ramp, stop = (jax.random.uniform(k, (count,), float) for k in keys)
    low, high = jnp.asarray(list(ROADS.values()), float).T

    def reach(now, drawn):
        time, speed = now
        level, hold, ramp, stop = drawn
        road = jnp.minimum(jnp.searchsorted(ends, time, side="right"), len(low) - 1)
        standing = (road == 0) & (stop < _STANDING_SHARE)
        aim = jnp.where(standing, 0.0, low[road] + level * (high - low)[road])
        pace = 3.6 * (
            _ACCELERATIONS[0] + ramp * (_ACCELERATIONS[1] - _ACCELERATIONS[0])
        )
        there = time + jnp.abs(aim - speed) / pace
        left = there + _HOLDS[0] + hold * (_HOLDS[1] - _HOLDS[0])
        return (left, aim), jnp.stack([there, left, aim])

    start = jnp.zeros(2)
    rows = jax.lax.scan(reach, (start[0], start[1]), (level, hold, ramp, stop))[1]
    times = jnp.concatenate([start[:1], rows[:, :2].ravel()])
    speeds = jnp.concatenate([start[:1], jnp.repeat(rows[:, 2], 2)])
    at = jnp.asarray(np.arange(int(end / step * (1 + 1e-12)) + 1) * step, float)
    brake = 3.6 * _ACCELERATIONS[1] * (at[-1] - at)
    return jnp.minimum(jnp.interp(at, times, speeds), brake)
