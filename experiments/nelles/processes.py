"""Four second-order test processes: LOLIMOT, and refined on its own free run.

Every data set has 1,000 samples each for training, validation and test, an APRBS as
input, white noise of 5 % of the output's standard deviation on the output of the first
two, and is scored against the noise-free output of the third. The noise enters the
lagged outputs, so least squares of the one-step error is biased: that start is poor
although its one-step error looks fine, and this is what refinement is for.

Three rows for each process: affine local models as LOLIMOT leaves them; refined with
everything moving from the first window (`train="joint"`); and refined by the default
settings, in which the coefficients go first. Windows that restart from noisy
measurements drive a partition into poor places. Scheduling variables are those that the
nonlinear part of the equation acts on.

The default, and that the last stage begins at the best network by validation so far,
were settled by validation error on other draws (seeds 100 to 105).

    python experiments/nelles/processes.py [--smoke] [--results DIR]

Every row is written as soon as it is there; a second run goes on where the first
stopped. Writes nelles_processes.json and .png.

Reference: O. Nelles, Nonlinear System Identification, Springer 2001, chapter 18.
"""

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxnarx as jnx
from jaxnarx.excitation import aprbs
from jaxnarx.metrics import nrmse

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).resolve().parent))
from common import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    record,
    results_folder,
    target,
)
from processes_figure import draw  # noqa: E402 # pyright: ignore[reportMissingImports]

jax.config.update("jax_enable_x64", True)

SAMPLES, NOISE, SEEDS, MODELS = 1000, 0.05, 20, (4, 8)
ROWS: tuple[str, ...] = ("LOLIMOT", "joint", "staged")
JOINT = jnx.SimulationError(train="joint")

Step = Callable[[float, float, float, float, float], float]


@dataclasses.dataclass(frozen=True)
class Process:
    """x(k) = step(u(k), u(k-1), u(k-2), x(k-1), x(k-2)), y = output(x), from rest."""

    step: Step
    amplitude: float
    hold: tuple[int, int]
    """Shortest and longest hold of the input in samples."""
    scheduling: tuple[str, ...]
    limit: float
    """Median free-run NRMSE to reach by default refinement of four models."""
    output: Callable[[np.ndarray], np.ndarray] = np.asarray
    input_lags: tuple[int, ...] = (1, 2)


def hammerstein(u, u1, u2, x1, x2):
    v1, v2 = np.arctan(u1), np.arctan(u2)
    return 0.01867 * v1 + 0.01746 * v2 + 1.7826 * x1 - 0.8187 * x2


def linear(u, u1, u2, x1, x2):
    return 0.01867 * u1 + 0.01746 * u2 + 1.7826 * x1 - 0.8187 * x2


def difference_equation(u, u1, u2, x1, x2):
    v1, v2 = u1 - 0.2 * x1**2, u2 - 0.2 * x2**2
    return -0.07289 * v1 + 0.09394 * v2 + 1.68364 * x1 - 0.70469 * x2


def dynamic_nonlinearity(u, u1, u2, x1, x2):
    fixed = 0.133 * u1 - 0.0667 * u2 + 1.5 * x1 - 0.7 * x2
    return fixed + u * (0.1 * x1 - 0.2 * x2)


SLOW, FAST = (10, 60), (8, 40)
ON_U, ON_Y = ("u[t-1]", "u[t-2]"), ("y[t-1]", "y[t-2]")
PROCESSES = {
    "Hammerstein": Process(hammerstein, 3.0, SLOW, ON_U, 0.03),
    "Wiener": Process(linear, 3.0, SLOW, ON_Y, 0.07, output=np.arctan),
    "difference equation": Process(difference_equation, 1.0, FAST, ON_Y, 0.03),
    "dynamic nonlinearity": Process(
        dynamic_nonlinearity, 1.0, FAST, ("u[t]",), 0.05, input_lags=(0, 1, 2)
    ),
}


def respond(process: Process, u: np.ndarray) -> np.ndarray:
    """The noise-free output, from rest."""
    x = np.zeros_like(u)
    for k in range(2, len(u)):
        x[k] = process.step(u[k], u[k - 1], u[k - 2], x[k - 1], x[k - 2])
    return process.output(x)


def records(
    process: Process, seed: int
) -> tuple[jnx.Dataset, jnx.Dataset, jnx.Dataset]:
    """Training and validation with noise, test without."""
    keys = jax.random.split(jax.random.key(seed), (3, 2))
    span = (-process.amplitude, process.amplitude)
    us, ys = [], []
    for part, (key, noise_key) in enumerate(keys):
        u = np.asarray(aprbs(key, SAMPLES, hold=process.hold, amplitude=span))
        y = respond(process, u)
        if part < 2:
            noise = np.asarray(jax.random.normal(noise_key, (SAMPLES,)))
            y = y + NOISE * y.std() * noise
        us.append(u[:, None])
        ys.append(y[:, None])
    data = jnx.Dataset.from_arrays(us, ys, inputs=["u"], outputs=["y"], sample_time=1.0)
    return data[0], data[1], data[2]


def grown(process: Process, data: jnx.Dataset, models: int) -> jnx.Network:
    """LOLIMOT with exactly so many affine local models.

    The information criterion would stop at six or seven of eight in some seeds. A fixed
    number is the harder test, and all seeds share their compiled programs.
    """
    pool = jnx.polynomial_pool(
        data.channels, input_lags=process.input_lags, output_lags=(1, 2), degree=1
    )
    method = jnx.Lolimot(process.scheduling, max_models=models, criterion="none")
    grown = jnx.grow(pool, data, method)
    if grown.stats["stopped"] != ["capacity"]:
        raise ValueError(f"{grown.stats['models'][0][-1]} models instead of {models}")
    return grown.value


def errors(network: jnx.Network, data: jnx.Dataset) -> dict[str, Any]:
    """NRMSE one step ahead and in free run, and whether that diverges."""
    found: dict[str, Any] = {}
    for name, verb in (("one_step", jnx.predict), ("free_run", jnx.simulate)):
        run = verb(network, data)
        scored = run.value.scored[0]
        found[name] = float(nrmse(data.records[0].y, run.value[0], scored)[0])
        found["diverged"] = run.status_name == "diverged"
    return found


def networks(
    process: Process, train: jnx.Dataset, validate: jnx.Dataset, models: int
) -> tuple[dict[str, jnx.Network], dict[str, str]]:
    """The three networks of one data set, and how each refinement ended."""
    start = grown(process, train, models)
    joint = jnx.refine(start, train, JOINT, validation=validate)
    staged = jnx.refine(start, train, validation=validate)
    found = dict(zip(ROWS, (start, joint.value, staged.value), strict=True))
    return found, {"joint": joint.status_name, "staged": staged.status_name}


def trial(name: str, models: int, seed: int) -> dict[str, Any]:
    """One data set; the refined must not be worse than the start on validation."""
    train, validate, test = records(PROCESSES[name], seed)
    found, status = networks(PROCESSES[name], train, validate, models)
    row = {"process": name, "models": models, "seed": seed, "status": status}
    row["validation"] = {k: errors(n, validate) for k, n in found.items()}
    row["test"] = {k: errors(n, test) for k, n in found.items()}
    before, *ends = (row["validation"][k] for k in ROWS)
    for after in ends:
        # The guard sums squares in another order than the score: 1e-9 of rounding.
        limit = (1 + 1e-9) * before["free_run"]
        worse = (after["diverged"], after["free_run"]) > (before["diverged"], limit)
        assert not worse, row
    return row


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians over seeds, divergences on any record, and the targets."""
    table: dict[str, Any] = {}
    for name in PROCESSES:
        for models in MODELS:
            own = [r for r in rows if (r["process"], r["models"]) == (name, models)]
            if not own:
                continue
            entry: dict[str, Any] = {"seeds": len(own)}
            for k in ROWS:
                scores = [r["test"][k] for r in own]
                entry[k] = {
                    kind: spread([s[kind] for s in scores])
                    for kind in ("one_step", "free_run")
                }
                entry[k]["diverged"] = sum(
                    r["test"][k]["diverged"] or r["validation"][k]["diverged"]
                    for r in own
                )
            if models == MODELS[0]:
                staged = entry["staged"]["free_run"]
                entry["target"] = target(staged["median"], PROCESSES[name].limit)
                worst = entry["LOLIMOT"]["free_run"]["largest"]
                entry["worst"] = target(staged["largest"], worst)
            table[f"{name}, {models} models"] = entry
    return table


def spread(values: list[float]) -> dict[str, float]:
    """Least, median and largest."""
    return {
        "least": min(values),
        "median": float(np.median(values)),
        "largest": max(values),
    }


def show(table: dict[str, Any]) -> None:
    """Median test NRMSE of the free run (one step), worst seed, divergences."""
    for name, entry in table.items():
        print(f"{name} ({entry['seeds']} seeds)")
        for k in ROWS:
            free, one = entry[k]["free_run"], entry[k]["one_step"]
            print(
                f"  {k:13s} free run {free['median']:.4f} (worst {free['largest']:.4f})"
                f"  one step {one['median']:.4f}  diverged {entry[k]['diverged']}"
            )
        if "target" in entry:
            print(f"  target {entry['target']['limit']}: {entry['target']['met']}")
            print(f"  worst not above LOLIMOT's: {entry['worst']['met']}")


def main() -> None:
    """Fill the table and draw the figure."""
    parser = argparse.ArgumentParser(description="Nelles' test processes.")
    parser.add_argument("--smoke", action="store_true", help="one process, one seed")
    parser.add_argument("--results", metavar="DIR", help="folder for JSON and figure")
    options = parser.parse_args()
    names, sizes, seeds = tuple(PROCESSES), MODELS, SEEDS
    if options.smoke:
        names, sizes, seeds = names[2:3], MODELS[:1], 1
    own = None if options.smoke else str(Path(__file__).with_name("results"))
    folder = results_folder(options.results or own, smoke=options.smoke)
    path = folder / "nelles_processes.json"
    rows = json.loads(path.read_text())["figures"]["rows"] if path.exists() else []
    done = {(r["process"], r["models"], r["seed"]) for r in rows}
    for key in [(n, m, s) for m in sizes for n in names for s in range(seeds)]:
        if key not in done:
            rows.append(trial(*key))
            figures = {"summary": summary(rows), "rows": rows}
            record("nelles_processes", figures, folder=folder)
    show(summary(rows))
    examples = {}
    for name in names:
        train, validate, test = records(PROCESSES[name], 0)
        found, _ = networks(PROCESSES[name], train, validate, MODELS[0])
        examples[name] = (found, test)
    draw(examples).savefig(folder / "nelles_processes.png", dpi=110)


if __name__ == "__main__":
    main()
