"""Planned tests of new engines, compared with the usual steps.

Three beds whose inputs can be set at will, parameters off by about a tenth: 64 donors
as in `calibration.py` tell the population. 16 new engines run through one test that
`jnx.fleet.plan` makes for all of them, or each through a stretch of the bed's usual
excitation as long, both behind as many samples at their first levels; calibrated by
`jnx.fleet.calibrate` and judged by the free run on 500 samples of another excitation
without noise.

    python experiments/fleets/plans.py [--beds pfi vct] [--seeds 31 32]
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from calibration import Engines, method, whole_engines

import jaxnarx as jnx
from jaxnarx.engines import family

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "benchmarks"), str(HERE.parent / "engine_sweep")]
import beds  # noqa: E402 # pyright: ignore[reportMissingImports]
from common import record, results_folder  # noqa: E402 # pyright: ignore

BEDS = ("pfi", "vct", "diesel")
DONORS, NEW, SPREAD = 64, 16, 0.1
SAMPLES = 20, 50, 100
JUDGED, LEAD = 500, 100
"""Samples that judge, and those before them."""


def learn(name: str, seed: int, folder: Path, small: bool) -> Any:
    """The prior of a bed's donors."""
    donors = 8 if small else DONORS
    sizes = {"repetitions": 1, "lengths": (1000, 50, 1000), "spread": SPREAD}
    size = beds.Size(engines=donors + 4, seed=seed, **sizes)
    records = beds.records_of(name, size, folder)
    some = Engines(records, whole_engines(records)[:donors], "train", seed)
    return jnx.fleet.learn(some, method(some[next(iter(some))])).value


def run_on(bed: Any, engines: Any, u: np.ndarray) -> np.ndarray:
    """Outputs of engines under inputs (engines, samples, inputs), each of them kept for
    as many events as a sample has."""
    held = jnp.repeat(jnp.asarray(u), bed.down, axis=1)
    run = jax.jit(jax.vmap(lambda engine, u: engine.run(u)))
    column = bed.make().channels.output_names.index(bed.output)
    return np.asarray(run(engines, held))[:, :: bed.down, column]


def steps(bed: Any, key: Any, count: int, samples: int) -> np.ndarray:
    """The bed's usual excitation, of so many engines."""
    keys = jax.random.split(key, count)
    engine = bed.make()
    made = jax.vmap(lambda k: engine.excite(k, samples * bed.down))(keys)
    return np.asarray(made)[:, :: bed.down]


def dataset(prior: Any, u: np.ndarray, y: np.ndarray) -> jnx.Dataset:
    """One record of an engine with the channels of the fleet."""
    channels = prior.network.channels
    return jnx.Dataset.from_arrays(
        [u],
        [y[:, None]],
        inputs=list(channels.inputs),
        outputs=list(channels.outputs),
        sample_time=float(prior.network.sample_time),
    )


def bed_rows(name: str, seed: int, folder: Path, small: bool) -> dict[str, Any]:
    """Median errors of the new engines by number of samples and kind of test."""
    prior = learn(name, seed, folder, small)
    bed, count = beds.BEDS[name], 2 if small else NEW
    key = jax.random.key(1000 + seed)
    engines = family(bed.make(), key, count, spread=SPREAD)
    later = steps(bed, jax.random.fold_in(key, 1), count, LEAD + JUDGED)
    truth = run_on(bed, engines, later)
    level = bed.make().noise[bed.output]
    random = np.random.default_rng(seed)
    rows: dict[str, Any] = {}
    for samples in SAMPLES[:1] if small else SAMPLES:
        duration = samples * float(prior.network.sample_time)
        planned = jnx.fleet.plan(prior, duration=duration, seed=seed)
        u = planned.value.inputs
        tests = {
            "planned": np.broadcast_to(u, (count, *u.shape)),
            "usual steps": steps(bed, jax.random.fold_in(key, 2), count, samples),
        }
        rest = np.repeat(tests["usual steps"][:, :1], prior.warm_up, axis=1)
        tests["usual steps"] = np.concatenate([rest, tests["usual steps"]], axis=1)
        row: dict[str, Any] = {"expected to be learnt": planned.stats["learnt"]}
        for kind, inputs in tests.items():
            y = run_on(bed, engines, inputs)
            size = level.absolute + level.relative * np.abs(y)
            y = y + size * random.normal(size=y.shape)
            errors, learnt = [], []
            for n in range(count):
                found = jnx.fleet.calibrate(prior, dataset(prior, inputs[n], y[n]))
                judged = dataset(prior, later[n], truth[n])
                run = jnx.simulate(found.value, judged).value.outputs[0][LEAD:, 0]
                error = np.sqrt(np.mean((run - truth[n][LEAD:]) ** 2))
                errors.append(float(error / truth[n][LEAD:].std()))
                learnt.append(float(found.stats["learnt"]))
            row[kind] = {
                "median": float(np.median(errors)),
                "worst": float(np.max(errors)),
                "learnt": float(np.mean(learnt)),
            }
        row["planned over usual"] = (
            row["planned"]["median"] / row["usual steps"]["median"]
        )
        rows[str(samples)] = row
        print(name, seed, samples, row, flush=True)
    return rows


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beds", nargs="+", default=list(BEDS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[31, 32, 33])
    parser.add_argument("--smoke", action="store_true", help="few engines")
    parser.add_argument("--cache", type=Path, help="folder of simulated records")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    cache = options.cache or folder / "engines"
    chosen, seeds = options.beds, options.seeds
    if options.smoke:
        chosen, seeds = chosen[:1], seeds[:1]
    found = {
        name: {str(seed): bed_rows(name, seed, cache, options.smoke) for seed in seeds}
        for name in chosen
    }
    medians = {
        name: {
            n: float(np.median([own[n]["planned over usual"] for own in rows.values()]))
            for n in next(iter(rows.values()))
        }
        for name, rows in found.items()
    }
    figures = {"planned over usual, median of seeds": medians, "beds": found}
    record("fleet_plans", figures, folder=folder)


if __name__ == "__main__":
    main()
