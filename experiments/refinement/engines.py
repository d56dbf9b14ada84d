"""What joint refinement adds to LOLIMOT on two virtual engines, over twenty seeds.

`pfi`: speed under the air bleed valve, as in `jaxnarx demo`. `gtdi`: torque under the
bed's usual excitation. Every seed has its own excitation and noise, one record each for
training, validation and test. LOLIMOT grows six affine models by AICc; then everything,
coefficients, centres and widths, is refined on the free run, guarded by the validation
record. The gain is the test free-run NRMSE before over that after.

    python experiments/refinement/engines.py [--smoke] [--results DIR]

Rows are written as they come; a second run goes on where the first stopped.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxnarx as jnx
from jaxnarx.engines import Gtdi, pfi_siso_records, records

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from common import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    record,
    results_folder,
)

SEEDS, MODELS, TERMS = 20, 6, 12
PARTS = ("train", "validate", "test")
BEDS: dict[str, dict[str, Any]] = {
    "pfi": {
        "output": "speed",
        "input_lags": (2, 3, 4, 6, 8, 12, 16, 24),
        "scheduling": ("duty[t-3]", "speed[t-1]"),
    },
    "gtdi": {
        "output": "TRQ",
        "input_lags": (0, 1, 2, 4, 8),
        "scheduling": ("speed[t]", "THR[t]"),
    },
}
METHOD = jnx.SimulationError(
    horizons=(30, 300), window_steps=10, max_steps=20, train="joint"
)
"""Not the default: with the coefficients first, six other draws end at .62 of LOLIMOT's
validation error for `pfi` and .94 for `gtdi` (geometric means), here at .67 and .88; by
the longer default settings at .61 and .92, everything at once at .70 and .93."""


def measured(bed: str, seed: int, length: int) -> jnx.Dataset:
    """Three records of one seed."""
    key = jax.random.fold_in(jax.random.key(seed), sorted(BEDS).index(bed))
    if bed == "pfi":
        return pfi_siso_records(key, (length,) * 3)
    return records(Gtdi(), key, (length,) * 3, names=PARTS, outputs=["TRQ"])


def error(network: jnx.Network, data: jnx.Dataset) -> dict[str, Any]:
    """Pooled NRMSE one step ahead and in free run."""
    found = jnx.report(network, data)
    (name,) = network.output_names
    row, step = found.pooled_row(name), found.pooled_row(name, mode="one step")
    return {"free_run": row.nrmse, "one_step": step.nrmse, "status": row.status}


def fit(bed: str, seed: int, small: bool) -> dict[str, Any]:
    """One row: grow, refine, score both."""
    settings, begin = BEDS[bed], time.perf_counter()
    data = measured(bed, seed, 600 if small else 1800)
    train, validate, test = data[0], data[1], data[2]
    pool = jnx.polynomial_pool(
        train.channels,
        outputs=[settings["output"]],
        input_lags=settings["input_lags"],
        output_lags=(1, 2),
        degree=1,
    )
    terms = jnx.select(pool, train, jnx.ForwardOLS(max_terms=TERMS)).value
    growth = jnx.Lolimot(settings["scheduling"], max_models=MODELS)
    grown = jnx.grow(terms, train, growth).value
    solution = jnx.refine(grown, train, METHOD, validation=validate)
    row: dict[str, Any] = {"bed": bed, "seed": seed, "status": solution.status_name}
    for name, network in (("LOLIMOT", grown), ("refined", solution.value)):
        row[name] = {
            "validation": error(network, validate),
            "test": error(network, test),
        }
    row["models"] = int(grown.models[0].active.sum())
    row["seconds"] = round(time.perf_counter() - begin, 1)
    print(json.dumps(row), flush=True)
    return row


def ratio(row: dict[str, Any], part: str) -> float:
    """Free-run error of LOLIMOT over that of the refined network; inf where only the
    first diverges.
    """
    before, after = (row[k][part]["free_run"] for k in ("LOLIMOT", "refined"))
    if before is None:
        return float("inf") if after is not None else 1.0
    return 0.0 if after is None else before / after


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Median gain and worst case by bed, and whether validation ever got worse."""
    found = {}
    for bed in sorted({r["bed"] for r in rows}):
        own = [r for r in rows if r["bed"] == bed]
        gain = sorted(ratio(r, "test") for r in own)
        finite = [g for g in gain if np.isfinite(g)]
        found[bed] = {
            "seeds": len(own),
            "median_gain": float(np.median(finite)) if finite else None,
            "worst_gain": gain[0],
            "only_lolimot_diverged": len(gain) - len(finite),
            "validation_worse": sum(ratio(r, "validation") < 1 - 1e-9 for r in own),
            "refined_diverged": sum(
                r["refined"]["test"]["free_run"] is None for r in own
            ),
        }
    return found


def main() -> None:
    """Fill the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="one short fit")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    own = None if options.smoke else str(Path(__file__).with_name("results"))
    folder = results_folder(options.results or own, smoke=options.smoke)
    path = folder / "engines.json"
    rows = json.loads(path.read_text())["figures"]["rows"] if path.exists() else []
    done = {(r["bed"], r["seed"]) for r in rows}
    seeds = range(1 if options.smoke else SEEDS)
    beds = tuple(BEDS)[:1] if options.smoke else tuple(BEDS)
    for bed, seed in ((b, s) for b in beds for s in seeds):
        if (bed, seed) not in done:
            rows.append(fit(bed, seed, options.smoke))
            record("engines", {"summary": summary(rows), "rows": rows}, folder=folder)
    print(json.dumps(summary(rows), indent=1))


if __name__ == "__main__":
    main()
