"""An APRBS over several inputs as a value: drawn at random, checked, adjusted."""

from collections.abc import Mapping
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxnarx.checks import (
    Number,
    Pair,
    choice,
    require_known,
    span,
    whole,
)
from jaxnarx.errors import SpecError
from jaxnarx.excitation.placement import latin_hypercube, sobol, uniform
from jaxnarx.excitation.staircases import HoldDistribution, hold_range, hold_times


class AprbsPlan(eqx.Module):
    """Levels and hold times of an APRBS, per segment and input, with their limits.

    Input i starts at `level[0, i]`; at the start of segment k it leaves for
    `level[k, i]`, moving by at most `rate[i]` per sample, and stays there until
    `hold[k, i]` samples since the start of the segment are over. Each input has its own
    hold times. The last segment lasts to the end; what starts after `length` samples
    has no effect.

    `level`, `low` and `high` are in the units of the inputs, `rate` in units per sample
    (infinite: no limit), `hold` and `length` in samples. Shapes are checked when it is
    made, values by `check_plan`.
    """

    level: Float[Array, "segments inputs"]
    hold: Int[Array, "segments inputs"]
    rate: Float[Array, " inputs"]
    low: Float[Array, " inputs"]
    high: Float[Array, " inputs"]
    length: int = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)

    def __check_init__(self):
        whole(self.length, "length")
        segments, inputs = self.level.shape
        if not segments or not inputs or len(self.names) != inputs:
            raise SpecError(
                f"a plan needs segments and inputs and a name for each input, got "
                f"levels of shape {self.level.shape} and names {self.names}",
                field="names",
            )

    @property
    def start(self) -> Int[Array, "segments inputs"]:
        """First sample of each segment."""
        return jnp.cumsum(self.hold, axis=0) - self.hold

    @property
    def used(self) -> Bool[Array, "segments inputs"]:
        """Whether a segment begins before the end of the plan."""
        return self.start < self.length


@eqx.filter_jit
def render(plan: AprbsPlan) -> Float[Array, "time inputs"]:
    """The plan as a signal, in the units of the inputs.

    With s the start of segment k and x_k the value at its end, the sample t is
    x_{k-1} + clip(level_k - x_{k-1}, -r, r), r = rate (t - s + 1): piecewise linear in
    time and in the levels. The slope limit holds for any levels, also those it cannot
    reach within their hold; the range holds if all levels are in it. Pure: goes through
    `jit`, `vmap` and `grad` with respect to `level` and `rate`.
    """
    return jax.vmap(_render, (1, 1, 0, None), 1)(
        plan.level, plan.hold, plan.rate, plan.length
    )


@eqx.filter_jit
def reachable(plan: AprbsPlan) -> AprbsPlan:
    """The plan with levels moved into range, then to what the rate reaches in the hold.

    Segment by segment from the first, so the result is `feasible`; a feasible plan
    comes back as it is. Serves a projected gradient. Pure.
    """
    level = jnp.clip(plan.level, plan.low[None], plan.high[None])
    level = jax.vmap(_end_values, (1, 1, 0), 1)(level, plan.hold, plan.rate)
    return eqx.tree_at(lambda p: p.level, plan, level)


def feasible(plan: AprbsPlan) -> Bool[Array, ""]:
    """Whether every used level is in range and reached within its hold. Pure.

    Up to rounding: eight units in the last place of the larger border.
    """
    inside, in_time = _quantise(plan)
    return jnp.all(inside & in_time)


def check_limits(plan: AprbsPlan) -> None:
    """SpecError unless borders are ordered and finite, rates and holds positive."""
    low, high, rate = (np.asarray(x) for x in (plan.low, plan.high, plan.rate))
    for i, name in enumerate(plan.names):
        span((float(low[i]), float(high[i])), name)
        if not rate[i] > 0:
            raise SpecError(
                f"the rate limit of {name!r} must be above zero, in units per sample, "
                f"got {rate[i]}",
                field="rate",
            )
    if np.min(np.asarray(plan.hold)) < 1:
        raise SpecError("every hold must be at least one sample", field="hold")


def check_plan(plan: AprbsPlan) -> None:
    """SpecError unless the plan can be run as it stands; names input and segment.

    Levels must be finite and in range, and every step must be completed within its
    hold. Segments after the end are not looked at. Not to be traced.
    """
    check_limits(plan)
    inside, in_time = (np.asarray(x) for x in _quantise(plan))
    for k, i in np.argwhere(~inside):
        raise SpecError(
            f"level of input {plan.names[i]!r} in segment {k} is "
            f"{plan.level[k, i]:g}, outside its range {plan.low[i]:g} to "
            f"{plan.high[i]:g}",
            field="level",
        )
    for k, i in np.argwhere(~in_time):
        raise SpecError(_too_fast(plan, int(k), int(i)), field="rate")


def _too_fast(plan: AprbsPlan, k: int, i: int) -> str:
    hold, rate = int(plan.hold[k, i]), float(plan.rate[i])
    step = abs(float(plan.level[k, i]) - float(plan.level[k - 1, i]))
    widest = float(plan.high[i]) - float(plan.low[i])
    return (
        f"input {plan.names[i]!r}, segment {k}: a step of {step:g} within its hold of "
        f"{hold} samples needs a rate of {step / hold:g} per sample, the limit is "
        f"{rate:g}. Hold for at least {np.ceil(step / rate):.0f} samples "
        f"({np.ceil(widest / rate):.0f} are enough for any step in the range), allow "
        "a higher rate, narrow the range, or have such steps shortened"
    )


@eqx.filter_jit
def _quantise(
    plan: AprbsPlan,
) -> tuple[Bool[Array, "segments inputs"], Bool[Array, "segments inputs"]]:
    """Levels in range, and steps completed in their hold; what is unused counts as so.

    One compiled program, as eager operations would each be compiled for every shape.
    """
    low, high, level = plan.low[None], plan.high[None], plan.level
    slack = 8 * jnp.finfo(level.dtype).eps * jnp.maximum(jnp.abs(low), jnp.abs(high))
    inside = (level >= low - slack) & (level <= high + slack)
    step = jnp.abs(jnp.diff(level, axis=0, prepend=level[:1]))
    reach = plan.rate[None] * plan.hold.astype(plan.rate.dtype)
    return inside | ~plan.used, (step <= reach + slack) | ~plan.used


def _end_values(
    level: Float[Array, " segments"],
    hold: Int[Array, " segments"],
    rate: Float[Array, ""],
) -> Float[Array, " segments"]:
    """Value at the end of each segment."""

    def segment(now, target):
        level, reach = target
        # where, not now + clip(...): what is reached is reached to the last bit.
        near = jnp.abs(level - now) <= reach
        now = jnp.where(near, level, now + jnp.clip(level - now, -reach, reach))
        return now, now

    reach = rate * hold.astype(level.dtype)
    return jax.lax.scan(segment, level[0], (level, reach))[1]


def _render(
    level: Float[Array, " segments"],
    hold: Int[Array, " segments"],
    rate: Float[Array, ""],
    length: int,
) -> Float[Array, " time"]:
    ends = _end_values(level, hold, rate)
    before = jnp.concatenate([level[:1], ends[:-1]])
    time = jnp.arange(length, dtype=hold.dtype)
    start = jnp.cumsum(hold) - hold
    # Counting the starts is five times faster than searching for them; by `cumsum` it
    # would take XLA half a minute to fold when the hold times are constants.
    begins = jnp.zeros(length, hold.dtype).at[start].add(1, mode="drop")
    k = jax.lax.associative_scan(jnp.add, begins) - 1
    room = rate * (time - start[k] + 1).astype(level.dtype)
    gap = level[k] - before[k]
    near = jnp.abs(gap) <= room
    return jnp.where(near, level[k], before[k] + jnp.sign(gap) * room)


Placement = Literal["latin", "sobol", "uniform"]
PLACEMENTS = ("latin", "sobol", "uniform")


def aprbs_plan(
    key: PRNGKeyArray,
    length: int,
    *,
    inputs: Mapping[str, Pair],
    hold: tuple[int, int] | Mapping[str, tuple[int, int]],
    rate: Number | Mapping[str, Number] | None = None,
    placement: Placement = "latin",
    hold_distribution: HoldDistribution = "uniform",
    together: bool = False,
    shorten: bool = False,
) -> AprbsPlan:
    """A random plan of `length` samples whose level combinations fill the box evenly.

    `inputs` maps names to (low, high) in their units. `hold` is (shortest, longest) in
    samples, for all inputs or by name, drawn as in `hold_times`; `together` makes all
    inputs switch at the same samples, so that exactly the placed combinations are
    visited. `rate` limits the slope, in units per sample, for all inputs or by name;
    what it does not name is free.

    The k-th levels are the k-th point of the `placement`: "latin" visits each of an
    input's strata once, as many strata as it has segments; "sobol" (scrambled) fills
    gaps as it goes; "uniform" draws independently.

    A step that the rate cannot complete within its hold is a SpecError, or with
    `shorten` ends where the rate takes it. The plan is drawn on the host and cannot be
    traced.
    """
    length = whole(length, "length")
    choice(placement, PLACEMENTS, "placement")
    low, high = _borders(inputs)
    hold_key, level_key = jax.random.split(key)
    ranges = _values_by_input(hold, inputs, "hold")
    holds = _holds(hold_key, length, ranges, hold_distribution, together)
    used = np.sum(np.cumsum(holds, axis=0) - holds < length, axis=0)
    unit = _place_points(level_key, placement, used)
    rates = _values_by_input(np.inf if rate is None else rate, inputs, "rate", np.inf)
    plan = AprbsPlan(
        level=jnp.asarray(low + (high - low) * unit, float),
        hold=jnp.asarray(holds[: len(unit)]),
        rate=jnp.asarray([float(r) for r in rates], float),
        low=jnp.asarray(low, float),
        high=jnp.asarray(high, float),
        length=length,
        names=tuple(inputs),
    )
    check_limits(plan)
    plan = reachable(plan) if shorten else plan
    check_plan(plan)
    return plan


def _borders(inputs: Mapping[str, Pair]) -> tuple[np.ndarray, np.ndarray]:
    if not inputs:
        raise SpecError("a plan needs at least one input", field="inputs")
    pairs = np.array([span(pair, name) for name, pair in inputs.items()])
    return pairs[:, 0], pairs[:, 1]


def _values_by_input(
    given, inputs: Mapping[str, Pair], field: str, default=None
) -> list:
    """One value per input, from a value for all or a mapping."""
    if not isinstance(given, Mapping):
        return [given] * len(inputs)
    for name in given:
        require_known(
            name,
            inputs,
            field,
            f"{field} names {name!r}, which is no input of the plan",
        )
    missing = [name for name in inputs if name not in given]
    if missing and default is None:
        raise SpecError(f"{field} lacks an entry for {missing[0]!r}", field=field)
    return [given.get(name, default) for name in inputs]


def _holds(
    key: PRNGKeyArray,
    length: int,
    ranges: list[tuple[int, int]],
    distribution: HoldDistribution,
    together: bool,
) -> Int[np.ndarray, "segments inputs"]:
    ranges = [hold_range(r) for r in ranges]
    if together and len(set(ranges)) > 1:
        raise SpecError(
            f"inputs that switch together need the same hold, got {ranges}",
            field="hold",
        )
    most = max(-(-length // shortest) for shortest, _ in ranges)
    keys = jax.random.split(key, len(ranges))
    keys = [keys[0]] * len(ranges) if together else list(keys)
    columns = [
        np.asarray(hold_times(k, most, hold=r, distribution=distribution))
        for k, r in zip(keys, ranges, strict=True)
    ]
    return np.stack(columns, axis=-1)


def _place_points(
    key: PRNGKeyArray, placement: Placement, used: Int[np.ndarray, " inputs"]
) -> Float[np.ndarray, "segments inputs"]:
    """Points of the unit cube, as many as the input that switches most often needs."""
    count = int(used.max())
    low, high = np.zeros(len(used)), np.ones(len(used))
    if placement == "sobol":
        return np.asarray(sobol(count, low, high, key=key))
    if placement == "uniform":
        return np.asarray(uniform(key, count, low, high))
    points = np.array(latin_hypercube(key, count, low, high))
    for i, n in enumerate(used):
        points[:n, i] = _restratify(points[:n, i], count)
    return points


def _restratify(
    x: Float[np.ndarray, " points"], strata: int
) -> Float[np.ndarray, " points"]:
    """Points in some of `strata` strata, moved in order to as many as there are."""
    order = np.argsort(np.argsort(x))
    return (order + np.clip(x * strata % 1, 0, 1)) / len(x)
