"""Predictive control of virtual engines by networks that were identified from them.

Two beds, five seeds each. A network of cubic terms, refined in the free run as the
forward network of chapter 7 of the thesis (`experiments/thesis`), or with
`--models identify` what `identify --preset quick` chooses, is made from six noisy
records; a seventh tells the observer about its errors. The engine
itself is then steered: references are the outputs of another record, without noise, so
that they can be reached; sensors are noisy. `gtdi`, at a sample of 60 ms: torque and
lambda by spark and throttle with the fuel as recorded, beside the inverse network of
chapter 7 as a feedforward, which is trained on the same records and drives the same
engine after the same references (chapter 7 itself, with other records, has recorded
.06 and .18 to .24); or by fuel and throttle with the spark as recorded, without a limit
and with the manifold pressure below the largest twentieth of the references' own. Fuel
is commanded as its inverse, of which lambda is linear. `pfi`: speed by the duty of the
bypass valve.

Beside the engine that the records come from stand engines with every parameter off by
about a tenth; and steps of constant references that can be reached within the limits,
of which the error that is left before the next step is foreseen counts, in standard
deviations of the references. Without a preview the controller knows references and
other inputs of the present alone. With `--tuned` a second controller has efforts that
`jnx.control.tune_effort` finds against the networks of the jackknife, over the
references of the record left out.

    python experiments/control/tracking.py [--beds gtdi pfi] [--seeds 1 2 3 4 5]
        [--models identify] [--tuned]
"""

import argparse
import functools
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
from jaxnarx.calibration import AbstractPlant, EnginePlant
from jaxnarx.control import Command, Controller, OutputLimit
from jaxnarx.engines import Gtdi, Pfi

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "benchmarks"), str(HERE.parent / "thesis")]
import inverse_bench  # noqa: E402 # pyright: ignore
import inverse_models  # noqa: E402 # pyright: ignore
from common import record, results_folder  # noqa: E402 # pyright: ignore
from inverse_bed import INPUTS, OUTPUTS  # noqa: E402 # pyright: ignore
from inverse_bed import excite as excite_gtdi  # noqa: E402 # pyright: ignore

TRAINED, LENGTH = 6, 2_000
"""Records that a network is made from, and samples of each."""
SPREAD, SISTERS = 0.1, 4
NAMES = {"cubic": "control_tracking", "identify": "control_tracking_identified"}
"""Results by models."""
FORWARD, EVENTS = "spark and throttle", 4
"""The task of chapter 7's feedforward, and events of a sample there."""
HOLD, JUDGED, COUNT = 300, 100, 10
"""Samples of a constant reference, those that are judged, the last before the horizon
reaches the next one, and how many references there are."""
DRAWN = 4
"""References that are drawn for each that is used, if limits leave it."""
SKIPPED = 20
"""Samples at the begin of a run that do not count."""
BELOW = 0.95
"""Share of the references' own values that lie below the limit."""


class FuelByItsInverse(AbstractPlant):
    """The turbocharged engine with 1000/fuel for its fuel, and lambda for its AFR."""

    plant: EnginePlant
    inputs: tuple[str, ...] = eqx.field(
        static=True, default=("LEAN", "SA", "THR", "speed")
    )
    outputs: tuple[str, ...] = eqx.field(static=True, default=("TRQ", "lambda", "MAP"))
    sample_time: float = eqx.field(static=True, default=0.06)

    def run(self, u):
        return self.plant.run(u.at[:, 0].set(1000 / u[:, 0])) * UNIT[None]

    def begin(self, u):
        state, y = self.plant.begin(u.at[0].set(1000 / u[0]))
        return state, y * UNIT

    def step(self, state, u):
        state, y = self.plant.step(state, u.at[0].set(1000 / u[0]))
        return state, y * UNIT


UNIT = np.array([1.0, 1 / 14.6, 1.0])


@dataclass(frozen=True)
class Bed:
    """An engine, how it is excited, and what is to be done with it."""

    make: Callable[[], Any]
    plant: Callable[[Any], AbstractPlant]
    excite: Callable[[Any, int], np.ndarray]
    noise: dict[str, float]
    tasks: dict[str, tuple[dict[str, Command], tuple[str, ...], str | None]]
    """Commands, targets, and the output that is limited."""
    horizon: int = 20
    """Samples that are looked ahead."""


def gtdi_inputs(key: Any, length: int) -> np.ndarray:
    """Random steps, fuel follows the air; a row a sample."""
    u = np.asarray(excite_gtdi(key, length))[::4].copy()
    u[:, 0] = 1000 / u[:, 0]
    return u


def pfi_inputs(key: Any, length: int) -> np.ndarray:
    """Random steps of the duty."""
    return np.asarray(Pfi().excite(key, 2 * length))[::2]


BEDS = {
    "gtdi": Bed(
        make=Gtdi,
        plant=lambda engine: FuelByItsInverse(plant=EnginePlant.of(engine, 4)),
        excite=gtdi_inputs,
        noise={"TRQ": 0.4, "lambda": 0.03 / 14.6, "MAP": 0.3},
        tasks={
            "spark and throttle": (
                {"SA": Command(), "THR": Command()},
                ("TRQ", "lambda"),
                None,
            ),
            "fuel and throttle": (
                {"LEAN": Command(), "THR": Command()},
                ("TRQ", "lambda"),
                "MAP",
            ),
        },
    ),
    "pfi": Bed(
        make=Pfi,
        plant=lambda engine: EnginePlant.of(engine, 2),
        excite=pfi_inputs,
        noise={"speed": 2.5, "MAP": 0.3},
        tasks={"duty": ({"duty": Command()}, ("speed",), "MAP")},
        horizon=60,
    ),
}


class Bench:
    """Records of an engine, and a network of them."""

    def __init__(self, bed: Bed, seed: int, length: int, models: str = "cubic"):
        self.bed, self.seed, self.length, self.models = bed, seed, length, models
        self.plant = bed.plant(bed.make())
        every = [self.record(n, noise=1.0) for n in range(TRAINED + 1)]
        self.train, self.left = self.data(every[:-1]), self.data(every[-1:])
        self.network = jnx.confidence.fit_domain(self.fit(), self.train)

    @functools.cached_property
    def others(self) -> list[jnx.Network]:
        """Networks that this one might as well have been."""
        return jnx.confidence.jackknife(self.network, self.train).value

    def record(self, number: int, *, noise: float) -> tuple[np.ndarray, np.ndarray]:
        """Inputs and outputs of an excitation."""
        key = jax.random.fold_in(jax.random.key(self.seed), number)
        u = self.bed.excite(key, self.length)
        y = np.asarray(run_plant(self.plant, jnp.asarray(u)))
        levels = [noise * self.bed.noise[n] for n in self.plant.outputs]
        random = np.random.default_rng([self.seed, number])
        return u, y + random.normal(size=y.shape) * np.array(levels)[None]

    def data(self, pairs: list[tuple[np.ndarray, np.ndarray]]) -> jnx.Dataset:
        """A dataset of such records."""
        return jnx.Dataset.from_arrays(
            [u for u, _ in pairs],
            [y for _, y in pairs],
            inputs=list(self.plant.inputs),
            outputs=list(self.plant.outputs),
            sample_time=self.plant.sample_time,
        )

    def fit(self) -> jnx.Network:
        """Cubic terms, refined, or what the search finds."""
        if self.models == "identify":
            return jnx.identify(self.train, preset="quick").value
        train, guard = self.train[:-1], self.train[-1:]
        own: dict[str, Any] = {"lags": inverse_models.DEEP, "every": self.train}
        return inverse_models.forward_of(train, guard, **own)

    def errors(self) -> dict[str, float]:
        """NRMSE of the free run over the record left out."""
        run = jnx.simulate(self.network, self.left).value
        (record,) = self.left.records
        names, wide = self.network.output_names, record.y.std(axis=0)
        left = np.sqrt(np.mean((record.y - run.outputs[0])[100:] ** 2, axis=0)) / wide
        return dict(zip(names, left.tolist(), strict=True))


@eqx.filter_jit
def run_plant(plant: AbstractPlant, u: Any) -> Any:
    """A run from rest."""

    def take(state, row):
        return plant.step(state, row)

    return jax.lax.scan(take, plant.begin(u[0])[0], u)[1]


def levels(bench: Bench, plant: AbstractPlant, controller: Controller) -> jnx.Dataset:
    """Inputs that are held, and where the outputs of a plant come to rest under them:
    references that it can reach without leaving the controller's limits."""
    u, _ = bench.record(100, noise=0.0)
    random = np.random.default_rng(bench.seed)
    smooth = np.stack([_smooth(c) for c in u.T], axis=1)
    drawn = smooth[random.choice(len(u), DRAWN * COUNT)]
    y = np.asarray(run_plant(plant, jnp.asarray(np.repeat(drawn, HOLD, axis=0))))
    ends = y[HOLD - 1 :: HOLD]
    names = [controller.network.output_names[o] for o in controller.bounded]
    at = [bench.plant.outputs.index(n) for n in names]
    most = np.asarray(controller.ceiling - controller.guard)
    within = np.flatnonzero(np.all(ends[:, at] <= most, axis=1))[:COUNT]
    held, rest = (np.repeat(a[within], HOLD, axis=0) for a in (drawn, ends))
    return bench.data([(held, rest)])


def feedforward(bench: Bench, wanted: jnx.Dataset) -> dict[str, float]:
    """Tracking by the inverse network of chapter 7, without feedback."""

    def renamed(data: jnx.Dataset) -> jnx.Dataset:
        return jnx.Dataset.from_arrays(
            [np.column_stack([1000 / r.u[:, 0], r.u[:, 1:], r.u[:, 0]]) for r in data],
            [r.y for r in data],
            inputs=list(INPUTS),
            outputs=list(OUTPUTS),
            sample_time=data.sample_time,
        )

    every, asked = renamed(bench.train), renamed(wanted)
    train, guard = every[:-1], every[-1:]
    inverse = inverse_models.inverse_of(train, guard)[1]
    # Of which names and gains alone are used.
    forward = inverse_models.forward_of(train, guard, brief=True)
    rows = np.repeat(asked.records[0].u[:, :4], EVENTS, axis=0)
    limits = jnx.inverse.ActuatorLimits()
    parts = inverse, forward, limits, Gtdi(), rows, asked, bench.seed
    held = asked.records[0].u[:, 1:3].mean(axis=0)
    (track,) = inverse_bench.bench(*parts).run([inverse_bench.case(held, True)])
    y = asked.records[0].y[:, :2]
    left = (track.outputs[:, :2] - y)[SKIPPED:]
    nrmse = np.sqrt((left**2).mean(axis=0)) / y[SKIPPED:].std(axis=0)
    return dict(zip(("TRQ", "lambda"), nrmse.tolist(), strict=True))


def _smooth(x: np.ndarray) -> np.ndarray:
    """Means over a moving window: inputs that go together."""
    return np.convolve(np.pad(x, (100, 100), mode="edge"), np.ones(201) / 201, "valid")


def task_rows(bench: Bench, name: str, small: bool, tuned: bool) -> dict[str, Any]:
    """All figures of one task."""
    commands, targets, limited = bench.bed.tasks[name]
    wanted = bench.data([bench.record(100, noise=0.0)])
    limits, wide = {}, 1.0
    if limited is not None:
        own = wanted.records[0].y[:, list(bench.plant.outputs).index(limited)]
        limits[limited] = OutputLimit(at_most=float(np.quantile(own, BELOW)))
        wide = float(np.ptp(own))
    more = {"horizon": bench.bed.horizon, "records": bench.left}
    controller = jnx.control.mpc(bench.network, commands, targets, limits, **more).value
    key = jax.random.key(bench.seed + 50)
    told: dict[str, Any] = {}

    def drive(
        title: str, plant: AbstractPlant, asked: jnx.Dataset, own: Any = None, **more
    ) -> Any:
        begun, own = time.perf_counter(), controller if own is None else own
        run = jnx.control.close_loop(
            own, plant, asked, noise=bench.bed.noise, seed=bench.seed, **more
        )
        row = dict(zip(targets, run.value.nrmse(SKIPPED).tolist(), strict=True))
        if own.bounded:
            over = run.value.excess()[SKIPPED:]
            row["kept"] = float(np.mean(over.max(axis=1) <= 0))
            row["largest excess"] = float(over.max() / wide)
            row["kept within 1 %"] = float(np.mean(over.max(axis=1) <= 0.01 * wide))
        row |= {"status": run.status_name, "seconds": time.perf_counter() - begun}
        told.setdefault(title, []).append(row)
        return run.value

    def left(run: Any) -> dict[str, float]:
        """Mean error behind steps of constant references."""
        found, end = {}, HOLD - controller.horizon
        for k, (o, target) in enumerate(zip(run.targets, targets, strict=True)):
            error = run.outputs[0][:, o] - run.references[0][:, k]
            ends = error.reshape(-1, HOLD)[:, end - JUDGED : end].mean(axis=1)
            spread = wanted.records[0].y.std(axis=0)[o]
            found[f"{target}, left"] = float(np.sqrt(np.mean(ends**2)) / spread)
        return found

    drive("engine", bench.plant, wanted)
    drive("engine, again", bench.plant, wanted)  # compiled by now
    drive("without preview", bench.plant, wanted, preview=False)
    if limits:
        free = jnx.control.mpc(bench.network, commands, targets, **more)
        drive("without a limit", bench.plant, wanted, free.value)
    if name == FORWARD:
        told["feedforward of chapter 7"] = [feedforward(bench, wanted)]
    ways = {"": controller}
    if tuned:
        found = jnx.control.tune_effort(
            controller, bench.others, bench.left, noise=bench.bed.noise
        )
        ways[", efforts tuned"] = found.value
        drive("engine, efforts tuned", bench.plant, wanted, found.value)
        told["engine, efforts tuned"][-1]["factor"] = found.stats["factor"]

    def drive_all(title: str, plant: AbstractPlant, asked: jnx.Dataset, *, ends=True):
        for way, own in ways.items():
            run = drive(f"{title}{way}", plant, asked, own)
            if ends:
                told[f"{title}{way}"][-1] |= left(run)

    asked = levels(bench, bench.plant, controller)
    drive_all("constant references", bench.plant, asked)
    for n in range(1 if small else SISTERS):
        sister = bench.bed.make().perturb(jax.random.fold_in(key, n), SPREAD)
        plant = bench.bed.plant(sister)
        drive_all("sisters", plant, wanted, ends=False)
        drive_all("sisters, constant", plant, levels(bench, plant, controller))
    return told


def summary(found: dict[str, Any]) -> dict[str, Any]:
    """Medians and worst over seeds and sisters."""
    told: dict[str, Any] = {}
    for title, seeds in found.items():
        for kind in next(iter(seeds.values()))["runs"]:
            rows = [row for seed in seeds.values() for row in seed["runs"][kind]]
            told[f"{title}, {kind}"] = {
                name: {
                    "median": float(np.median([r[name] for r in rows])),
                    "worst": float(
                        (np.min if "kept" in name else np.max)([r[name] for r in rows])
                    ),
                }
                for name, value in rows[0].items()
                if isinstance(value, float)
            }
    return told


def main() -> None:
    """Identify, steer, record."""
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beds", nargs="+", choices=BEDS, default=list(BEDS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--models", choices=NAMES, default="cubic")
    parser.add_argument("--tuned", action="store_true", help="also with tuned efforts")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="short records, one seed")
    options = parser.parse_args()
    length = 400 if options.smoke else LENGTH
    found: dict[str, Any] = {}
    for seed in options.seeds[:1] if options.smoke else options.seeds:
        for name in options.beds:
            bench = Bench(BEDS[name], seed, length, options.models)
            for task in bench.bed.tasks:
                rows = task_rows(bench, task, options.smoke, options.tuned)
                own = found.setdefault(f"{name}, {task}", {})
                own[str(seed)] = {"free run": bench.errors(), "runs": rows}
                print(name, task, seed, rows, flush=True)
            figures = {"summary": summary(found), "rows": found}
            folder = results_folder(options.results, smoke=options.smoke)
            record(NAMES[options.models], figures, folder=folder)


if __name__ == "__main__":
    main()
