"""Costs of a calibration by gradient: a run, its gradient, a search, memory.

A synthetic network of seven inputs and three outputs, quadratic terms of filtered
inputs with feedback, from 6,000 samples. Four inputs are set by maps of 8 x 8 points
over two of the others; the cycle has 18,000 samples of .1 s. Least mean of one output,
limits of the mean of another and of the peak of the third, inside of the domain.

    python experiments/benchmarks/calibration.py [--samples 18000]

The gradient is that of the whole Lagrangian by all 256 points, and is compared with one
evaluation of the same Lagrangian, which is one free run, measures and domain. Memory is
the largest of the process, with a gradient of 100,000 samples behind everything else.
"""

import argparse
import dataclasses
import resource
import time
from typing import Any

import jax
import numpy as np
from common import record, results_folder

import jaxnarx as jnx
from jaxnarx.calibration import Calibratable, CalibrationSearch, CycleLimit, Measure
from jaxnarx.calibration.lagrangian import lagrangian
from jaxnarx.calibration.problem import begin_numbers, run_cycle
from jaxnarx.calibration.setup import add_levels, join_plants, make_problem

INPUTS, OUTPUTS, TRAINED = 7, 3, 6_000
STEP = 0.1
MAPS = ("u3", "u4", "u5", "u6")
LONG = 100_000


def demand(samples: int, seed: int) -> np.ndarray:
    """Steps of all inputs, rounded off."""
    random = np.random.default_rng(seed)
    held = np.repeat(random.uniform(-1, 1, (samples // 20 + 1, INPUTS)), 20, axis=0)
    u = held[:samples]
    kernel = np.ones(5) / 5
    return np.stack([np.convolve(c, kernel, "same") for c in u.T], axis=1)


def outputs_of(u: np.ndarray) -> np.ndarray:
    """Three lags of first order behind quadratic statics."""
    random = np.random.default_rng(7)
    linear = random.normal(size=(INPUTS, OUTPUTS))
    square = 0.3 * random.normal(size=(INPUTS, INPUTS, OUTPUTS))
    rest = u @ linear + np.einsum("ti,ijo,tj->to", u, square, u)
    rest = rest + 1.5 * (u[:, 3:] ** 2).sum(axis=1, keepdims=True)
    y = np.zeros_like(rest)
    y[0] = rest[0]
    for t in range(1, len(u)):
        y[t] = 0.9 * y[t - 1] + 0.1 * rest[t]
    return y + 10.0


def make_network() -> jnx.Network:
    """The network, with a domain."""
    u = demand(TRAINED, 0)
    y = outputs_of(u) + 0.02 * np.random.default_rng(1).normal(size=(TRAINED, OUTPUTS))
    data = jnx.Dataset.from_arrays(
        u,
        y,
        inputs=[f"u{n}" for n in range(INPUTS)],
        outputs=[f"y{n}" for n in range(OUTPUTS)],
        sample_time=STEP,
    )
    pool = jnx.polynomial_pool(
        data.channels, input_lags=(0,), output_lags=(1,), degree=2
    )
    chosen = jnx.select(pool, data, jnx.ForwardOLS(max_terms=30)).value
    network = jnx.grow(chosen, data, jnx.Global()).value
    return jnx.confidence.fit_domain(network, data)


def cycle(samples: int) -> jnx.Dataset:
    """Signals of the cycle that no map sets."""
    return jnx.Dataset.from_arrays(
        demand(samples, 5)[:, :3],
        np.zeros(samples),
        inputs=["u0", "u1", "u2"],
        outputs="nothing",
        sample_time=STEP,
    )


def timed(function: Any, count: int) -> float:
    """Least seconds of some calls, compiled before."""
    jax.block_until_ready(function())
    found = []
    for _ in range(count):
        begin = time.perf_counter()
        jax.block_until_ready(function())
        found.append(time.perf_counter() - begin)
    return min(found)


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=18_000)
    parser.add_argument("--smoke", action="store_true", help="short cycles")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    samples, long = (600, 1_200) if options.smoke else (options.samples, LONG)
    network = make_network()
    maps = {n: Calibratable(("u0", "u1"), size=(8, 8), start=0.0) for n in MAPS}
    wanted = [Measure("y0")]
    limits = [
        CycleLimit(Measure("y1"), at_most=1.0, of_start=True),
        CycleLimit(Measure("y2", "peak"), at_most=1.0, of_start=True),
    ]
    search = CalibrationSearch(rounds=3) if options.smoke else CalibrationSearch()
    figures: dict[str, Any] = {"samples": samples, "points": 64 * len(MAPS)}
    figures |= costs(network, maps, wanted, limits, search, samples)
    given = network, cycle(samples), maps, wanted, limits
    for kind in ("with compilation", "without"):
        begin = time.perf_counter()
        found = jnx.calibration.optimise(*given, search=search)
        figures[f"search, {kind} [s]"] = round(time.perf_counter() - begin, 1)
    figures["search"] = {
        "status": found.status_name,
        "steps": found.stats["steps"],
        "runs": sum(row["runs"] for row in found.stats["history"]),
        "detail": found.detail,
    }
    print(figures, flush=True)
    far = costs(network, maps, wanted, limits, search, long)
    figures[f"{long} samples"] = far
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    figures["largest memory [GB]"] = round(peak, 2)
    print(figures, flush=True)
    record("calibration_costs", figures, folder=folder)


def costs(network, maps, wanted, limits, search, samples: int) -> dict[str, Any]:
    """Seconds of a run, of the Lagrangian, and of its gradient."""
    plant, draws, own = join_plants(network, 1)
    rest = cycle(samples), maps, wanted, limits, search
    problem = make_problem(plant, draws, own, *rest)
    begun = tuple(m.start for m in problem.maps)
    problem = add_levels(problem, run_cycle(problem, begun))
    free = begin_numbers(problem)[0]
    kind = problem.cycle.values.dtype
    numbers = np.zeros(problem.conditions, kind), np.ones((), kind), np.ones((), kind)
    numbers = jax.device_put(numbers)

    merit = jax.jit(lambda problem, free: problem.merit(free))
    nowhere = dataclasses.replace(problem, domain=None, index=None)
    count = 3
    run = timed(lambda: run_cycle(problem, begun), count)
    whole = timed(lambda: merit(problem, free), count)
    slope = timed(lambda: lagrangian(problem, free, *numbers), count)
    fewer = (numbers[0][:-1], *numbers[1:])
    alone = timed(lambda: lagrangian(nowhere, free, *fewer), count)
    return {
        "free run [s]": run,
        "Lagrangian [s]": whole,
        "its gradient [s]": slope,
        "gradient over Lagrangian": slope / whole,
        "gradient without domain [s]": alone,
        "gradient without domain over free run": alone / run,
    }


if __name__ == "__main__":
    main()
