"""Maps optimised through models, checked on the engines they were identified from.

Virtual engines of four beds, five seeds each: a network of terms of second degree of
filtered inputs from four noisy records of 1,500 samples, or with `--models identify`
what `identify --preset quick` chooses; maps optimised over a cycle of another seed by
`jnx.calibration.optimise`, inside of the network's domain and without it; then the
engine itself runs that cycle and another one with these maps.

`vct`: a cam map of 6 x 6 points over speed and throttle; least mean NOx, mean HC no
higher, mean torque at least .99 of that with 15 degrees everywhere. `diesel`: maps of
EGR and VGT of 5 x 5 points over speed and fuel; least mean pumping pressure, which is
p_em - p_im, mean x_egr and the lowest twentieth of lambda_O no lower than with their
middle values. `gtdi`: maps of fuel and spark of 5 x 5 points over speed and throttle;
least mean fuel, mean torque no lower and the upper twentieth of AFR no higher than with
what the records have on average there. `pfi`, the one on a dynamometer: a map of fuel
of 6 x 6 points over speed and throttle; AFR near 14.6, mean torque no lower than with
what the records have on average.

Beside it:

- `with a test`: the engine runs a third cycle with the optimised maps, that record
  joins the other four, and model and maps are made anew;
- `several`: limits are kept by the model and by those that it might as well have been
  (`jnx.confidence.jackknife`);
- `best constants` by the same model, objective and limits, on a grid;
- `pointwise at rest`, as is done today: every point of the maps by itself, with the
  limits in every point;
- `CMA-ES` by the package `cma`, left out where it is not installed: the same model,
  objective, limits and domain, and 50 times the runs of the search.

    python experiments/calibration/maps.py [--beds vct diesel] [--seeds 1 2 3 4 5]

There is one file of results for every bed, written after each seed.
"""

import dataclasses
import itertools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

import jaxnarx as jnx
from jaxnarx.calibration import CalibrationSearch, NetworkPlant

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "benchmarks"), str(HERE)]
from common import record, results_folder  # noqa: E402 # pyright: ignore
from rivals import best_constants, evolve, pointwise  # noqa: E402 # pyright: ignore
from tasks import (  # noqa: E402 # pyright: ignore
    ANOTHER,
    DEMAND,
    LENGTH,
    TASKS,
    TESTED,
    TOLERATED,
    Bed,
    broken,
    read_options,
)

MORE_RUNS, FEW_RUNS = 50, 3
"""Runs of the evolution strategy over those of the search, and in a smoke test."""


def model_of(network: jnx.Network) -> tuple[NetworkPlant, Callable]:
    """The plant, and its outputs for inputs."""
    plant = NetworkPlant.of(network)
    compiled = eqx.filter_jit(lambda plant, u: plant.run(u))
    return plant, lambda u: np.asarray(compiled(plant, jax.device_put(u)))


def judge(bed: Bed, model: Callable, tables, demands: list[np.ndarray]):
    """What was promised, and what the engine did on both cycles."""
    told = bed.ratios(model, demands[0], tables)
    row: dict[str, Any] = {"promised": told.tolist()}
    for name, demand in zip(("cycle", "another"), demands, strict=True):
        true = bed.ratios(bed.run, demand, tables)
        row[name] = true.tolist()
        row[f"{name}, promise missed by"] = float(true[0] - told[0])
        row[f"{name}, limit broken by"] = broken(bed.task, true)
    return row


def bed_rows(name: str, seed: int, small: bool, models: str) -> dict[str, Any]:
    """All ways of one bed and seed."""
    inside = CalibrationSearch(rounds=2 if small else 8)
    anywhere = dataclasses.replace(inside, index=None)
    bed = Bed(TASKS[name], seed, 300 if small else LENGTH, models=models)
    network = bed.network()
    plant, model = model_of(network)
    demands = [bed.excite(DEMAND), bed.excite(ANOTHER)]
    test = bed.run(demands[0])
    error = (model(demands[0]) - test)[50:]
    rows: dict[str, Any] = {
        "NRMSE of the model": (error.std(axis=0) / test[50:].std(axis=0)).tolist()
    }
    own, cost = bed.optimise(network, demands[0], inside)
    rows["optimised"] = judge(bed, model, own, demands) | cost
    free, more = bed.optimise(network, demands[0], anywhere)
    rows["without the domain"] = judge(bed, model, free, demands) | more
    several = [network, *jnx.confidence.jackknife(network, bed.dataset()).value]
    shared, more = bed.optimise(several, demands[0], inside)
    rows["several"] = judge(bed, model, shared, demands) | more
    tested = bed.network([bed.with_maps(bed.excite(TESTED), own)])
    again, more = bed.optimise(tested, demands[0], inside)
    rows["with a test"] = judge(bed, model_of(tested)[1], again, demands) | more
    more_runs = (FEW_RUNS if small else MORE_RUNS) * cost["runs"]
    evolved = evolve(bed, network, demands[0], more_runs)
    if evolved is not None:
        rows["CMA-ES"] = judge(bed, model, evolved, demands)
    for way, tables in {
        "best constants": best_constants(bed, model, demands[0]),
        "pointwise at rest": pointwise(bed, plant, demands[0]),
    }.items():
        rows[way] = judge(bed, model, tables, demands)
    print(name, seed, rows, flush=True)
    return rows


WAYS = (
    *("optimised", "without the domain", "several", "with a test"),
    *("CMA-ES", "best constants", "pointwise at rest"),
)


def summary(seeds: dict[str, Any]) -> dict[str, Any]:
    """Medians and worst over seeds of a bed."""
    told: dict[str, Any] = {}
    for way in WAYS:
        rows = [s[way] for s in seeds.values() if way in s]
        if not rows:
            continue
        one: dict[str, Any] = {
            "objective, promised": [r["promised"][0] for r in rows],
        }
        for at in ("cycle", "another"):
            missed = [abs(r[f"{at}, promise missed by"]) for r in rows]
            over = [r[f"{at}, limit broken by"] for r in rows]
            one[at] = {
                "objective, median": float(np.median([r[at][0] for r in rows])),
                "promise missed by, median": float(np.median(missed)),
                "promise missed by, worst": float(np.max(missed)),
                "limit broken by, worst": float(np.max(over)),
                "limits kept to a percent": int(sum(o <= TOLERATED for o in over)),
            }
        told[way] = one
    return told


def main() -> None:
    """Measure and record."""
    options = read_options(__doc__, list(TASKS), 5)
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    found: dict[str, dict[str, Any]] = {}
    for seed, name in itertools.product(options.seeds, options.beds):
        rows = found.setdefault(name, {})
        rows[str(seed)] = bed_rows(name, seed, options.smoke, options.models)
        figures = {"models": options.models, "summary": summary(rows), "seeds": rows}
        record(f"calibration_{name}", figures, folder=folder)


if __name__ == "__main__":
    main()
