"""Other ways to maps: best constants, points at rest, an evolution strategy."""

import importlib
import importlib.util
import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from tasks import Bed, Tables, broken

import jaxnarx as jnx
from jaxnarx.calibration import CalibrationSearch, LookupTable, NetworkPlant
from jaxnarx.calibration.problem import (
    CalibrationProblem,
    begin_numbers,
    place_numbers,
    run_cycle,
)
from jaxnarx.calibration.setup import add_levels, join_plants, make_problem

POPULATION = 16
STEP = 0.2
"""First deviation of the evolution strategy, of the range."""
PRICE = 1000.0
"""Of the largest share by which a limit is broken, in shares of the objective: more
than any limit of the tasks costs (their multipliers are up to some ten)."""


def best_constants(bed: Bed, model: Callable, demand: np.ndarray) -> Tables:
    """One number for each map, added to its start, of least objective that keeps the
    limits, on a grid."""
    best, found = np.inf, bed.start
    ranges = []
    for name, (_, bounds) in bed.task.maps.items():
        middle = float(np.mean(np.asarray(bed.start[name].value)))
        ranges.append(np.linspace(*bounds, bed.task.grid) - middle)
    for values in itertools.product(*ranges):
        tables = {}
        for (name, (_, bounds)), more in zip(
            bed.task.maps.items(), values, strict=True
        ):
            start = bed.start[name]
            tables[name] = LookupTable(
                jnp.clip(start.value + more, *bounds), start.axes
            )
        r = bed.ratios(model, demand, tables)
        if broken(bed.task, r) <= 1e-3 and r[0] < best:
            best, found = r[0], tables
    return found


def pointwise(bed: Bed, plant: NetworkPlant, demand: np.ndarray) -> Tables:
    """Every point by itself: the least objective at rest that keeps limits there, on a
    grid; the start where nothing keeps them."""
    task = bed.task
    ranges = [np.linspace(*b, task.grid) for _, b in task.maps.values()]
    choices = np.array(list(itertools.product(*ranges)))
    run = jax.jit(jax.vmap(lambda row: plant.run(jnp.tile(row[None], (2, 1)))[-1]))
    start = np.stack([np.asarray(t.value) for t in bed.start.values()], axis=-1)
    found = start.copy()
    for i, j in itertools.product(*(range(len(a)) for a in bed.axes)):
        values = np.vstack([start[i, j], choices])
        rows = np.tile(np.median(demand, axis=0), (len(values), 1))
        rows[:, bed.over] = bed.axes[0][i], bed.axes[1][j]
        rows[:, bed.moved] = values
        y = np.asarray(run(jax.device_put(rows)))
        told = np.array(
            [bed.measures(u[None], one[None]) for u, one in zip(rows, y, strict=True)]
        )
        ratio = told / np.where(np.abs(told[:1]) > 1e-9, told[:1], 1e-9)
        fine = np.array([broken(task, r) <= 1e-3 for r in ratio])
        best = np.argmin(np.where(fine, told[:, 0], np.inf))
        found[i, j] = values[best] if fine.any() else start[i, j]
    axes = jax.device_put(bed.axes)
    return {
        n: LookupTable(jnp.asarray(found[..., k]), axes)
        for k, n in enumerate(task.maps)
    }


def evolve(
    bed: Bed, network: jnx.Network, demand: np.ndarray, runs: int
) -> Tables | None:
    """The same task by CMA-ES with so many runs (N. Hansen, A. Ostermeier, Evol.
    Comput. 9, 2001), limits by a penalty; None where `cma` is not installed."""
    if importlib.util.find_spec("cma") is None:
        return None
    problem = as_problem(bed, network, demand)
    start, unravel = ravel_pytree(begin_numbers(problem)[0])

    @jax.jit
    def judge(problem: CalibrationProblem, rows: Any) -> Any:
        def one(row):
            merit = problem.merit(unravel(row))
            worst = jnp.max(merit.inequalities, initial=0.0)
            value = merit.objective + PRICE * worst
            return jnp.where(jnp.isfinite(value), value, 1e6)

        return jax.vmap(one)(rows)

    settings = {"bounds": [0, 1], "popsize": POPULATION, "seed": 1, "verbose": -9}
    settings |= {"maxfevals": runs, "tolfun": 0, "tolx": 0, "tolflatfitness": 1000}
    search = importlib.import_module("cma").CMAEvolutionStrategy(
        np.asarray(start), STEP, settings
    )
    while not search.stop():
        rows = search.ask()
        search.tell(rows, np.asarray(judge(problem, np.array(rows))).tolist())
    best = unravel(jnp.asarray(search.result.xbest))
    return dict(zip(bed.task.maps, place_numbers(problem, best), strict=True))


def as_problem(bed: Bed, network: jnx.Network, demand: np.ndarray) -> Any:
    """The task as arrays, as `jnx.calibration.optimise` makes it."""
    task = bed.task
    problem = make_problem(
        *join_plants(network, 1),
        bed.cycle(demand),
        bed.maps(),
        [task.objective],
        task.limits,
        CalibrationSearch(),
    )
    return add_levels(problem, run_cycle(problem, tuple(m.start for m in problem.maps)))
