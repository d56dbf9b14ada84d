"""How well errors on blocks left out tell what a model with hidden states is worth.

Six plants with hidden states, one record of 700 samples with 1 % noise each, and
another of 1,500 without noise that says the truth. Every structure is judged twice: as
`identify` does it, each network trained once more without a block from where it stands,
and by training from the linear starts without the block.

    python experiments/public/choosing.py [--plants tanks drives] [--seeds 2]

Of each way: the rank correlation of its errors with the truth, over all structures and
pulls of a plant that it has not vetoed; how many it has vetoed, and of those how many
do not diverge in truth; and the true error of the one with the smallest error by it, as
a multiple of the smallest true one. Results:
`experiments/benchmarks/results/choosing.json`.
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).resolve().parent))
from common import record, results_folder  # noqa: E402 # pyright: ignore
from plants import LENGTH, PLANTS, records  # noqa: E402 # pyright: ignore

STRUCTURES = (2, 2), (3, 2), (4, 2), (2, 3)
"""Number of states and degree."""
PULLS = 0.3, 0.1, 0.03, 0.01, 0.001
WINDOW, GAP = 20, 25
WAYS = "refitted", "from starts"


# estimates and truth -----------------------------------------------------------------


def tried(name: str, seed: int, small: bool) -> list[dict[str, Any]]:
    """Every structure and pull: the truth, and errors on blocks left out both ways."""
    from jaxnarx.data import groups
    from jaxnarx.errors import JaxnarxError
    from jaxnarx.identification.cross_validate import cross_validate, fit_method, score
    from jaxnarx.settings import HiddenStates

    train, test, spread = records(name, seed, 300 if small else LENGTH)
    blocks, rows = groups(train, gap=GAP), []
    for states, degree in STRUCTURES[:1] if small else STRUCTURES:
        method = HiddenStates(
            states=states, degree=degree, shrink=PULLS, window=WINDOW, max_steps=40
        )
        if small:
            method = replace(method, start="subspace", max_steps=2, first_steps=2)
        begin = time.perf_counter()
        try:
            networks = fit_method(method, blocks.exclude_group(train))
        except (JaxnarxError, np.linalg.LinAlgError) as error:
            print(name, seed, states, degree, error)
            continue
        refitted = cross_validate(method, train, blocks, spread)
        seconds = time.perf_counter() - begin
        starts = from_starts(method, train, blocks, spread)
        for n, pull in enumerate(PULLS):
            error, _, diverged = score(networks[n], test, spread)
            row: dict[str, Any] = {"states": states, "degree": degree, "pull": pull}
            row |= {"truth": error**0.5, "diverges": bool(diverged)}
            one = refitted[n]
            row["refitted"] = None if not one.complete else pooled(one.losses)
            row["from starts"] = starts[n]
            rows.append(row | {"plant": name, "seed": seed})
            print(row, flush=True)
        print(f"{time.perf_counter() - begin:.0f} s, {seconds:.0f} of them refitted")
    return rows


def pooled(losses: Any) -> float:
    """Root of the mean over blocks, which are of one length."""
    return float(np.sqrt(np.nanmean(losses)))


def from_starts(method: Any, train: Any, blocks: Any, spread: float) -> list[Any]:
    """Errors of every pull, trained from linear models without each block; None where
    a run diverges or nothing can be trained."""
    from jaxnarx.errors import JaxnarxError
    from jaxnarx.identification.cross_validate import fit_method, score

    losses = np.full((len(PULLS), len(blocks)), np.nan)
    for g, fold in enumerate(blocks.folds(train, whole=True)):
        try:
            networks = fit_method(method, blocks.exclude_group(train, g))
        except (JaxnarxError, np.linalg.LinAlgError):
            return [None] * len(PULLS)
        for n, network in enumerate(networks):
            error, _, diverged = score(network, fold.left, spread)
            losses[n, g] = np.inf if diverged else error
    return [None if np.isinf(own).any() else pooled(own) for own in losses]


def told(rows: list[dict[str, Any]], way: str) -> dict[str, Any]:
    """How well one way tells the truth, over the rows of one record."""
    able = [row for row in rows if row[way] is not None]
    lost = [row for row in rows if row[way] is None]
    out: dict[str, Any] = {
        "vetoed": len(lost),
        "of them sound": sum(not row["diverges"] for row in lost),
    }
    if len(able) > 2:
        ours, truth = ([row[key] for row in able] for key in (way, "truth"))
        ranked: Any = scipy.stats.spearmanr(ours, truth)
        out["rank correlation"] = float(ranked.statistic)
    least = min(row["truth"] for row in rows)
    if able:
        chosen = min(able, key=lambda row: row[way])
        out["chosen over best"] = chosen["truth"] / least
        out["promised over true"] = chosen[way] / chosen["truth"]
    return out


def main() -> None:
    """Try, compare, record."""
    import jax

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=list(PLANTS))
    parser.add_argument("--seeds", type=int, default=1, help="records of each plant")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="one structure, short")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    path = folder / "choosing.json"
    cases = json.loads(path.read_text())["figures"]["cases"] if path.exists() else {}
    for name in options.plants[:1] if options.smoke else options.plants:
        for seed in range(options.seeds):
            if f"{name} {seed}" in cases:
                continue
            rows = tried(name, seed, options.smoke)
            if rows:
                case = {way: told(rows, way) for way in WAYS}
                cases[f"{name} {seed}"] = case | {"rows": rows}
            record(
                "choosing", {"cases": cases, "medians": medians(cases)}, folder=folder
            )
    print(json.dumps(medians(cases), indent=1))


def medians(cases: dict[str, Any]) -> dict[str, Any]:
    """Of every figure over the records."""
    found: dict[str, Any] = {}
    for way in WAYS:
        every = [case[way] for case in cases.values()]
        keys = dict.fromkeys(key for one in every for key in one)
        found[way] = {
            key: float(np.median([one[key] for one in every if key in one]))
            for key in keys
        }
    return found


if __name__ == "__main__":
    main()
