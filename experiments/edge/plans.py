"""The next experiment: a record by `jnx.design.plan` beside one that fills the space.

A network is identified (preset quick) from two records of a virtual engine that keep to
the inner 40 % of its usual ranges, with 2 % noise. Then one more record of the same
length is run on the engine, within the usual ranges, rates and forbidden combinations:

- by `plan`, through the network, which also keeps a limit of the output;
- or filling the space: points of a Sobol sequence in turn, all inputs at a time, with
  holds as long as those of the bed's usual excitation, levels that the rates reach, no
  point and no way to it through a forbidden combination.

With either, the output is identified anew, and runs freely over noise-free records of
the whole usual ranges. Figures: errors, their ratio by seed, and what either record
broke. A plan knows the engine by the first network alone, so a limit can be broken
where that is wrong; the record that fills the space does not know of the limit.

    python experiments/edge/plans.py [--beds gtdi diesel] [--seeds 20]

Results: `experiments/benchmarks/results/plans.json`, seed by seed as they come, each
with the code that gave it; seeds that are there are not run again.
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
from run import INNER, noisy, records  # noqa: E402 # pyright: ignore

RECORDS, LENGTH, TESTS, TEST_ROWS = 2, 1500, 3, 2000
"""Records of the first network, samples of them and of the plan, test records."""
FIRST = 1000
"""Number of the first seed; those below served to make the plan."""


@dataclasses.dataclass(frozen=True)
class Task:
    """What is asked of a plan on a bed: the output, whose highest value in usual
    records is its limit, combinations that must not be, as shares of the ranges, how
    long levels are held [samples], and how many ranges a second inputs may move."""

    output: str
    forbidden: tuple[tuple[str, str, float, str, str, float], ...]
    hold: tuple[int, int]
    rate: float


TASKS = {
    # Much fuel with little air and little fuel with much would not burn.
    "gtdi": Task(
        "MAP",
        (
            ("THR", ">", 0.5, "FUL", "<", 0.25),
            ("THR", ">", 0.8, "FUL", "<", 0.5),
            ("THR", "<", 0.4, "FUL", ">", 0.5),
            ("THR", "<", 0.7, "FUL", ">", 0.85),
        ),
        (20, 120),
        10.0,
    ),
    "diesel": Task("p_em", (("EGR", ">", 0.6, "fuel", ">", 0.8),), (20, 100), 2),
}


def conditions(bed: str, task: Task) -> dict[str, Any]:
    """Ranges, rates, forbidden combinations and limits, as `plan` takes them."""
    import numpy as np

    usual = records(bed, 1.0, 3, 3, 3000)
    names = usual.channels.input_names
    u = np.concatenate([r.u for r in usual])
    o = usual.channels.output_names.index(task.output)
    low, high = u.min(axis=0), u.max(axis=0)
    ranges = {n: (float(a), float(b)) for n, a, b in zip(names, low, high, strict=True)}

    def at(name: str, share: float) -> float:
        a, b = ranges[name]
        return a + share * (b - a)

    y = np.concatenate([r.y[:, o] for r in usual])
    return {
        "ranges": ranges,
        "rates": {n: task.rate * (b - a) for n, (a, b) in ranges.items()},
        "forbidden": [
            f"{a} {more} {at(a, x):.6g} & {b} {less} {at(b, z):.6g}"
            for a, more, x, b, less, z in task.forbidden
        ],
        "limits": {task.output: float(y.max())},
    }


def fills(network: Any, asked: dict[str, Any], hold: Any, seed: int) -> Any:
    """Inputs that fill the space within all limits of the inputs."""
    import jax
    import numpy as np

    from jaxnarx.design.limits import limits_for
    from jaxnarx.excitation import sobol

    kept = limits_for(network, asked["ranges"], asked["rates"], asked["forbidden"], {})
    points = np.asarray(sobol(4096, kept.low, kept.high, key=jax.random.key(seed)))
    random = np.random.default_rng(seed)
    u = 0.5 * (kept.low + kept.high)[None]
    left = list(range(len(points)))
    while len(u) <= LENGTH:
        count = int(random.integers(hold[0], hold[1] + 1))
        for n in left:
            way = np.arange(1, count + 1)[:, None] * kept.rate[None]
            gap = points[n] - u[-1]
            part = u[-1] + np.clip(gap[None], -way, way)
            if kept.allows(part).all():
                left.remove(n)
                u = np.concatenate([u, part])
                break
        else:
            raise RuntimeError("no point can be reached")
    return u[1 : LENGTH + 1]


def run_on(bed: str, u: Any, seed: int, name: str) -> Any:
    """What the engine answers, with the noise of a measurement."""
    import jax

    from jaxnarx.engines import BEDS as MAKERS
    from jaxnarx.engines import records as made

    engine, key = MAKERS[bed](), jax.random.key(seed)
    clean = made(
        engine, key, [len(u)], noise=0, excite=lambda key, length: u, names=[name]
    )
    return clean, noisy(clean, seed)


def broken(task: Task, asked: dict[str, Any], network: Any, clean: Any) -> dict:
    """Share of the samples beyond each limit, and how far the output goes."""
    import numpy as np

    from jaxnarx.design.limits import limits_for

    kept = limits_for(network, asked["ranges"], asked["rates"], asked["forbidden"], {})
    u = clean.records[0].u
    o = clean.channels.output_names.index(task.output)
    highest = asked["limits"][task.output]
    step = np.abs(np.diff(u, axis=0))
    slack = 1e-9 * (kept.high - kept.low)
    outside = (u < kept.low - slack) | (u > kept.high + slack)
    over = np.maximum(clean.records[0].y[:, o] / highest - 1, 0.0)
    return {
        "ranges": float(np.mean(outside)),
        "rates": float(np.mean(step > kept.rate * (1 + 1e-9))),
        "forbidden": float(np.mean(~kept.allows(u))),
        "limit": float(np.mean(over > 0)),
        "beyond the limit": round(float(over.max()), 4),
    }


def error(network: Any, data: Any, output: str) -> float:
    """NRMSE of the free run, of records that are one."""
    import numpy as np

    import jaxnarx as jnx

    o = data.channels.output_names.index(output)
    run = jnx.simulate(network, data).value
    y = np.concatenate([r.y[:, o] for r in data])
    scored = np.concatenate([s[:, 0] for s in run.scored])
    off = np.concatenate([a[:, 0] for a in run.outputs]) - y
    if any(bool(d.any()) for d in run.diverged):
        return float("inf")
    return float(np.sqrt(np.mean(off[scored] ** 2)) / y[scored].std())


def one(bed: str, seed: int, candidates: int | None) -> dict[str, Any]:
    """All figures of one seed."""
    import jax

    import jaxnarx as jnx

    task = TASKS[bed]
    asked = conditions(bed, task)
    train = noisy(records(bed, INNER, seed, RECORDS, LENGTH), seed)
    tests = records(bed, 1.0, seed + 10_000, TESTS, TEST_ROWS)

    def identified(data: Any) -> Any:
        options: Any = {"preset": "quick", "candidates": candidates}
        return jnx.identify(data, outputs=[task.output], **options).value

    first = identified(train)
    begin = time.perf_counter()
    found = jnx.design.plan(
        *(first,), duration=LENGTH * float(train.sample_time), seed=seed, **asked
    )
    seconds = time.perf_counter() - begin
    row = {
        "seed": seed,
        "before": error(first, tests, task.output),
        "still": found.stats["still"],
        "outside": found.stats["outside"],
        "seconds of planning": round(seconds, 1),
    }
    inputs = {
        "plan": found.value.inputs,
        "filling": fills(first, asked, task.hold, seed),
    }
    for name, u in inputs.items():
        clean, measured = run_on(bed, jax.numpy.asarray(u), seed + 20_000, name)
        both = jnx.data.join([train, measured])
        row[name] = error(identified(both), tests, task.output)
        row[f"{name} broke"] = broken(task, asked, first, clean)
    row["ratio"] = row["plan"] / row["filling"]
    return row


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Over seeds."""
    import numpy as np

    ratio = np.array([row["ratio"] for row in rows])
    return {
        "ratio, median": round(float(np.median(ratio)), 3),
        "ratio, geometric mean": round(float(np.exp(np.mean(np.log(ratio)))), 3),
        "seeds with a lower error": int(np.sum(ratio < 1)),
        **{
            name: round(float(np.median([row[name] for row in rows])), 4)
            for name in ("before", "plan", "filling")
        },
        **{
            f"{name}: plans that broke it": int(
                sum(row["plan broke"][name] > 0 for row in rows)
            )
            for name in ("ranges", "rates", "forbidden", "limit")
        },
        "largest of plans beyond the limit": max(
            row["plan broke"]["beyond the limit"] for row in rows
        ),
    }


def main() -> None:
    """Bed by bed, seed by seed."""
    import jax

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beds", nargs="+", choices=TASKS, default=list(TASKS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=FIRST, help="number of the first")
    parser.add_argument("--candidates", type=int, help="most of a search")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="one short seed")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if options.smoke:
        global LENGTH, TEST_ROWS
        LENGTH, TEST_ROWS = 300, 300
        options.seeds, options.candidates, options.beds = 1, 3, ["diesel"]
    folder = results_folder(options.results, smoke=options.smoke)
    path = folder / "plans.json"
    figures = json.loads(path.read_text())["figures"] if path.exists() else {}
    for bed in options.beds:
        rows: list[dict[str, Any]] = figures.get(bed, {}).get("seeds", [])
        known = {row["seed"] for row in rows}
        for seed in range(options.first, options.first + options.seeds):
            if seed in known:
                continue
            row = one(bed, seed, options.candidates)
            row["code"] = code() | {"date": time.strftime("%Y-%m-%d")}
            rows = sorted([*rows, row], key=lambda each: each["seed"])
            print(bed, row, flush=True)
            asked = conditions(bed, TASKS[bed])
            figures[bed] = summary(rows) | {"asked": asked, "seeds": rows}
            record("plans", figures, folder=folder)


if __name__ == "__main__":
    main()
