"""The verb `optimise`: maps of a control unit, optimised through the free run."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import Progress
from jaxnarx.calibration.problem import begin_numbers, place_numbers, run_cycle
from jaxnarx.calibration.result import Calibration
from jaxnarx.calibration.rounds import MapSearch
from jaxnarx.calibration.setup import (
    add_levels,
    begin_there,
    join_plants,
    make_problem,
)
from jaxnarx.calibration.summary import describe, ignored_maps, summarise
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.settings import Calibratable, CalibrationSearch, CycleLimit, Measure
from jaxnarx.solution import RESULTS, Solution


@guard_arguments
def optimise(
    plant: Any,
    cycle: Dataset,
    maps: Mapping[str, Calibratable],
    objective: Sequence[Measure],
    limits: Sequence[CycleLimit] = (),
    *,
    search: CalibrationSearch | None = None,
    every: int = 1,
    begin: Calibration | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Solution[Calibration]:
    """Maps, curves and scalars of a control unit, optimised over a cycle.

    Minimises a weighted sum of measures of the free run, each over its value with the
    calibration to begin with, under limits, by gradients through the run: an augmented
    Lagrangian with L-BFGS-B (`CalibrationSearch`). A network with a domain is kept
    where it knows the plant. Peaks are smooth in the search, and true in what is told.

    Args:
        plant: A network that computes all outputs it looks at, a virtual engine, or a
            `FunctionPlant`. Or a list of several of one structure, such as draws of a
            fleet (`jnx.fleet.draw_engines`): the objective is their mean, limits must
            be kept by the share `search.draws` of them.
        cycle: Records with every input of the plant that no map sets, and with signals
            that maps or measures look at; at the plant's sample time. Every row counts.
        maps: What sets which input, by the input's name.
        objective: What is to be small.
        limits: What must be kept.
        search: Settings of the search.
        every: Events of a virtual engine in one sample.
        begin: A calibration of the same maps from which the search sets out; what it is
            measured by stays that of `maps`.
        folder: Folder that keeps where the search stands after every round: the same
            call goes on there.
        progress: A function called after every round with `round` and how many there
            are at most (`of`), `objective`, `worst`, the largest share by which a limit
            is broken, and `steps`.

    Returns:
        `value` is the `Calibration`. `stats`: `rounds`, `steps`, `history`, `ignored`,
        maps on which no measure depends. Status `ok`; `budget_spent` where the last
        round still gained; `no_improvement` where nothing is better than the maps that
        the search sets out from, which are returned;
        `infeasible` where limits cannot all be kept: `value` then breaks them least,
        and `detail` says by how much each would have to give; `start_diverged` where
        the cycle diverges with the calibration to begin with.

    Raises:
        SpecError: maps, measures or signals that make no sense.
        DataError: a signal of the cycle that has no number somewhere.

    Example:
        free = {"a": jnx.calibration.Calibratable(over=("time",), size=(4,))}
        wanted = [jnx.calibration.Measure("y ** 2")]
        found = jnx.calibration.optimise(network, data, free, wanted)
        print(found.value)
    """
    search = CalibrationSearch() if search is None else search
    if not maps:
        raise SpecError("a calibration needs at least one map", field="maps")
    if not objective:
        raise SpecError("a calibration needs an objective", field="objective")
    joined, draws, network = join_plants(plant, every)
    problem = make_problem(
        joined, draws, network, cycle, maps, objective, limits, search
    )
    begun = tuple(m.start for m in problem.maps)
    before = run_cycle(problem, begun)
    problem = add_levels(problem, before)
    told = list(maps), cycle, network, before
    if not np.all(np.isfinite(np.asarray(before.y))):
        nothing = np.zeros(problem.conditions)
        value = summarise(problem, *told, begun, nothing)
        text = "with the calibration to begin with the cycle diverges"
        return Solution(value, RESULTS.start_diverged, {}, text)
    if begin is None:
        free = begin_numbers(problem)[0]
    else:
        free = begin_there(problem, list(maps), begin)
    run = MapSearch(problem, search, free, folder, progress)
    status = run.run()
    tables = place_numbers(problem, run.best)
    value = summarise(problem, *told, tables, run.multipliers)
    stats: dict[str, Any] = {
        "rounds": run.rounds,
        "steps": run.steps,
        "history": run.history,
        "ignored": ignored_maps(value),
    }
    detail = describe(value, run.merit[0])
    if status is RESULTS.no_improvement:
        detail = f"nothing better was found; {detail}"
    return Solution(value, status, stats, detail)
