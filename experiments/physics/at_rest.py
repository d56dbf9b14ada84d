"""Operating points at rest beside short records of virtual engines.

Two records of 500 events train, with 0, 20 or 60 operating points: rows of the bed's
usual excitation under another key, held until all has settled. Noise is 2 % of the
standard deviation of each output in records and .5 % in points, which are averaged
longer. The search (`quick`) models each bed's first outputs; four other records of
1,000 events are run freely, without noise, once when all searches have ended.

    python experiments/physics/at_rest.py [--beds pfi-dyno gtdi vct diesel]
"""

import argparse
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxnarx as jnx
from jaxnarx.data import Channels, match_channels
from jaxnarx.engines import BEDS, records

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
from common import record, results_folder  # noqa: E402 # pyright: ignore

CHOSEN = ("pfi-dyno", "gtdi", "vct", "diesel")
TRAIN, EVENTS = 2, 500
TEST, TEST_EVENTS = 4, 1000
POINTS = 0, 20, 60
OUTPUTS = 2
NOISE, POINT_NOISE = 0.02, 0.005
SEED = 41


def noisy(data: jnx.Dataset, size: np.ndarray, rng: np.random.Generator) -> jnx.Dataset:
    """Outputs with white noise of this standard deviation."""
    u, y = [r.u for r in data], [r.y + size * rng.normal(size=r.y.shape) for r in data]
    return made(data, u, y)


def made(like: jnx.Dataset, u: list[Any], y: list[Any]) -> jnx.Dataset:
    """Records of the same channels."""
    names = like.channels
    return jnx.Dataset.from_arrays(
        u,
        y,
        inputs=names.input_names,
        outputs=names.output_names,
        sample_time=like.sample_time,
    )


def points_of(bed: Any, like: jnx.Dataset, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Inputs of so many operating points that have a steady state, and the outputs."""
    rows = np.asarray(bed.excite(jax.random.key(SEED + 1), 20 * count))[::10]
    y = np.asarray(jax.vmap(bed.steady_outputs)(rows))
    good = np.flatnonzero(np.isfinite(y).all(axis=1))[:count]
    return rows[good], y[good]


def measure(name: str, counts: Sequence[int], small: bool) -> dict[str, Any]:
    """Test errors of a bed by the number of points."""
    bed = BEDS[name]()
    key = jax.random.fold_in(jax.random.key(SEED), sorted(BEDS).index(name))
    lengths = [EVENTS] * TRAIN + [TEST_EVENTS] * TEST
    clean = records(bed, key, lengths, noise=0)
    few = clean.channels.outputs[: 1 if small else OUTPUTS]
    channels = Channels(clean.channels.inputs, few)
    inputs, rest = points_of(bed, clean, max(counts) or 1)
    points = match_channels(made(clean, [inputs], [rest]), channels)[0]
    clean = match_channels(clean, channels)[0]
    spread = np.concatenate([r.y for r in clean[:TRAIN]]).std(axis=0)
    rng = np.random.default_rng([SEED, sorted(BEDS).index(name)])
    train = noisy(clean[:TRAIN], NOISE * spread, rng)
    points = noisy(points, POINT_NOISE * spread, rng)
    (whole,) = points
    fits = {}
    for count in counts:
        some = made(points, [whole.u[:count]], [whole.y[:count]]) if count else None
        preset = "linear" if small else "quick"
        fits[count] = jnx.identify(train, preset=preset, at_rest=some)
    found: dict[str, Any] = {output.name: {} for output in few}
    for count, fit in fits.items():
        for name, error in errors(fit.value, clean[TRAIN:]).items():
            chosen = fit.stats["leaderboard"].choose(name)
            found[name][str(count)] = error | {
                "promised": chosen.promised,
                "chosen": f"{chosen.family}: {chosen.name}",
            }
    return found


def errors(network: jnx.Network, test: jnx.Dataset) -> dict[str, dict[str, Any]]:
    """NRMSE of the free run, pooled over the records; records that diverge."""
    run, told = jnx.simulate(network, test).value, {}
    for o, name in enumerate(network.output_names):
        parts = list(zip(test, run.outputs, run.scored, strict=True))
        y = np.concatenate([r.y[s[:, o], o] for r, _, s in parts])
        yhat = np.concatenate([found[s[:, o], o] for _, found, s in parts])
        error = float(np.sqrt(np.mean((y - yhat) ** 2)) / y.std())
        told[name] = {"test": error, "diverged": int(sum(d[o] for d in run.diverged))}
    return told


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beds", nargs="+", default=list(CHOSEN))
    parser.add_argument("--smoke", action="store_true", help="one bed, linear models")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    chosen = options.beds[:1] if options.smoke else options.beds
    counts = POINTS[:2] if options.smoke else POINTS
    told = {name: measure(name, counts, options.smoke) for name in chosen}
    rows = [row for bed in told.values() for row in bed.values()]
    summary = {
        f"{n} points over none": statistics.median(
            row[str(n)]["test"] / row["0"]["test"] for row in rows
        )
        for n in counts
        if n
    }
    for name, bed in told.items():
        for output, row in bed.items():
            line = "  ".join(f"{n}: {row[str(n)]['test']:.3f}" for n in counts)
            print(f"{name:9s} {output:12s} {line}")
    print(summary)
    folder = results_folder(options.results, smoke=options.smoke)
    record("at_rest", {"summary": summary, "beds": told}, folder=folder)


if __name__ == "__main__":
    main()
