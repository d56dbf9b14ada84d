"""Networks at the edge of what they have seen, on virtual engines, where the truth is
known outside too.

Every output of four beds is identified (`jaxnarx.identify`, preset quick) from four
records whose inputs keep to the inner 40 % of the bed's usual ranges, with 2 % noise.
Then it runs over noise-free records at 40, 50, 60, 80 and 100 % of them, that is up to
2.5 times the trained ranges, with inputs beyond theirs flagged, held, or going on to
first order: error by policy and by the index of the network's domain, rank correlation
of the index with the absolute error, alarms at 40 %. And it runs over records that no
engine would be given: steps, ramps and noise up to three times the trained ranges. Six
more noisy records within the trained ranges tell what 90 % intervals hold, in the whole
and by thirds of the output and of every input in use.

    python experiments/edge/run.py [--beds gtdi vct] [--wild 1000]

Results: `experiments/benchmarks/results/edge.json`, bed by bed as they come; beds that
are there stay unless they are named.
"""

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
sys.path.insert(0, str(HERE))
from common import code, record, results_folder  # noqa: E402 # pyright: ignore
from figures import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    SEED,
    SETTLED,
    correlation,
    ran_wild,
    tested,
    wild,
)

BEDS = "gtdi", "diesel", "vct", "pfi-dyno"
INNER, SHARES = 0.4, (0.4, 0.5, 0.6, 0.8, 1.0)
"""Share of the usual ranges in training, and in the records that are scored."""
RECORDS, LENGTH, SCORED, ROWS = 4, 2500, 2, 1500
"""Records and samples for training, and of every share that is scored."""
FRESH = 6
"""Noisy records within the trained ranges, of which intervals are to hold 90 %."""
NOISE = 0.02
POLICIES = "flag", "hold", "linear"
EDGES = 0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0
WILD_ROWS = 600


def records(bed: str, share: float, seed: int, count: int, length: int) -> Any:
    """Noise-free records whose inputs keep to a share of the usual ranges; inputs of
    two levels stay what they are."""
    import jax
    import numpy as np

    from jaxnarx.engines import BEDS as MAKERS
    from jaxnarx.engines import records as made

    engine = MAKERS[bed]()
    usual = np.concatenate(
        [np.asarray(engine.excite(jax.random.key(k), 2000)) for k in range(3)]
    )
    middle = 0.5 * (usual.min(axis=0) + usual.max(axis=0))
    levels = np.array([len(np.unique(column)) for column in usual.T])
    part = np.where(levels <= 2, 1.0, share)

    def excite(key: Any, length: int) -> Any:
        u = np.asarray(engine.excite(key, length))
        return middle[None] + (u - middle[None]) * part[None]

    key = jax.random.fold_in(jax.random.key(SEED), seed)
    return made(engine, key, [length] * count, noise=0, excite=excite)


def noisy(data: Any, seed: int) -> Any:
    """The records with white noise of 2 % of each output's standard deviation."""
    import numpy as np

    random = np.random.default_rng(seed)
    spread = NOISE * np.concatenate([r.y for r in data]).std(axis=0)
    every = [
        dataclasses.replace(r, y=r.y + spread[None] * random.normal(size=r.y.shape))
        for r in data
    ]
    return dataclasses.replace(data, records=tuple(every))


def scored(network: Any, data: Any, output: str, spread: float) -> tuple[Any, Any, int]:
    """Absolute errors in standard deviations of the training, and the index; records
    that diverge."""
    import numpy as np

    import jaxnarx as jnx

    o = data.channels.output_names.index(output)
    run = jnx.simulate(network, data).value
    index = jnx.domain(network, data).value.index
    errors = [
        np.abs(r.y[SETTLED:, o] - y[SETTLED:, 0]) / spread
        for r, y in zip(data, run.outputs, strict=True)
    ]
    far = np.concatenate([i[SETTLED:] for i in index])
    return np.concatenate(errors), far, sum(bool(d.any()) for d in run.diverged)


def one(output: str, train: Any, tests: Any, fresh: Any, asked: Any) -> dict[str, Any]:
    """All figures of one output."""
    import numpy as np

    import jaxnarx as jnx
    from jaxnarx.models import hold_to_range
    from jaxnarx.refinement import rate_of

    begin = time.perf_counter()
    fit = jnx.identify(
        train, preset="quick", outputs=[output], candidates=asked.candidates
    )
    row = fit.stats["leaderboard"].choose(output)
    network, o = fit.value, train.channels.output_names.index(output)
    spread = float(np.concatenate([r.y[:, o] for r in train]).std())
    figures: dict[str, Any] = {
        "chosen": None if row is None else f"{row.family}: {row.name}",
        "left out": None if row is None else row.free_run,
        "seconds": round(time.perf_counter() - begin, 1),
        "rate certified": None if network.certificate is None else rate_of(network),
    }
    if network.domain is None:
        return figures
    strange = wild(network, train, asked.wild, WILD_ROWS)
    for policy in POLICIES:
        held = hold_to_range(network, outside=policy)
        every = [scored(held, data, output, spread) for data in tests]
        error, index = (np.concatenate([e[k] for e in every]) for k in (0, 1))
        at = np.digitize(index, EDGES) - 1
        outside = [round(float(np.mean(i > 1)), 3) for _, i, _ in every]
        figures[policy] = {
            "nrmse": [round(float(np.sqrt(np.mean(e**2))), 4) for e, _, _ in every],
            "diverged": [bad for *_, bad in every],
            "by index": [
                round(float(np.sqrt(np.mean(error[at == k] ** 2))), 4)
                if np.sum(at == k) > SETTLED
                else None
                for k in range(len(EDGES))
            ],
            "spearman": correlation(index, error),
            "wild": ran_wild(held, strange),
        }
        if policy == network.outside:
            inside = float(np.sqrt(np.mean(error[index <= 1] ** 2)))
            figures["pool"] = {"index": index, "error": error, "inside": inside}
            figures["outside"] = outside
    figures["policy"] = network.outside
    figures["intervals"] = tested(network, fresh, train)["outputs"][output]
    return figures


def pooled(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Rank correlation over all outputs, errors in standard deviations of the training
    and in the error of the same network inside of its domain."""
    import numpy as np

    pools = [row.pop("pool") for row in rows if "pool" in row]
    if not pools:
        return {}
    index = np.concatenate([p["index"] for p in pools])
    plain = np.concatenate([p["error"] for p in pools])
    scaled = np.concatenate([p["error"] / p["inside"] for p in pools])
    return {
        "spearman": correlation(index, plain),
        "spearman, errors in those inside": correlation(index, scaled),
        "samples": len(index),
    }


def main() -> None:
    """Bed by bed."""
    import jax

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beds", nargs="+", choices=BEDS, default=BEDS)
    parser.add_argument("--wild", type=int, default=1000, help="wild records")
    parser.add_argument("--candidates", type=int, help="most of an output")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="one output, few samples")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    path = folder / "edge.json"
    figures = json.loads(path.read_text())["figures"] if path.exists() else {}
    beds, length, rows = options.beds, LENGTH, ROWS
    if options.smoke:
        beds, length, rows = BEDS[-1:], 400, 300
        options.wild, options.candidates = 4, 3
    for bed in beds:
        train = noisy(records(bed, INNER, 1, RECORDS, length), 1)
        tests = [
            records(bed, share, 100 + n, SCORED, rows) for n, share in enumerate(SHARES)
        ]
        fresh = noisy(records(bed, INNER, 50, FRESH, rows), 50)
        outputs = train.channels.output_names[: 1 if options.smoke else None]
        found = {}
        for output in outputs:
            found[output] = one(output, train, tests, fresh, options)
            told = {k: v for k, v in found[output].items() if k != "pool"}
            print(bed, output, told, flush=True)
        whole = pooled(list(found.values()))
        when = code() | {"date": time.strftime("%Y-%m-%d")}
        figures[bed] = {"outputs": found, "pooled": whole, "code": when}
        record("edge", figures, folder=folder)


if __name__ == "__main__":
    main()
