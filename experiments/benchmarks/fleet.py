"""Costs of a fleet: learning from donors, calibrating new engines. No peer does it.

Synthetic engines of five inputs and 60 quadratic terms, 1,000 samples each, made when
they are asked for.

    python experiments/benchmarks/fleet.py [--donors 1000] [--engines 1024]

Seconds of processor and of wall, compilation in them and apart: the second call of each
compiles nothing. Peak memory is that of the process, with 256 donors and with all.
"""

import argparse
import resource
import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
from common import record, results_folder

import jaxnarx as jnx

INPUTS, TERMS, SAMPLES = 5, 60, 1000
FEW = 20


class Synthetic(Mapping[str, jnx.Dataset]):
    """Engines by number, each made when it is asked for."""

    def __init__(self, first: int, count: int, samples: int = SAMPLES):
        self.first, self.count, self.samples = first, count, samples

    def __len__(self) -> int:
        return self.count

    def __iter__(self):
        return (f"engine {n}" for n in range(self.first, self.first + self.count))

    def __getitem__(self, name: str) -> jnx.Dataset:
        draw = np.random.default_rng(int(name.split()[1]))
        steps = draw.uniform(-1, 1, (self.samples // 5 + 1, INPUTS))
        u = np.repeat(steps, 5, axis=0)[: self.samples]
        u = u + 0.05 * draw.normal(size=u.shape)
        x = np.concatenate([u, np.vstack([u[:1], u[:-1]])], axis=1)
        theta = np.linspace(-1, 1, 2 * INPUTS) + 0.1 * draw.normal(size=2 * INPUTS)
        y = x @ theta + 0.3 * (1 + 0.2 * draw.normal()) * x[:, 0] * x[:, 1]
        y = y + 0.02 * draw.normal(size=len(y))
        return jnx.Dataset.from_arrays(
            [u],
            [y[:, None]],
            inputs=[f"u{n}" for n in range(INPUTS)],
            outputs=["y"],
            sample_time=0.1,
        )


def timed(work: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    """A result, with seconds of wall and of processor."""
    wall, own = time.perf_counter(), time.process_time()
    found = work()
    return found, {
        "wall_s": round(time.perf_counter() - wall, 3),
        "processor_s": round(time.process_time() - own, 3),
    }


def memory() -> float:
    """Peak memory of this process so far [GB]."""
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6, 2)


def measure(donors: int, engines: int) -> dict[str, Any]:
    """All rows."""
    one = Synthetic(0, 1)["engine 0"]
    pool = jnx.polynomial_pool(
        one.channels, input_lags=(0, 1), output_lags=(), degree=2
    )
    pool = jnx.Pool(pool.variables, pool.factor[:TERMS], pool.channels, pool.outputs)
    network = jnx.grow(pool, one, jnx.Global()).value
    rows: dict[str, Any] = {"donors": donors, "samples": SAMPLES, "terms": TERMS}
    few = min(donors, 256)
    _, rows["learn, compiling"] = timed(
        lambda: jnx.fleet.learn(Synthetic(0, few), network)
    )
    rows["peak_gb, first donors"] = {"donors": few, "peak_gb": memory()}
    found, rows["learn"] = timed(lambda: jnx.fleet.learn(Synthetic(0, donors), network))
    rows["peak_gb"] = memory()
    rows["broken"] = len(found.stats["broken"])
    prior = found.value
    new = Synthetic(donors, engines, FEW + prior.warm_up + prior.network.before)
    kept = {name: new[name] for name in new}
    first = dict(list(kept.items())[:1])
    _, rows["calibrate, compiling"] = timed(
        lambda: jnx.fleet.calibrate_each(prior, first)
    )
    every, rows["calibrate all"] = timed(lambda: jnx.fleet.calibrate_each(prior, kept))
    rows["engines"] = len(every)
    rows["calibrate one_ms"] = round(
        1e3 * rows["calibrate all"]["wall_s"] / len(every), 2
    )
    rows["targets"] = {
        "learn": {"value": rows["learn"]["wall_s"], "limit": 60},
        "calibrate one_ms": {"value": rows["calibrate one_ms"], "limit": 50},
    }
    return rows


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--donors", type=int, default=1000)
    parser.add_argument("--engines", type=int, default=1024)
    parser.add_argument("--smoke", action="store_true", help="few engines")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    counts = (8, 4) if options.smoke else (options.donors, options.engines)
    figures = measure(*counts)
    print(figures)
    record("fleet", figures, folder=folder)


if __name__ == "__main__":
    main()
