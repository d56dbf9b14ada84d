"""Maps optimised through models, checked on the engines they were identified from.

Virtual engines of two beds, five seeds each: a network of terms of second degree of
filtered inputs from four noisy records of 1,500 samples; maps optimised over a cycle of
another seed by `jnx.calibration.optimise`, inside of the network's domain and without
it; then the engine itself runs that cycle and another one with these maps.

`vct`: a cam map of 6 x 6 points over speed and throttle; least mean NOx, mean HC no
higher, mean torque at least .99 of that with 15 degrees everywhere. `diesel`: maps of
EGR and VGT of 5 x 5 points over speed and fuel; least mean pumping pressure, which is
p_em - p_im, mean x_egr and the lowest twentieth of lambda_O no lower than with their
middle values.

Beside it the best constants by the same model, objective and limits (a grid), and what
is done today: every point of the maps by itself, at rest, on a grid, with the limits in
every point.

    python experiments/calibration/maps.py [--beds vct diesel] [--seeds 1 2 3 4 5]
"""

import argparse
import itertools
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxnarx as jnx
from jaxnarx.calibration import (
    Calibratable,
    CalibrationSearch,
    CycleLimit,
    LookupTable,
    Measure,
    NetworkPlant,
)
from jaxnarx.calibration.formulas import evaluate
from jaxnarx.engines import Diesel, Vct

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
from common import record, results_folder  # noqa: E402 # pyright: ignore

TRAINED, LENGTH, CYCLE = 4, 1_500, 1_500
FILTERS = 1, 4, 16, 64
"""Times of the filters [samples]."""
TERMS = 40
TOLERATED = 0.01
"""Share by which a limit may be broken on the engine."""


@dataclass(frozen=True)
class Task:
    """A bed, its inputs by words, outputs that are modelled, maps and limits."""

    make: Callable[[], Any]
    every: int
    inputs: tuple[str, ...]
    outputs: dict[str, str]
    maps: dict[str, tuple[float, tuple[float, float]]]
    """Start and bounds of the inputs that maps set."""
    over: tuple[str, str]
    points: int
    objective: Measure
    limits: tuple[CycleLimit, ...]
    grid: int


TASKS = {
    "vct": Task(
        make=Vct,
        every=4,
        inputs=("throttle", "cam", "ratio", "speed"),
        outputs={"torque": "torque", "NOx": "NOx", "HC": "HC"},
        maps={"cam": (15.0, (0.0, 30.0))},
        over=("speed", "throttle"),
        points=6,
        objective=Measure("NOx"),
        limits=(
            CycleLimit(Measure("HC"), at_most=1.0, of_start=True),
            CycleLimit(Measure("torque"), at_least=0.99, of_start=True),
        ),
        grid=31,
    ),
    "diesel": Task(
        make=Diesel,
        every=2,
        inputs=("fuel", "EGR", "VGT", "speed"),
        outputs={"p_im": "p_im", "p_em": "p_em", "x_egr": "x_egr", "lam": "lambda_O"},
        maps={"EGR": (30.0, (10.0, 55.0)), "VGT": (50.0, (32.0, 72.0))},
        over=("speed", "fuel"),
        points=5,
        objective=Measure("p_em - p_im"),
        limits=(
            CycleLimit(Measure("x_egr"), at_least=1.0, of_start=True),
            CycleLimit(
                Measure("lam", "percentile", share=0.05), at_least=1.0, of_start=True
            ),
        ),
        grid=12,
    ),
}


class Bed:
    """An engine, what it says, and data of it."""

    def __init__(self, task: Task, seed: int, length: int):
        self.task, self.seed, self.engine = task, seed, task.make()
        names = list(self.engine.channels.output_names)
        self.columns = [names.index(n) for n in task.outputs.values()]
        levels = [self.engine.noise[n] for n in task.outputs.values()]
        self.absolute = np.array([n.absolute for n in levels])
        self.relative = np.array([n.relative for n in levels])
        self.step = task.every * float(self.engine.sample_time)
        self.length = length
        self._run = eqx.filter_jit(lambda engine, u: engine.run(u))

    def excite(self, number: int) -> np.ndarray:
        """The usual excitation, sample by sample."""
        key = jax.random.fold_in(jax.random.key(self.seed), number)
        u = self.engine.excite(key, self.length * self.task.every)
        return np.asarray(u)[:: self.task.every]

    def run(self, u: np.ndarray) -> np.ndarray:
        """Outputs of the engine itself, without noise."""
        held = jax.device_put(np.repeat(u, self.task.every, axis=0))
        y = np.asarray(self._run(self.engine, held))
        return y[:: self.task.every][:, self.columns]

    def network(self) -> jnx.Network:
        """Identified from noisy records."""
        random = np.random.default_rng(self.seed)
        u = [self.excite(n) for n in range(TRAINED)]
        y = [self.run(one) for one in u]
        y = [
            one
            + (self.absolute + self.relative * np.abs(one))
            * random.normal(size=one.shape)
            for one in y
        ]
        data = jnx.Dataset.from_arrays(
            u,
            y,
            inputs=list(self.task.inputs),
            outputs=list(self.task.outputs),
            sample_time=self.step,
        )
        method = jnx.Identification(
            pool=jnx.Polynomial(
                outputs=list(self.task.outputs),
                input_lags=(0, 1),
                output_lags=(),
                degree=2,
                filters=tuple(self.step * n for n in FILTERS),
            ),
            select=jnx.ForwardOLS(max_terms=TERMS),
            refine=None,
        )
        found = jnx.identify(data, method).value
        return jnx.confidence.fit_domain(found, data)

    def with_maps(self, demand: np.ndarray, tables: dict[str, LookupTable]):
        """The demand with what maps set."""
        u = demand.copy()
        signals = [demand[:, self.task.inputs.index(s)] for s in self.task.over]
        for name, table in tables.items():
            where = signals if table.axes else []
            u[:, self.task.inputs.index(name)] = np.asarray(
                table(*map(jnp.asarray, where))
            )
        return u

    def measures(self, y: np.ndarray) -> np.ndarray:
        """The objective and the limits' measures of outputs."""
        column = {n: y[:, k] for k, n in enumerate(self.task.outputs)}
        found = []
        for m in (self.task.objective, *(one.measure for one in self.task.limits)):
            x = np.asarray(evaluate(m.of, column.__getitem__))
            found.append(
                np.quantile(x, m.share) if m.kind == "percentile" else x.mean()
            )
        return np.array(found)

    def start(self) -> dict[str, LookupTable]:
        """The calibration to begin with."""
        return {n: LookupTable(jnp.asarray(v)) for n, (v, _) in self.task.maps.items()}

    def ratios(self, run: Callable, demand: np.ndarray, tables) -> np.ndarray:
        """Measures over those of the start."""
        after, before = (
            self.measures(run(self.with_maps(demand, t)))
            for t in (tables, self.start())
        )
        return after / before


def broken(task: Task, ratios: np.ndarray) -> float:
    """The largest share by which a limit is broken."""
    over = [
        one.sign * (r / one.number - 1.0)
        for one, r in zip(task.limits, ratios[1:], strict=True)
    ]
    return float(max(over))


def judged(
    bed: Bed, model: Callable, tables, demands: list[np.ndarray]
) -> dict[str, Any]:
    """What was promised, and what the engine did on both cycles."""
    told = bed.ratios(model, demands[0], tables)
    row: dict[str, Any] = {"promised": told.tolist()}
    for name, demand in zip(("cycle", "another"), demands, strict=True):
        true = bed.ratios(bed.run, demand, tables)
        row[name] = true.tolist()
        row[f"{name}, promise missed by"] = float(true[0] - told[0])
        row[f"{name}, limit broken by"] = broken(bed.task, true)
    return row


def best_constants(
    bed: Bed, model: Callable, demand: np.ndarray
) -> dict[str, LookupTable]:
    """The constants of least objective that keep the limits, on a grid."""
    best, found = np.inf, bed.start()
    ranges = [np.linspace(*b, bed.task.grid) for _, b in bed.task.maps.values()]
    for values in itertools.product(*ranges):
        tables = {
            n: LookupTable(jnp.asarray(v))
            for n, v in zip(bed.task.maps, values, strict=True)
        }
        r = bed.ratios(model, demand, tables)
        if broken(bed.task, r) <= 1e-3 and r[0] < best:
            best, found = r[0], tables
    return found


def pointwise(
    bed: Bed, plant: NetworkPlant, axes: tuple[np.ndarray, ...], demand: np.ndarray
) -> dict[str, LookupTable]:
    """Every point by itself: the least objective at rest that keeps limits there."""
    task = bed.task
    ranges = [np.linspace(*b, task.grid) for _, b in task.maps.values()]
    values = np.array(list(itertools.product(*ranges)))
    values = np.vstack([[v for v, _ in task.maps.values()], values])
    run = jax.jit(jax.vmap(lambda row: plant.run(jnp.tile(row[None], (2, 1)))[-1]))
    found = np.zeros((len(axes[0]), len(axes[1]), len(task.maps)))
    for i, j in itertools.product(range(len(axes[0])), range(len(axes[1]))):
        rows = np.tile(np.median(demand, axis=0), (len(values), 1))
        for s, at in zip(task.over, (axes[0][i], axes[1][j]), strict=True):
            rows[:, task.inputs.index(s)] = at
        for k, n in enumerate(task.maps):
            rows[:, task.inputs.index(n)] = values[:, k]
        y = np.asarray(run(jax.device_put(rows)))
        told = np.array([bed.measures(one[None]) for one in y])
        ratio = told / np.where(np.abs(told[:1]) > 1e-9, told[:1], 1e-9)
        fine = np.array([broken(task, r) <= 1e-3 for r in ratio])
        objective = np.where(fine, told[:, 0], np.inf)
        best = int(np.argmin(objective)) if fine.any() else 0
        found[i, j] = values[best]
    points = tuple(map(jnp.asarray, axes))
    return {
        n: LookupTable(jnp.asarray(found[..., k]), points)
        for k, n in enumerate(task.maps)
    }


def bed_rows(name: str, seed: int, small: bool) -> dict[str, Any]:
    """All ways of one bed and seed."""
    task = TASKS[name]
    bed = Bed(task, seed, 300 if small else CYCLE)
    network = bed.network()
    plant = NetworkPlant.of(network)
    compiled = eqx.filter_jit(lambda plant, u: plant.run(u))

    def model(u: np.ndarray) -> np.ndarray:
        return np.asarray(compiled(plant, jax.device_put(u)))

    demands = [bed.excite(100), bed.excite(101)]
    test = bed.run(demands[0])
    error = (model(demands[0]) - test)[50:]
    rows: dict[str, Any] = {
        "NRMSE of the model": (error.std(axis=0) / test[50:].std(axis=0)).tolist()
    }
    kept = [n for n in task.inputs if n not in task.maps]
    cycle = jnx.Dataset.from_arrays(
        demands[0][:, [task.inputs.index(n) for n in kept]],
        np.zeros(len(demands[0])),
        inputs=kept,
        outputs="nothing",
        sample_time=bed.step,
    )
    maps = {
        n: Calibratable(
            task.over, size=(task.points,) * 2, start=v, low=b[0], high=b[1]
        )
        for n, (v, b) in task.maps.items()
    }
    axes: tuple[np.ndarray, ...] = ()
    for way, index in (("optimised", 1.0), ("without the domain", None)):
        search = CalibrationSearch(index=index, rounds=2 if small else 8)
        begin = time.perf_counter()
        found = jnx.calibration.optimise(
            network, cycle, maps, [task.objective], task.limits, search=search
        )
        seconds = time.perf_counter() - begin
        axes = found.value.maps[0].axes
        tables = {
            m.name: LookupTable(jnp.asarray(m.value), tuple(map(jnp.asarray, m.axes)))
            for m in found.value.maps
        }
        rows[way] = judged(bed, model, tables, demands) | {
            "status": found.status_name,
            "seconds": round(seconds, 1),
            "steps": found.stats["steps"],
        }
    constants = best_constants(bed, model, demands[0])
    rows["best constants"] = judged(bed, model, constants, demands)
    rows["pointwise at rest"] = judged(
        bed, model, pointwise(bed, plant, axes, demands[0]), demands
    )
    print(name, seed, rows, flush=True)
    return rows


WAYS = "optimised", "without the domain", "best constants", "pointwise at rest"


def summary(found: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Medians and worst over seeds."""
    told: dict[str, Any] = {}
    for name, seeds in found.items():
        for way in WAYS:
            rows = [s[way] for s in seeds.values()]
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
            told[f"{name}, {way}"] = one
    return told


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beds", nargs="+", default=list(TASKS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--smoke", action="store_true", help="one bed, short records")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    chosen, seeds = options.beds, options.seeds
    if options.smoke:
        chosen, seeds = chosen[:1], seeds[:1]
    found = {
        name: {str(seed): bed_rows(name, seed, options.smoke) for seed in seeds}
        for name in chosen
    }
    record("calibration", {"summary": summary(found), "beds": found}, folder=folder)


if __name__ == "__main__":
    main()
