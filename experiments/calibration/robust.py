"""Maps for a whole fleet: robust over engines drawn from a population, and nominal.

Virtual engines of two beds with every parameter off by about a tenth: 48 donors with
one noisy record of 1,500 samples each tell the population (`jnx.fleet.learn`). The maps
of `tasks.py` are optimised over a cycle for the mean engine (`nominal`), for 16 engines
drawn from the population (`robust`: each limit is to be kept by .95 of them), and
`robust, with a margin`, limits tighter by twice the tolerated percent. Then 32 other
engines run the cycle and another one: how many break a limit by more than a percent of
their own start.

    python experiments/calibration/robust.py [--beds vct pfi] [--seeds 1 2 3]

The results are written after every bed and seed.
"""

import dataclasses
import itertools
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxnarx as jnx
from jaxnarx.calibration import CalibrationSearch, CycleLimit
from jaxnarx.engines import family

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "benchmarks"), str(HERE)]
from common import record, results_folder  # noqa: E402 # pyright: ignore
from tasks import (  # noqa: E402 # pyright: ignore
    ANOTHER,
    DEMAND,
    LENGTH,
    TASKS,
    TOLERATED,
    Bed,
    broken,
    read_options,
)

BEDS = "vct", "pfi"
DONORS, DRAWN, JUDGED, SPREAD = 48, 16, 32, 0.1
MARGIN = 2 * TOLERATED
FIRST_RECORD = 1000
"""Number of the excitation of the first donor."""


class Donors(Mapping[str, jnx.Dataset]):
    """Records of engines by name, each made when it is asked for."""

    def __init__(self, members: list[Bed]):
        self.members = {f"engine {n}": bed for n, bed in enumerate(members)}

    def __len__(self) -> int:
        return len(self.members)

    def __iter__(self):
        return iter(self.members)

    def __getitem__(self, name: str) -> jnx.Dataset:
        bed, number = self.members[name], FIRST_RECORD + int(name.split()[1])
        return bed.measure({number: bed.excite(number)})


def make_engines(name: str, seed: int, count: int, length: int) -> list[Bed]:
    """Beds of engines whose parameters are off."""
    task = TASKS[name]
    drawn = family(task.make(), jax.random.key(seed), count, spread=SPREAD)
    return [
        Bed(task, seed, length, jax.tree.map(lambda a, n=n: a[n], drawn))
        for n in range(count)
    ]


def tighten(limit: CycleLimit, margin: float) -> CycleLimit:
    """A limit whose number is tighter by a margin."""
    side = "at_most" if limit.at_most is not None else "at_least"
    return dataclasses.replace(limit, **{side: limit.number - limit.sign * margin})


def judge(nominal: Bed, sisters: list[Bed], tables: Any) -> dict[str, Any]:
    """The change of measures by the maps, on other engines, over two cycles."""
    told: dict[str, Any] = {}
    for name, number in (("cycle", DEMAND), ("another", ANOTHER)):
        demand = nominal.excite(number)
        ratios = [
            nominal.measures(u := nominal.with_maps(demand, tables), one.run(u))
            / nominal.measures(
                before := nominal.with_maps(demand, nominal.start), one.run(before)
            )
            for one in sisters
        ]
        over = np.array([broken(nominal.task, r) for r in ratios])
        objective = np.array([r[0] for r in ratios])
        told[name] = {
            "objective, median": float(np.median(objective)),
            "objective, worst": float(objective.max()),
            "break a limit": float(np.mean(over > TOLERATED)),
            "limit broken by, worst": float(over.max()),
        }
    return told


def bed_rows(name: str, seed: int, small: bool, models: str) -> dict[str, Any]:
    """All ways of one bed and seed."""
    donors, drawn, count = (6, 2, 2) if small else (DONORS, DRAWN, JUDGED)
    length = 200 if small else LENGTH
    search = CalibrationSearch(rounds=1 if small else 8)
    engines = make_engines(name, seed, donors + count, length)
    nominal = Bed(TASKS[name], seed, length, models=models)
    network = nominal.network()
    prior = jnx.fleet.learn(Donors(engines[:donors]), network).value
    several = jnx.fleet.draw_engines(prior, drawn, seed=seed)
    rows: dict[str, Any] = {}
    for way, plant, margin in (
        ("nominal", prior.network, 0.0),
        ("robust", several, 0.0),
        ("robust, with a margin", several, MARGIN),
    ):
        limits = [tighten(one, margin) for one in nominal.task.limits]
        demand = nominal.excite(DEMAND)
        tables, cost = nominal.optimise(plant, demand, search, limits)
        rows[way] = judge(nominal, engines[donors:], tables) | cost
    print(name, seed, rows, flush=True)
    return rows


def summary(found: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Means of shares over seeds, and the median objective."""
    told: dict[str, Any] = {}
    for name, seeds in found.items():
        for way in next(iter(seeds.values())):
            for at in ("cycle", "another"):
                rows = [s[way][at] for s in seeds.values()]
                told[f"{name}, {way}, {at}"] = {
                    key: float(np.mean([r[key] for r in rows])) for key in rows[0]
                }
    return told


def main() -> None:
    """Measure and record."""
    options = read_options(__doc__, BEDS, 3)
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    found: dict[str, dict[str, Any]] = {}
    for seed, name in itertools.product(options.seeds, options.beds):
        rows = bed_rows(name, seed, options.smoke, options.models)
        found.setdefault(name, {})[str(seed)] = rows
        figures = {
            "models": options.models,
            "summary": summary(found),
            "beds": found,
        }
        record("calibration_robust", figures, folder=folder)


if __name__ == "__main__":
    main()
