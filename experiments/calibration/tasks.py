"""Calibration tasks on virtual engines: what is moved, wanted, kept; data of them."""

import argparse
import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
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
)
from jaxnarx.calibration.formulas import evaluate
from jaxnarx.engines import Diesel, Gtdi, PfiDyno, Vct

TRAINED, LENGTH = 4, 1_500
"""Records that a model is made from, and samples of each and of a cycle."""
FILTERS = 1, 4, 16, 64
"""Times of the filters [samples]."""
TERMS = 40
TOLERATED = 0.01
"""Share by which a limit may be broken on an engine."""
MODELS = "quadratic", "identify"
"""Terms of second degree of filtered inputs, or what `identify` finds by `quick`."""
DEMAND, ANOTHER, TESTED = 100, 101, 102
"""Numbers of the cycle, of the other one, and of the one that is tested."""


@dataclass(frozen=True)
class Task:
    """A bed, its inputs by words, outputs that are modelled, maps and limits."""

    make: Callable[[], Any]
    every: int
    inputs: tuple[str, ...]
    outputs: dict[str, str]
    maps: dict[str, tuple[float | None, tuple[float, float]]]
    """Start and bounds of the inputs that maps set; start None: what the records have
    on average at every point."""
    over: tuple[str, str]
    points: int
    objective: Measure
    limits: tuple[CycleLimit, ...]
    grid: int
    """Values of a map's input that constants and points at rest are chosen from."""


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
    "gtdi": Task(
        make=Gtdi,
        every=4,
        inputs=("fuel", "spark", "throttle", "speed"),
        outputs={"torque": "TRQ", "AFR": "AFR"},
        maps={"fuel": (None, (9.0, 70.0)), "spark": (None, (-7.0, 32.0))},
        over=("speed", "throttle"),
        points=5,
        objective=Measure("fuel"),
        limits=(
            CycleLimit(Measure("torque"), at_least=1.0, of_start=True),
            CycleLimit(
                Measure("AFR", "percentile", share=0.95), at_most=1.0, of_start=True
            ),
        ),
        grid=12,
    ),
    "pfi": Task(
        make=PfiDyno,
        every=2,
        inputs=("throttle", "fuel", "speed"),
        outputs={"torque": "torque", "AFR": "AFR"},
        maps={"fuel": (None, (2.1, 9.4))},
        over=("speed", "throttle"),
        points=6,
        objective=Measure("AFR", "tracking", target="14.6"),
        limits=(CycleLimit(Measure("torque"), at_least=1.0, of_start=True),),
        grid=31,
    ),
}

Tables = dict[str, LookupTable]


class Bed:
    """An engine, data of it, and measures over its cycles."""

    def __init__(
        self,
        task: Task,
        seed: int,
        length: int,
        engine: Any = None,
        *,
        models: str = MODELS[0],
    ):
        self.task, self.seed, self.length, self.models = task, seed, length, models
        self.engine = task.make() if engine is None else engine
        names = list(self.engine.channels.output_names)
        self.columns = [names.index(n) for n in task.outputs.values()]
        levels = [self.engine.noise[n] for n in task.outputs.values()]
        self.absolute = np.array([n.absolute for n in levels])
        self.relative = np.array([n.relative for n in levels])
        self.step = task.every * float(self.engine.sample_time)
        self.moved = [task.inputs.index(n) for n in task.maps]
        self.over = [task.inputs.index(n) for n in task.over]

    def excite(self, number: int) -> np.ndarray:
        """The usual excitation, sample by sample."""
        key = jax.random.fold_in(jax.random.key(self.seed), number)
        u = self.engine.excite(key, self.length * self.task.every)
        return np.asarray(u)[:: self.task.every]

    def run(self, u: np.ndarray) -> np.ndarray:
        """Outputs of the engine itself, without noise."""
        held = jax.device_put(np.repeat(u, self.task.every, axis=0))
        y = np.asarray(run_engine(self.engine, held))
        return y[:: self.task.every][:, self.columns]

    def measured(self, u: np.ndarray, number: int) -> np.ndarray:
        """Outputs with the noise of this measurement."""
        y = self.run(u)
        random = np.random.default_rng([self.seed, number])
        return y + (self.absolute + self.relative * np.abs(y)) * random.normal(
            size=y.shape
        )

    def dataset(self, tested: Sequence[np.ndarray] = ()) -> jnx.Dataset:
        """Noisy records, and those of these inputs behind them."""
        u = [self.excite(n) for n in range(TRAINED)] + list(tested)
        return self.measure(dict(enumerate(u)))

    def measure(self, u: dict[int, np.ndarray]) -> jnx.Dataset:
        """Noisy records of inputs, by the numbers of the measurements."""
        return jnx.Dataset.from_arrays(
            list(u.values()),
            [self.measured(one, n) for n, one in u.items()],
            inputs=list(self.task.inputs),
            outputs=list(self.task.outputs),
            sample_time=self.step,
        )

    def network(self, tested: Sequence[np.ndarray] = ()) -> jnx.Network:
        """Identified from noisy records, with a domain."""
        data = self.dataset(tested)
        if self.models == "identify":
            found = jnx.identify(data, preset="quick").value
        else:
            found = jnx.identify(data, self.method()).value
        return jnx.confidence.fit_domain(found, data)

    def method(self) -> jnx.Identification:
        """Forty terms of second degree of inputs through filters."""
        return jnx.Identification(
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

    def cycle(self, demand: np.ndarray) -> jnx.Dataset:
        """Signals of the cycle that no map sets."""
        kept = [n for n in self.task.inputs if n not in self.task.maps]
        return jnx.Dataset.from_arrays(
            demand[:, [self.task.inputs.index(n) for n in kept]],
            np.zeros(len(demand)),
            inputs=kept,
            outputs="nothing",
            sample_time=self.step,
        )

    @functools.cached_property
    def axes(self) -> tuple[np.ndarray, ...]:
        """Points of the maps, over what the cycle visits."""
        signals = self.excite(DEMAND)[:, self.over].T
        return tuple(np.linspace(x.min(), x.max(), self.task.points) for x in signals)

    @functools.cached_property
    def start(self) -> Tables:
        """The calibration to begin with."""
        records = np.concatenate([self.excite(n) for n in range(TRAINED)])
        rows = _square(*records[:, self.over].T)
        grid = np.meshgrid(*self.axes, indexing="ij")
        points = _square(*(a.ravel() for a in grid))
        found = {}
        for (name, (value, bounds)), column in zip(
            self.task.maps.items(), self.moved, strict=True
        ):
            mean = np.full(grid[0].shape, value)
            if value is None:
                fitted = np.linalg.lstsq(rows, records[:, column], rcond=None)[0]
                mean = np.clip(points @ fitted, *bounds).reshape(grid[0].shape)
            found[name] = LookupTable(*jax.device_put((mean, self.axes)))
        return found

    def maps(self) -> dict[str, Calibratable]:
        """The maps as settings."""
        return {
            n: Calibratable(
                self.task.over,
                axes=tuple(tuple(a.tolist()) for a in self.axes),
                start=np.asarray(self.start[n].value).tolist(),
                low=low,
                high=high,
            )
            for n, (_, (low, high)) in self.task.maps.items()
        }

    def optimise(
        self,
        plant: Any,
        demand: np.ndarray,
        search: CalibrationSearch,
        limits: Sequence[CycleLimit] | None = None,
    ) -> tuple[Tables, dict[str, Any]]:
        """Maps by gradient, of one plant or several, and what their search cost."""
        begin = time.perf_counter()
        found = jnx.calibration.optimise(
            plant,
            self.cycle(demand),
            self.maps(),
            [self.task.objective],
            self.task.limits if limits is None else limits,
            search=search,
        )
        cost = {
            "status": found.status_name,
            "seconds": round(time.perf_counter() - begin, 1),
            "steps": found.stats["steps"],
            "runs": sum(row["runs"] for row in found.stats["history"]),
        }
        tables = {
            m.name: LookupTable(*jax.device_put((m.value, m.axes)))
            for m in found.value.maps
        }
        return tables, cost

    def with_maps(self, demand: np.ndarray, tables: Tables) -> np.ndarray:
        """The demand with what maps set."""
        u = demand.copy()
        signals = [jnp.asarray(demand[:, c]) for c in self.over]
        for name, column in zip(self.task.maps, self.moved, strict=True):
            u[:, column] = np.asarray(tables[name](*signals))
        return u

    def measures(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The objective and the limits' measures."""
        column = dict(zip(self.task.inputs, u.T, strict=True))
        column |= dict(zip(self.task.outputs, y.T, strict=True))
        wanted = self.task.objective, *(one.measure for one in self.task.limits)
        return np.array([_measure(m, column) for m in wanted])

    def ratios(self, run: Callable, demand: np.ndarray, tables: Tables) -> np.ndarray:
        """Measures over those of the start."""
        u, before = (self.with_maps(demand, t) for t in (tables, self.start))
        return self.measures(u, run(u)) / self.measures(before, run(before))


def read_options(about: str | None, beds: Sequence[str], seeds: int) -> Any:
    """Beds, seeds and the folder of results that a command line asks for."""
    parser = argparse.ArgumentParser(description=about)
    add = parser.add_argument
    add("--beds", nargs="+", default=list(beds))
    add("--seeds", nargs="+", type=int, default=list(range(1, seeds + 1)))
    add("--smoke", action="store_true", help="one bed, short records, few engines")
    add("--models", choices=MODELS, default=MODELS[0])
    add("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    if options.smoke:
        options.beds, options.seeds = options.beds[:1], options.seeds[:1]
    return options


@eqx.filter_jit
def run_engine(engine: Any, u: Any) -> Any:
    """Outputs of an engine, event by event."""
    return engine.run(u)


def broken(task: Task, ratios: np.ndarray) -> float:
    """The largest share by which a limit is broken."""
    over = [
        one.sign * (r / one.number - 1.0)
        for one, r in zip(task.limits, ratios[1:], strict=True)
    ]
    return float(max(over))


def _square(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Terms of second degree of two signals."""
    return np.stack([np.ones_like(a), a, b, a * b, a**2, b**2], axis=1)


def _measure(m: Measure, column: dict[str, np.ndarray]) -> float:
    x = np.asarray(evaluate(m.of, column.__getitem__))
    if m.kind == "percentile":
        return float(np.quantile(x, m.share))
    if m.kind == "tracking":
        aim = np.asarray(evaluate(m.target, column.__getitem__))
        return float(np.sqrt(np.mean((x - aim) ** 2)))
    return float(x.mean())
