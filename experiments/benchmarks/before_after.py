"""Two versions of the package in one run, in turns: is anything slower?

    git worktree add ../before COMMIT
    python experiments/benchmarks/before_after.py --before ../before

Each version is measured by the workers of its own checkout, which know its interface:
selection of 15 of 13,244 terms at 10,000 samples, free run and gradient at 1,800,
growth to 16 models at 1,500, a sweep of fits of 1,000. Every round starts a fresh
process for each version, the order changing by round; a figure is the best of all
rounds, since what else runs on a machine only ever adds. `after` over `before` should
stay below 1.05.
"""

import argparse
import json
import os
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import growth
import selection_workers
import simulation_workers
import sweep_workers
from common import ROOT, child, record, results_folder, target
from selection_data import make_data

LIMIT = 1.05


def select_terms(small: bool) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "data.npz")
        make_data(path, 1_000 if small else 10_000)
        found = selection_workers.run_select(path, 2 if small else 3, 5, "candidate")
    return {"select": found["best_wall_s"]}


def simulate(small: bool) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "run.npz")
        size = (300, 2) if small else (1_800, 40)
        times = simulation_workers.run_model(path, *size, False)["times"]
    return {name: times[name]["best"] for name in ("free_run", "loss_and_gradient")}


def grow(small: bool) -> dict[str, float]:
    rows, models = (300, 4) if small else (1_500, 16)
    return {"grow": growth.ours(rows, models, 10, False)["one"]["best"]}


def sweep(small: bool) -> dict[str, float]:
    size = (200, 4, 2) if small else (1_000, 96, 32)
    found = sweep_workers.sweep(*size, 1)
    return {"fit in a sweep": found["seconds"] / found["fits"]}


WORKERS = {f.__name__: f for f in (select_terms, simulate, grow, sweep)}


def measure(before: Path, rounds: int, smoke: bool) -> dict[str, Any]:
    """Best seconds of every figure with either package, and the median over the rounds
    of their ratio: on a shared machine the best of each says less."""
    versions, times = {"before": before, "after": ROOT}, {}
    # Small ones in one process: its start takes longer than they do.
    parts = [tuple(WORKERS)] if smoke else [(name,) for name in WORKERS]
    for n in range(rounds):
        for names in parts:
            for version in sorted(versions, reverse=bool(n % 2)):
                found = call(names, versions[version], smoke)
                print(f"round {n + 1}, {version}: {found}", flush=True)
                for figure, seconds in found.items():
                    row = times.setdefault(figure, {"before": [], "after": []})
                    row[version].append(seconds)
    return {figure: compared(**row) for figure, row in times.items()}


def compared(before: list[float], after: list[float]) -> dict[str, Any]:
    """Of a figure's seconds, round by round."""
    ratios = [b / a for a, b in zip(before, after, strict=True)]
    ratio = target(round(statistics.median(ratios), 3), LIMIT)
    return {"before": min(before), "after": min(after), "ratio": ratio}


def call(names: Sequence[str], checkout: Path, smoke: bool) -> dict[str, float]:
    """Workers of that checkout in a fresh process, with its package."""
    own = checkout / Path(__file__).resolve().relative_to(ROOT)
    arguments = [sys.executable, str(own), "--worker", *names]
    path = os.pathsep.join(filter(None, (str(checkout), os.environ.get("PYTHONPATH"))))
    done = child(
        arguments + ["--smoke"] * smoke, environment={"PYTHONPATH": path}, cwd=checkout
    )
    if done.code:
        raise SystemExit(f"{names} failed in {checkout.name}:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", metavar="DIR", help="a checkout of another version")
    parser.add_argument("--rounds", type=int, default=4, help="turns of each version")
    parser.add_argument("--smoke", action="store_true", help="everything small, once")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--note", default="", help="a remark kept with the figures")
    parser.add_argument("--worker", nargs="+", choices=WORKERS)
    options = parser.parse_args()
    if options.worker:
        found = {}
        for name in options.worker:
            found |= WORKERS[name](options.smoke)
        print(json.dumps(found))
        return
    before = Path(options.before or ROOT).resolve()
    rounds = 1 if options.smoke else options.rounds
    figures = measure(before, rounds, options.smoke)
    folder = results_folder(options.results, smoke=options.smoke)
    record("before_after", figures, folder=folder, note=options.note)
    for figure, row in figures.items():
        print(
            f"{figure}: {row['before']:.4g} s -> {row['after']:.4g} s, {row['ratio']}"
        )


if __name__ == "__main__":
    main()
