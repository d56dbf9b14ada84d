"""From plants, records and settings to the arrays of a calibration, checked."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.calibration.formulas import signals_of
from jaxnarx.calibration.plants import AbstractPlant, NetworkPlant, as_plant
from jaxnarx.calibration.problem import (
    CalibrationProblem,
    CycleRun,
    DemandCycle,
    FreeNumbers,
    MovedMap,
    domain_indices,
    measure_run,
)
from jaxnarx.calibration.result import Calibration
from jaxnarx.calibration.tables import LookupTable
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.formatting import list_names
from jaxnarx.models import Network
from jaxnarx.settings import TIME, Calibratable, CycleLimit, Measure

AXIS_POINTS = 8
"""Points of an axis where nothing is said."""
SCALE_SHARE = 0.2
"""Share of a measure's value at the start that a limit is measured by at least."""


def join_plants(given: Any, every: int) -> tuple[AbstractPlant, int, Network | None]:
    """One plant, or several of the same structure with a leading axis; and the first
    one's network."""
    several = given if isinstance(given, list | tuple) else [given]
    if not several:
        raise SpecError("a calibration needs a plant", field="plant")
    plants = [as_plant(one, every) for one in several]
    first = plants[0]
    network = first.network if isinstance(first, NetworkPlant) else None
    if len(plants) == 1:
        return first, 1, network
    shapes = [[getattr(a, "shape", None) for a in jax.tree.leaves(p)] for p in plants]
    if any(type(p) is not type(first) for p in plants) or any(
        s != shapes[0] for s in shapes
    ):
        raise SpecError(
            "several plants must be of one structure, such as engines of one fleet",
            field="plant",
        )
    structure = jax.tree.structure(first)
    rows = [jax.tree.leaves(p) for p in plants]
    stacked = [
        jnp.stack([jnp.asarray(a) for a in leaves])
        for leaves in zip(*rows, strict=True)
    ]
    return jax.tree.unflatten(structure, stacked), len(plants), network


def make_cycle(
    plant: AbstractPlant,
    data: Dataset,
    maps: Mapping[str, Calibratable],
    asked: Sequence[str],
) -> DemandCycle:
    """The signals that the plant needs or that are asked for; SpecError where one is
    missing, DataError where one has no number."""
    if not math.isclose(data.sample_time, plant.sample_time, rel_tol=1e-6):
        raise SpecError(
            f"the cycle has a sample every {data.sample_time:g} s, the plant every "
            f"{plant.sample_time:g} s; `jaxnarx prepare` resamples records",
            field="cycle",
        )
    columns = [*data.channels.input_names, *data.channels.output_names]
    known = {*columns, *plant.inputs, *plant.outputs, TIME}
    unknown = [s for s in asked if s not in known]
    if unknown:
        raise SpecError(
            f"there is no signal {list_names(unknown)}; there are "
            + list_names(sorted(known)),
            field="maps",
        )
    needed = [n for n in plant.inputs if n not in maps]
    own = {*plant.outputs, *maps}
    needed += [s for s in asked if s not in own]
    missing = [n for n in needed if n not in (*columns, TIME)]
    if missing:
        raise SpecError(
            f"the cycle has no {list_names(list(dict.fromkeys(missing)))}, and no map "
            "sets it",
            field="cycle",
        )
    names = [n for n in dict.fromkeys(needed) if n != TIME]
    longest = max(len(r) for r in data)
    values, counted = [], np.zeros((len(data), longest), bool)
    for n, r in enumerate(data):
        table = np.concatenate([r.u, r.y], axis=1)[:, [columns.index(c) for c in names]]
        bad = np.argwhere(~np.isfinite(table))
        if len(bad):
            row, column = bad[0].tolist()
            raise DataError(
                f"{names[column]} has no number in row {row + 1} of "
                f"{r.name or 'the cycle'}; a cycle needs one in every row"
            )
        counted[n, : len(r)] = True
        time = np.arange(longest)[:, None] * data.sample_time
        table = np.pad(table, ((0, longest - len(r)), (0, 0)), mode="edge")
        values.append(np.concatenate([table, time], axis=1))
    scored = np.flatnonzero(counted.ravel())
    return DemandCycle((*names, TIME), *jax.device_put((np.stack(values), scored)))


def require_inputs(maps: Mapping[str, Calibratable], inputs: Sequence[str]) -> None:
    """SpecError where a map sets none of the inputs."""
    for name in maps:
        if name not in inputs:
            raise SpecError(
                f"{name} is none of the plant's inputs, {list_names(list(inputs))}",
                field="maps",
            )


def make_map(
    name: str,
    given: Calibratable,
    plant: AbstractPlant,
    cycle: DemandCycle,
    network: Network | None,
) -> MovedMap:
    """The arrays of a calibratable."""
    low, high = _bounds(name, given, network)
    axes = tuple(
        _axis(name, given, n, plant, cycle, network) for n in range(len(given.over))
    )
    shape = tuple(len(a) for a in axes)
    start = (low + high) / 2 if given.start is None else given.start
    start = np.asarray(start, float)
    if start.shape not in ((), shape):
        raise SpecError(
            f"the start of {name} has the shape {start.shape}, its axes {shape}",
            field="start",
        )
    start = np.broadcast_to(start, shape).copy()
    if not np.all(np.isfinite(start)) or np.any((start < low) | (start > high)):
        raise SpecError(
            f"the start of {name} must lie within its bounds, {low:g} to {high:g}",
            field="start",
        )
    least, most = np.full(shape, low), np.full(shape, high)
    if given.away is not None:
        least = np.maximum(least, start - given.away)
        most = np.minimum(most, start + given.away)
    steps = tuple(given.steps) or (math.inf,) * len(shape)
    slopes = tuple((s in given.rises) - (s in given.falls) for s in given.over)
    arrays = jax.device_put((start, axes, least, most))
    start, axes, least, most = arrays
    return MovedMap(
        plant.inputs.index(name),
        tuple(given.over),
        LookupTable(start, axes),
        least,
        most,
        steps,
        slopes,
        given.move_axes and bool(axes),
    )


def _bounds(
    name: str, given: Calibratable, network: Network | None
) -> tuple[float, float]:
    low, high = given.low, given.high
    if network is not None:
        at = network.channels.input_names.index(name)
        low = float(network.low[at]) if low is None else low
        high = float(network.high[at]) if high is None else high
    if low is None or high is None or not low < high:
        raise SpecError(
            f"{name} needs bounds, low below high, got {low} and {high}", field="low"
        )
    return float(low), float(high)


def _axis(
    name: str,
    given: Calibratable,
    n: int,
    plant: AbstractPlant,
    cycle: DemandCycle,
    network: Network | None,
) -> Float[np.ndarray, " points"]:
    """Points of one signal: those given, or over what the cycle visits."""
    if given.axes:
        return np.asarray(given.axes[n], float)
    signal = given.over[n]
    points = given.size[n] if given.size else AXIS_POINTS
    if signal in plant.outputs:
        if network is None:
            raise SpecError(
                f"{name} goes over {signal}, an output: its points must be given",
                field="axes",
            )
        at = network.signals[plant.outputs.index(signal)]
        low, high = float(network.low[at]), float(network.high[at])
    else:
        seen = np.asarray(cycle.signal(signal))
        low, high = float(seen.min()), float(seen.max())
    if not high > low:
        raise SpecError(
            f"{signal} does not change in the cycle, so that no map over it can be "
            f"found; give the points of {name}, or another signal",
            field="over",
        )
    return np.linspace(low, high, points)


def make_problem(
    plant: AbstractPlant,
    draws: int,
    network: Network | None,
    data: Dataset,
    maps: Mapping[str, Calibratable],
    objective: Sequence[Measure],
    limits: Sequence[CycleLimit],
    search: Any,
) -> CalibrationProblem:
    """The problem, with levels and numbers of limits of one: the verb sets them."""
    require_inputs(maps, plant.inputs)
    asked = signals_of(maps, objective, limits)
    cycle = make_cycle(plant, data, maps, asked)
    moved = tuple(
        make_map(name, one, plant, cycle, network) for name, one in maps.items()
    )
    kind = cycle.values.dtype
    domain = None if network is None or search.index is None else network.domain
    count = len(limits)
    return CalibrationProblem(
        plant,
        draws,
        cycle,
        moved,
        tuple(objective),
        tuple(limits),
        search,
        jnp.ones(len(objective), kind),
        jnp.ones((count, draws), kind),
        jnp.ones(count, kind),
        domain,
    )


def add_levels(problem: CalibrationProblem, before: CycleRun) -> CalibrationProblem:
    """The problem with the values of the start: of the objective and of limits, and the
    index of the domain."""
    found = measure_run(problem, before)
    wanted, kept = np.asarray(found.objective).mean(axis=1), np.asarray(found.limits)
    level = np.where(np.abs(wanted) > 0, np.abs(wanted), 1.0)
    number = np.ones_like(kept)
    for n, one in enumerate(problem.limits):
        number[n] = one.number * (kept[n] if one.of_start else 1.0)
    size = np.maximum(np.abs(number), SCALE_SHARE * np.abs(kept)).mean(axis=1)
    index = None
    if problem.domain is not None:
        own = np.asarray(domain_indices(problem, before.u[:1]))[0]
        index = np.maximum(own, problem.search.index or np.inf)
    leaves = jax.device_put((level, number, np.where(size > 0, size, 1.0), index))
    level, number, size, index = leaves
    return dataclasses.replace(
        problem, level=level, limit=number, scale=size, index=index
    )


def begin_there(
    problem: CalibrationProblem, names: list[str], begin: Calibration
) -> tuple[FreeNumbers, ...]:
    """The free numbers of an earlier calibration of the same maps."""
    there = {m.name: m for m in begin.maps}
    found = []
    for name, m in zip(names, problem.maps, strict=True):
        one = there.get(name)
        if one is None or one.value.shape != m.start.value.shape:
            raise SpecError(f"begin has no map of {name} as large", field="begin")
        low, high = np.asarray(m.low), np.asarray(m.high)
        share = np.clip((one.value - low) / (high - low), 0.0, 1.0)
        gaps = [np.log(np.diff(a)) for a in one.axes] if m.move_axes else []
        found.append(FreeNumbers(*jax.device_put((share, tuple(gaps)))))
    return tuple(found)
