"""What every kind of candidate is worth, by whole identifications of simulated plants.

The six plants of `plants.py`, `jaxnarx.identify` by its default on a record of each: of
the best candidate of every kind what groups left out promise, and what another record
without noise says.

    python experiments/public/kinds.py [--plants tanks drives] [--seeds 2]

Results: `experiments/benchmarks/results/kinds.json`.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).resolve().parent))
from common import record, results_folder  # noqa: E402 # pyright: ignore
from plants import LENGTH, PLANTS, records  # noqa: E402 # pyright: ignore

KINDS = "closed form", "fed back", "hidden, products", "hidden, regions"
FED_BACK = "polynomial NARX", "LOLIMOT", "tree"


def kind(row: Any) -> str:
    """Of a candidate."""
    if row.family == "hidden states":
        return KINDS[3] if "regions" in row.name else KINDS[2]
    return KINDS[1] if row.family in FED_BACK else KINDS[0]


def identified(name: str, seed: int, small: bool) -> dict[str, Any]:
    """The best of every kind, and which is taken."""
    import jaxnarx as jnx
    from jaxnarx.identification.cross_validate import score
    from jaxnarx.identification.search_folder import read_search

    train, test, spread = records(name, seed, 300 if small else LENGTH)
    begin, found = time.perf_counter(), {}
    with tempfile.TemporaryDirectory() as folder:
        preset = "linear" if small else "good"
        fit = jnx.identify(train, preset=preset, folder=folder)
        seconds = time.perf_counter() - begin
        search, board = read_search(Path(folder)), fit.stats["leaderboard"]
        chosen = board.choose("y")
        rows = [row for row in board.rows if row.eligible]
        for row in sorted(rows, key=lambda row: -row.free_run):
            error, _, diverged = score(search.network(row.number), test, spread)
            found[kind(row)] = {
                "name": row.name,
                "promised": row.free_run,
                "true": None if diverged else error**0.5,
                "operations": row.operations,
            }
    error, _, diverged = score(fit.value, test, spread)
    return {
        "plant": name,
        "seed": seed,
        "seconds": round(seconds, 1),
        "candidates": len(board),
        "chosen": {
            "kind": kind(chosen),
            "name": chosen.name,
            "promised": chosen.free_run,
            "true": None if diverged else error**0.5,
        },
        "best": found,
    }


def main() -> None:
    """Identify, score, record."""
    import jax

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=list(PLANTS))
    parser.add_argument("--seeds", type=int, default=1, help="records of each plant")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="linear, short, one plant")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    path = folder / "kinds.json"
    cases = json.loads(path.read_text())["figures"] if path.exists() else {}
    for name in options.plants[:1] if options.smoke else options.plants:
        for seed in range(options.seeds):
            if f"{name} {seed}" in cases:
                continue
            found = identified(name, seed, options.smoke)
            print(json.dumps(found, indent=1), flush=True)
            cases[f"{name} {seed}"] = found
            record("kinds", cases, folder=folder)


if __name__ == "__main__":
    main()
