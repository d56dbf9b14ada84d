"""New engines calibrated from few samples, by what is learnt from a fleet.

Virtual engines of four beds, every parameter off by about a tenth: 64 donors of 1,000
samples choose terms together (20 of second degree, of inputs, their last value and four
filters), and tell the population; 32 others are calibrated by 10 to 500 samples behind
a warm-up of 64, from the excitation of the donors and from another one, and judged by
the free run on the last 400 samples of that record without noise.

    python experiments/fleets/calibration.py [--beds pfi vct] [--seeds 11 12] [--many]

Rules were set with seed 3, which is none of those here. `as is`, `offset and gain`,
`prior` and `own fit` are the ways alone: a prior by the weight that donors advise, an
own fit by the best of its ridges, known afterwards. `own, all` has all samples of the
record that is judged but the judged ones, and the best ridge too. `automatic` is what
`jnx.fleet.calibrate` returns. Intervals are those of its networks, nominal .9, on
measured samples with noise.

`--many` is about one bed with many donors: the error by their number, and what ten
broken ones among 1,024 do.
"""

import argparse
import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxnarx as jnx
from jaxnarx.fleet.information import (
    Information,
    gather_information,
    parts_of,
    skip_begin,
)
from jaxnarx.fleet.rivals import KINDS, at_samples, choose, estimate_each

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "benchmarks"), str(HERE.parent / "engine_sweep")]
import beds  # noqa: E402 # pyright: ignore[reportMissingImports]
from common import record, results_folder  # noqa: E402 # pyright: ignore

DONORS, NEW = 64, 32
LENGTHS = 1000, 50, 1000
SAMPLES = 10, 20, 50, 100, 200, 500
JUDGED_FROM = 600
"""Sample of the record from which it judges."""
FILTERS = 1, 4, 16, 64
"""Times of the filters [samples]."""
TERMS = 20
SPREAD = 0.1
LEVEL = 0.9
COVERED_AT = 20, 100
"""Numbers of samples at which intervals are judged."""
COUNTS = 8, 16, 32, 64, 128, 256, 512, 1024
BROKEN = 10


class Engines(Mapping[str, jnx.Dataset]):
    """Records of some engines of a bed, made when they are asked for."""

    def __init__(self, records: Any, members: list[int], part: str, seed: int):
        self.records, self.part, self.seed = records, part, seed
        self.members = {records.names[n]: n for n in members}
        self.engine = records.bed.make()
        names = self.engine.channels.output_names
        self.column = names.index(records.bed.output)

    def __len__(self) -> int:
        return len(self.members)

    def __iter__(self):
        return iter(self.members)

    def __getitem__(self, name: str) -> jnx.Dataset:
        return self.dataset(name, noisy=True)

    def dataset(self, name: str, *, noisy: bool) -> jnx.Dataset:
        """One record, with the noise of the bed or without."""
        n, bed = self.members[name], self.records.bed
        u = self.records.inputs[self.part][n]
        y = self.records.outputs[self.part][n][:, self.column]
        if noisy:
            level = self.engine.noise[bed.output]
            size = level.absolute + level.relative * np.abs(y)
            draw = np.random.default_rng([self.seed, n, len(self.part)])
            y = y + size * draw.normal(size=len(y))
        return jnx.Dataset.from_arrays(
            [u],
            [y[:, None]],
            inputs=list(self.engine.channels.inputs),
            outputs=[self.engine.channels.outputs[self.column]],
            sample_time=bed.down * self.engine.sample_time,
            names=[name],
        )


def whole_engines(records: Any) -> list[int]:
    """Members of the family whose records are finite."""
    count = len(records.factors)
    parts = [records.outputs[p][:count] for p in ("train", "test")]
    fine = [np.isfinite(y).all(axis=(1, 2)) for y in parts]
    return np.flatnonzero(np.logical_and(*fine)).tolist()


def method(data: jnx.Dataset) -> jnx.Identification:
    """How the structure is chosen from donors together."""
    step = float(data.sample_time)
    return jnx.Identification(
        pool=jnx.Polynomial(
            outputs=list(data.channels.output_names),
            input_lags=(0, 1),
            output_lags=(),
            degree=2,
            filters=tuple(step * n for n in FILTERS),
        ),
        select=jnx.ForwardOLS(max_terms=TERMS),
        refine=None,
    )


def cut(data: jnx.Dataset, rows: int) -> jnx.Dataset:
    """The first rows of a record."""
    one = data.records[0]
    return jnx.Dataset.from_arrays(
        [one.u[:rows]],
        [one.y[:rows]],
        inputs=list(data.channels.inputs),
        outputs=list(data.channels.outputs),
        sample_time=data.sample_time,
    )


def on_host(sums: Information) -> Information:
    """Sums of all parts together."""
    return Information(*map(np.asarray, sums)).total()


def judge_of(prior: Any, clean: jnx.Dataset) -> Any:
    """The NRMSE of coefficients on the last samples, exact as the run is linear in
    them."""
    runs = jnx.prepare(prior.network, clean)
    seen = np.asarray(runs.scored)[..., 0] & (
        np.arange(runs.scored.shape[1])[None] >= JUDGED_FROM
    )
    part = jax.device_put(np.where(seen, 0, -1))
    zero = np.zeros(len(prior.coefficients.free))
    sums = on_host(gather_information(prior.coefficients, zero, runs, part, 1))
    spread = np.asarray(runs.drive.measured)[..., 0][seen].std()
    count = float(sums.samples[0])
    return lambda v: float(np.sqrt(sums.loss(v)[0] / count) / spread)


def ways_of(prior: Any, few: jnx.Dataset) -> dict[str, list[np.ndarray]]:
    """Coefficients by every way; of an own fit by every ridge."""
    runs = skip_begin(jnx.prepare(prior.network, few), prior.warm_up)
    zero = np.zeros(len(prior.coefficients.free))
    part = jax.device_put(parts_of(runs, ()))
    sums = on_host(gather_information(prior.coefficients, zero, runs, part, 1))
    ways = prior.rivals
    noise = np.asarray(prior.population.noise)
    one = Information(*(np.asarray(a)[None] for a in sums))
    given = ways.weight, ways.mean, ways.root
    found = estimate_each(one, zero, 1 / noise, *given)[0]
    told = at_samples(prior.rungs, prior.ladder, float(sums.samples[0]))
    alone = np.array([kind == "prior" for kind in ways.kinds])
    score = np.where(alone[:, None], told, np.inf)
    colour = np.asarray(prior.population.colour)
    samples = np.asarray(sums.samples)
    best = int(choose(ways, score, score, samples, colour)[0][0])
    every: dict[str, list[np.ndarray]] = {kind: [] for kind in KINDS}
    every["prior"] = [found[best]]
    for kind, v in zip(ways.kinds, found, strict=True):
        if kind != "prior":
            every[kind].append(v)
    return every


def calibrated(prior: Any, engines: Engines, samples: int) -> dict[str, Any]:
    """Errors of all engines by every way, and how their intervals hold."""
    errors: dict[str, list[float]] = {}
    inside, seconds = [], []
    for name in engines:
        data, clean = engines[name], engines.dataset(name, noisy=False)
        judge = judge_of(prior, clean)
        few = cut(data, samples + prior.warm_up)
        for kind, tried in ways_of(prior, few).items():
            errors.setdefault(kind, []).append(min(map(judge, tried)))
        begin = time.perf_counter()
        found = jnx.fleet.calibrate(prior, few)
        seconds.append(time.perf_counter() - begin)
        errors.setdefault("automatic", []).append(judge(found.stats["coefficients"]))
        if samples == SAMPLES[-1]:
            full = ways_of(prior, cut(data, JUDGED_FROM))["own fit"]
            errors.setdefault("own, all", []).append(min(map(judge, full)))
        if samples in COVERED_AT:
            held = jnx.intervals(found.value, data, level=LEVEL).value
            y = data.records[0].y[JUDGED_FROM:]
            low, high = (a[0][JUDGED_FROM:] for a in (held.lower, held.upper))
            inside.append(float(np.mean((y >= low) & (y <= high))))
    told = {
        kind: {"median": float(np.median(e)), "worst": float(np.max(e))}
        for kind, e in errors.items()
    }
    more: dict[str, Any] = {"seconds, median": float(np.median(seconds))}
    if inside:
        more["covered, mean"] = float(np.mean(inside))
    return told | more


def bed_table(name: str, seed: int, folder: Path, small: bool) -> dict[str, Any]:
    """All figures of a bed and a seed."""
    donors, new = (8, 3) if small else (DONORS, NEW)
    size = beds.Size(
        engines=donors + new + (2 if small else 8),
        repetitions=1,
        lengths=LENGTHS,
        spread=SPREAD,
        seed=seed,
    )
    records = beds.records_of(name, size, folder)
    whole = whole_engines(records)
    some = Engines(records, whole[:donors], "train", seed)
    begin = time.perf_counter()
    found = jnx.fleet.learn(some, method(some[next(iter(some))]))
    seconds = time.perf_counter() - begin
    rest = whole[donors : donors + new]
    table: dict[str, Any] = {
        "seconds of learning": round(seconds, 1),
        "broken": list(found.stats["broken"]),
        "colour": float(found.stats["colour"][0]),
    }
    for part, said in (("train", "like the donors"), ("test", "another excitation")):
        engines = Engines(records, rest, part, seed)
        table[said] = {
            n: calibrated(found.value, engines, n)
            for n in (SAMPLES[:2] + SAMPLES[-1:] if small else SAMPLES)
        }
    return table


def summary(tables: dict[str, dict[int, Any]]) -> dict[str, Any]:
    """Medians over seeds of medians, and of ratios to the best way and to own fits."""
    told: dict[str, Any] = {}
    for bed, seeds in tables.items():
        for said in ("like the donors", "another excitation"):
            rows: dict[str, Any] = {}
            every = [t[said] for t in seeds.values()]
            for n in every[0]:
                kinds = (*KINDS, "automatic")
                at = {
                    k: float(np.median([t[n][k]["median"] for t in every]))
                    for k in kinds
                }
                worst = {
                    k: float(np.median([t[n][k]["worst"] for t in every]))
                    for k in kinds
                }
                best = [min(t[n][k]["median"] for k in KINDS) for t in every]
                auto = [t[n]["automatic"]["median"] for t in every]
                ratio = np.array(auto) / np.array(best)
                rows[str(n)] = {
                    "median": at,
                    "worst": worst,
                    "automatic over best": float(np.median(ratio)),
                    "automatic over best, of all seeds": ratio.round(3).tolist(),
                }
            last = list(every[0])[-1]
            own = [t[last]["own, all"]["median"] for t in every]
            first = [t[list(t)[1]]["automatic"]["median"] for t in every]
            rows["own, all"] = float(np.median(own))
            rows["20 samples over own, all"] = float(
                np.median(np.array(first) / np.array(own))
            )
            held = [
                row["covered, mean"]
                for t in every
                for row in t.values()
                if "covered, mean" in row
            ]
            rows["covered"] = float(np.mean(held)) if held else None
            told[f"{bed}, {said}"] = rows
    return told


def many(folder: Path, small: bool) -> dict[str, Any]:
    """Errors by the number of donors; broken ones among them."""
    counts = (8, 16) if small else COUNTS
    new, broken = (3, 1) if small else (NEW, BROKEN)
    size = beds.Size(
        engines=counts[-1] + new + 8,
        repetitions=1,
        lengths=LENGTHS,
        spread=SPREAD,
        seed=21,
    )
    records = beds.records_of("pfi", size, folder)
    whole = whole_engines(records)
    engines = Engines(records, whole[-new:], "test", 21)
    donors = Engines(records, whole[: counts[-1]], "train", 21)
    network = jnx.fleet.learn(
        Engines(records, whole[: counts[min(3, len(counts) - 1)]], "train", 21),
        method(donors[next(iter(donors))]),
    ).value.network
    by_count: dict[str, Any] = {}
    prior = None
    for count in counts:
        begin = time.perf_counter()
        some = Engines(records, whole[:count], "train", 21)
        found = jnx.fleet.learn(some, network)
        prior = found.value
        seconds = time.perf_counter() - begin
        rows = {str(n): calibrated(prior, engines, n) for n in SAMPLES[:3]}
        by_count[str(count)] = {
            "seconds of learning": round(seconds, 1),
            "broken": list(found.stats["broken"]),
            "automatic": {n: r["automatic"]["median"] for n, r in rows.items()},
            "prior": {n: r["prior"]["median"] for n, r in rows.items()},
        }
        print(count, by_count[str(count)], flush=True)
    names = list(donors)
    spoilt = Spoilt(donors, names[:: len(names) // broken][:broken])
    found = jnx.fleet.learn(spoilt, network)
    after = {str(n): calibrated(found.value, engines, n) for n in SAMPLES[:3]}
    last = by_count[str(counts[-1])]
    named = set(found.stats["broken"])
    return {
        "by donors": by_count,
        "broken": {
            "spoilt": spoilt.which,
            "named": sorted(named),
            "all named": named >= set(spoilt.which),
            "named beside": sorted(named - set(spoilt.which) - set(last["broken"])),
            "error over that without": {
                n: r["automatic"]["median"] / last["automatic"][n]
                for n, r in after.items()
            },
        },
    }


class Spoilt(Mapping[str, jnx.Dataset]):
    """Donors, some of whose records are spoilt, in five ways in turn."""

    def __init__(self, donors: Engines, which: list[str]):
        self.donors, self.which = donors, which

    def __len__(self) -> int:
        return len(self.donors)

    def __iter__(self):
        return iter(self.donors)

    def __getitem__(self, name: str) -> jnx.Dataset:
        data = self.donors[name]
        if name not in self.which:
            return data
        one, way = data.records[0], self.which.index(name) % 5
        u, y = one.u.copy(), one.y.copy()
        if way == 0:
            y = 3.6 * y  # another unit
        elif way == 1:
            y[200:] = y[200]  # a sensor that hangs
        elif way == 2:
            u = np.roll(u, 150, axis=0)  # files out of step
        elif way == 3:
            y[::40] = y.max() * 3  # spikes
        else:
            y = y.mean() + y.std() * np.random.default_rng(1).normal(size=y.shape)
        return jnx.Dataset.from_arrays(
            [u],
            [y],
            inputs=list(data.channels.inputs),
            outputs=list(data.channels.outputs),
            sample_time=data.sample_time,
            names=[name],
        )


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beds", nargs="+", default=list(beds.BEDS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[11, 12, 13, 14, 15])
    parser.add_argument("--many", action="store_true", help="many donors of one bed")
    parser.add_argument("--smoke", action="store_true", help="few engines")
    parser.add_argument("--cache", type=Path, help="folder of simulated records")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    cache = options.cache or folder / "engines"
    if options.many:
        record("fleet_donors", many(cache, options.smoke), folder=folder)
        return
    chosen, seeds = options.beds, options.seeds
    if options.smoke:
        chosen, seeds = chosen[:1], seeds[:1]
    path = folder / "fleet_calibration.json"
    tables: dict[str, dict[int, Any]] = {}
    if path.exists() and not options.smoke:
        kept = json.loads(path.read_text())["figures"]["beds"]
        tables = {b: {int(s): t for s, t in own.items()} for b, own in kept.items()}
    for name in chosen:
        for seed in seeds:
            table = bed_table(name, seed, cache, options.smoke)
            table = json.loads(json.dumps(table))
            tables.setdefault(name, {})[seed] = table
            print(name, seed, json.dumps(table["another excitation"]), flush=True)
            figures = {"summary": summary(tables), "beds": tables}
            record("fleet_calibration", figures, folder=folder)


if __name__ == "__main__":
    main()
