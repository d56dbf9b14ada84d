"""The error that a search promises beside that of its model on fresh records.

Ten kinds of plants, two draws each, none of which the search was made with: static
curves behind and before dynamics, a product of input and state, time constants that an
input moves, parallel paths, backlash, switching, an outflow, a stiffening spring, a map
of two inputs behind a dead time. Inputs are steps, filtered noise or both, noise is 1
to 5 %; one record of 600 to 1,500 samples, or four. The truth is the free run of the
chosen network over five fresh records of the same length and noise.

    python experiments/open_sets/promises.py [--systems 20] [--preset quick]

`left out` is the error by which candidates are compared: halvings, feedback and gates
were moved on all groups, and the smallest of many was taken. `nested` is what is
promised in the end. Results: `experiments/benchmarks/results/promises.json`.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
from common import record, results_folder  # noqa: E402 # pyright: ignore

FRESH = 5
"""Fresh records."""
LENGTHS = 600, 800, 1000, 1500
Plant = Callable[[np.ndarray, np.random.Generator], np.ndarray]
Make = Callable[[np.random.Generator], tuple[int, Callable[[np.ndarray], np.ndarray]]]
"""A draw of a kind: how many inputs, and the response to them."""


def lag(u: np.ndarray, *poles: float) -> np.ndarray:
    """First-order lags of gain one behind one another."""
    y = u
    for pole in poles:
        x, y = y, np.zeros(len(y))
        for t in range(1, len(x)):
            y[t] = pole * y[t - 1] + (1 - pole) * x[t - 1]
    return y


def wiener(rng: np.random.Generator):
    """Two lags, then a cubic curve."""
    a, b, c = rng.uniform(0.6, 0.92), rng.uniform(0.3, 0.7), rng.uniform(0.3, 1.5)
    return 1, lambda u: (lambda x: x + c * x**2 - 0.3 * c * x**3)(lag(u[:, 0], a, b))


def hammerstein(rng: np.random.Generator):
    """A dead zone and a saturation before lags."""
    a, w = rng.uniform(0.6, 0.92), rng.uniform(0.1, 0.4)

    def run(u: np.ndarray) -> np.ndarray:
        v = np.clip(np.sign(u) * np.maximum(np.abs(u) - w, 0), -1.0, 1.0)
        return lag(v[:, 0], a, 0.5) + 0.6 * lag(v[:, 1], 0.8)

    return 2, run


def bilinear(rng: np.random.Generator):
    """An input times the state."""
    a, b, c = rng.uniform(0.6, 0.9), rng.uniform(0.1, 0.3), rng.uniform(0.05, 0.15)

    def run(u: np.ndarray) -> np.ndarray:
        y = np.zeros(len(u))
        for t in range(1, len(u)):
            gate = np.tanh(u[t - 1, 1])
            y[t] = (a - c * gate) * y[t - 1] + b * u[t - 1, 0] + 0.1 * gate
        return y

    return 2, run


def moving_pole(rng: np.random.Generator):
    """A time constant that depends on the second of three inputs."""
    low, high = rng.uniform(0.4, 0.6), rng.uniform(0.85, 0.95)

    def run(u: np.ndarray) -> np.ndarray:
        y = np.zeros(len(u))
        for t in range(1, len(u)):
            pole = low + (high - low) / (1 + np.exp(-3 * u[t - 1, 1]))
            y[t] = pole * y[t - 1] + (1 - pole) * (u[t - 1, 0] + 0.5 * u[t - 1, 2])
        return y

    return 3, run


def parallel(rng: np.random.Generator):
    """A fast path with a curve beside a slow linear one."""
    a, c = rng.uniform(0.85, 0.96), rng.uniform(0.5, 1.5)
    return 1, lambda u: lag(u[:, 0], a) + c * np.tanh(2 * lag(u[:, 0], 0.4)) ** 2


def backlash(rng: np.random.Generator):
    """Play of a gear before a lag."""
    width, a = rng.uniform(0.1, 0.4), rng.uniform(0.5, 0.85)

    def run(u: np.ndarray) -> np.ndarray:
        x = np.zeros(len(u))
        for t in range(1, len(u)):
            x[t] = np.clip(x[t - 1], u[t, 0] - width, u[t, 0] + width)
        return lag(x, a)

    return 1, run


def switching(rng: np.random.Generator):
    """Another gain and pole where the output is high."""
    a, b = rng.uniform(0.5, 0.7), rng.uniform(0.8, 0.92)

    def run(u: np.ndarray) -> np.ndarray:
        y = np.zeros(len(u))
        for t in range(1, len(u)):
            share = 1 / (1 + np.exp(-8 * (y[t - 1] - 0.2)))
            drive = u[t - 1, 0] + 0.3 * u[t - 1, 1]
            y[t] = share * (b * y[t - 1] + (1 - b) * 1.5 * drive) + (1 - share) * (
                a * y[t - 1] + (1 - a) * drive
            )
        return y

    return 2, run


def outflow(rng: np.random.Generator):
    """A vessel that empties with the root of its level."""
    k, c = rng.uniform(0.05, 0.15), rng.uniform(0.1, 0.2)

    def run(u: np.ndarray) -> np.ndarray:
        y = np.ones(len(u))
        for t in range(1, len(u)):
            valve = 1 + 0.4 * np.tanh(u[t - 1, 1])
            flow = c * (1 + np.tanh(u[t - 1, 0])) - k * valve * np.sqrt(y[t - 1])
            y[t] = max(y[t - 1] + flow, 0.0)
        return y

    return 2, run


def spring(rng: np.random.Generator):
    """A mass on a stiffening spring."""
    k, d, c = rng.uniform(0.05, 0.2), rng.uniform(0.15, 0.4), rng.uniform(0.02, 0.1)

    def run(u: np.ndarray) -> np.ndarray:
        y, speed = np.zeros(len(u)), 0.0
        for t in range(1, len(u)):
            x = y[t - 1]
            speed += k * u[t - 1, 0] - d * speed - k * x - c * x**3
            y[t] = x + speed
        return y

    return 1, run


def map_of_two(rng: np.random.Generator):
    """A peak in the plane of two inputs behind a dead time, and a third input."""
    at, a = rng.uniform(-0.5, 0.5, 2), rng.uniform(0.6, 0.9)
    dead = int(rng.integers(2, 8))

    def run(u: np.ndarray) -> np.ndarray:
        v = np.concatenate([np.repeat(u[:1], dead, axis=0), u])[: len(u)]
        peak = np.exp(-((v[:, 0] - at[0]) ** 2) - (v[:, 1] - at[1]) ** 2)
        return lag(2 * peak + 0.3 * v[:, 0] * v[:, 1], a, 0.4) + 0.4 * lag(v[:, 2], a)

    return 3, run


KINDS: dict[str, Callable[[np.random.Generator], Any]] = {
    "wiener": wiener,
    "hammerstein": hammerstein,
    "bilinear": bilinear,
    "moving pole": moving_pole,
    "parallel": parallel,
    "backlash": backlash,
    "switching": switching,
    "outflow": outflow,
    "spring": spring,
    "map of two": map_of_two,
}


def draw_input(rng: np.random.Generator, rows: int, kind: int) -> np.ndarray:
    """Steps, filtered noise, or their sum."""
    holds = rng.integers(3, 40, rows)
    steps = np.repeat(rng.uniform(-1.5, 1.5, rows), holds)[:rows]
    noise = lag(rng.normal(size=rows), 0.9)
    noise /= noise.std()
    return (steps, noise, 0.7 * steps + 0.5 * noise)[kind]


def system(n: int) -> tuple[str, Any, Any]:
    """Kind, training and fresh records of a system."""
    import jaxnarx as jnx

    rng = np.random.default_rng([77, n])
    kind = list(KINDS)[n % len(KINDS)]
    inputs, run = KINDS[kind](rng)
    length = LENGTHS[int(rng.integers(len(LENGTHS)))]
    level, excitation = rng.uniform(0.01, 0.05), int(rng.integers(3))
    count = 4 if rng.uniform() < 0.4 else 1

    def records(count: int, rows: int) -> Any:
        parts = []
        for _ in range(count):
            u = [draw_input(rng, rows, excitation) for _ in range(inputs)]
            u = np.stack(u, axis=1)
            y = run(u)
            y = y + level * y.std() * rng.normal(size=rows)
            parts.append((u, y[:, None]))
        u, y = zip(*parts, strict=True)
        names = [f"u{i}" for i in range(inputs)]
        return jnx.Dataset.from_arrays(
            list(u), list(y), inputs=names, outputs="y", sample_time=0.1
        )

    return kind, records(count, length // count), records(FRESH, length)


def compare(n: int, preset: str) -> dict[str, Any]:
    """The errors that are promised for a system, and the true one."""
    from gains import nrmse  # pyright: ignore[reportMissingImports]

    import jaxnarx as jnx

    kind, train, fresh = system(n)
    begin = time.process_time()
    fit = jnx.identify(train, preset=preset)
    seconds = time.process_time() - begin
    (output,) = train.channels.output_names
    row = fit.stats["leaderboard"].choose(output)
    truth, diverged = nrmse(fit.value, fresh)
    return {
        "system": n,
        "kind": kind,
        "samples": train.samples,
        "inputs": len(train.channels.inputs),
        "family": f"{row.family}: {row.name}",
        "left out": row.free_run,
        "nested": row.nested,
        "promised": row.promised,
        "true": truth,
        "diverged": diverged,
        "seconds": round(seconds, 1),
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Quantiles of truth over promise."""
    told = {}
    for promise in ("left out", "promised"):
        ratios = np.array([row["true"] / row[promise] for row in rows])
        told[f"true over {promise}"] = {
            "median": float(np.median(ratios)),
            "ninth of ten": float(np.quantile(ratios, 0.9)),
            "worst": float(ratios.max()),
            "least": float(ratios.min()),
        }
    return told


def main() -> None:
    """Search, run over fresh records, record."""
    import jax

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--systems", type=int, default=20, help="so many")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="two systems")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    rows = []
    for n in range(
        options.first, options.first + (2 if options.smoke else options.systems)
    ):
        rows.append(compare(n, options.preset))
        print(rows[-1], flush=True)
    told = summary(rows)
    print(told)
    record("promises", {"preset": options.preset, "rows": rows} | told, folder=folder)


if __name__ == "__main__":
    main()
