"""Random APRBS plans: hold times drawn, level combinations placed over the box."""

from collections.abc import Mapping
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, PRNGKeyArray

from jaxnarx.data.excitation.holds import HoldDistribution, hold_times
from jaxnarx.data.excitation.placement import latin_hypercube, sobol, uniform
from jaxnarx.data.excitation.plan import (
    AprbsPlan,
    check_limits,
    check_plan,
    reachable,
)
from jaxnarx.data.excitation.require import (
    Number,
    Pair,
    hold_range,
    member,
    span,
    whole,
)
from jaxnarx.errors import SpecError, suggest

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
    `shorten` ends where the rate takes it. Drawn on the host: not to be traced.
    """
    length = whole(length, "length")
    member(placement, PLACEMENTS, "placement")
    low, high = _borders(inputs)
    hold_key, level_key = jax.random.split(key)
    ranges = _by_name(hold, inputs, "hold")
    holds = _holds(hold_key, length, ranges, hold_distribution, together)
    used = np.sum(np.cumsum(holds, axis=0) - holds < length, axis=0)
    unit = _placed(level_key, placement, used)
    rates = _by_name(np.inf if rate is None else rate, inputs, "rate", np.inf)
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


def _by_name(given, inputs: Mapping[str, Pair], field: str, default=None) -> list:
    """One value per input, from a value for all or a mapping."""
    if not isinstance(given, Mapping):
        return [given] * len(inputs)
    for name in given:
        if name not in inputs:
            raise SpecError(
                f"{field} names {name!r}, which is no input of the plan. "
                f"{suggest(name, inputs)}",
                field=field,
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


def _placed(
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
        points[:n, i] = _restratified(points[:n, i], count)
    return points


def _restratified(
    x: Float[np.ndarray, " points"], strata: int
) -> Float[np.ndarray, " points"]:
    """Points in some of `strata` strata, moved in order to as many as there are."""
    order = np.argsort(np.argsort(x))
    return (order + np.clip(x * strata % 1, 0, 1)) / len(x)
