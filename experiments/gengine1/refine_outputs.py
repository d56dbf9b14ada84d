"""All eight outputs of a real engine by one configuration, before and after refinement.

Six affine local models over speed and load, 16 terms by error reduction ratio: the
configuration of this size that the rule of choose.py prefers over NOx and the exhaust
temperature together (smallest mean of the validation losses in choice.json). Open is
only the memory: lagged inputs and outputs, or inputs through first-order lags beside
them. It is the same for all outputs: the smallest geometric mean over outputs of the
free-run NRMSE after refinement on the records that `hold_out` keeps back.

Coefficients are refined first, in windows that grow; then everything together on whole
records. Both are guarded by the held-out records. The six test records are scored
beside them and take no part in any choice.

    python experiments/gengine1/refine_outputs.py [--smoke] [--results DIR]

Every row is written as soon as it is there; a second run goes on where the first
stopped.
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import jax

import jaxnarx as jnx
from jaxnarx.data import hold_out
from jaxnarx.refinement import freeze

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).resolve().parent))
from common import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    record,
    results_folder,
)
from select_terms import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    DESCRIPTION,
    MEMORIES,
    TIME_CONSTANTS,
    errors,
)

TERMS, MODELS, SCHEDULING = 16, 6, ("speed[t]", "load[t]")
MEMORY = ("output lags", "both")
ROWS: tuple[str, ...] = ("LOLIMOT", "coefficients", "joint")
COEFFICIENTS = jnx.SimulationError(
    horizons=(30, 100, 300, 1000), window_steps=8, max_steps=20, patience=8
)
JOINT = jnx.SimulationError(horizons=(), max_steps=40, patience=10, train="joint")


def start(train: jnx.Dataset, output: str, memory: str) -> jnx.Network:
    """Terms by error reduction ratio, regions by LOLIMOT."""
    settings = dict(MEMORIES[memory])
    if settings.pop("filtered", False):
        settings["filters"] = [jnx.LowPass(tau) for tau in TIME_CONSTANTS]
    pool = jnx.polynomial_pool(train.channels, outputs=[output], degree=1, **settings)
    terms = jnx.select(pool, train, jnx.ForwardOLS(max_terms=TERMS)).value
    method = jnx.Lolimot(scheduling=SCHEDULING, max_models=MODELS)
    return jnx.grow(terms, train, method).value


def fit(
    train: jnx.Dataset,
    validate: jnx.Dataset,
    test: jnx.Dataset,
    output: str,
    memory: str,
    small: bool,
) -> dict[str, Any]:
    """One row: grow, refine twice, score all three networks."""
    begin = time.perf_counter()
    grown = start(train, output, memory)
    only = freeze(grown, partition=False)
    first_method, last_method = COEFFICIENTS, JOINT
    if small:
        first_method = jnx.SimulationError(horizons=(), max_steps=2)
        last_method = first_method
    first = jnx.refine(grown, train, first_method, validation=validate, trainable=only)
    last = jnx.refine(first.value, train, last_method, validation=validate)
    networks = dict(zip(ROWS, (grown, first.value, last.value), strict=True))
    row = {
        "output": output,
        "memory": memory,
        "models": int(grown.models[0].active.sum()),
        "parameters": last.stats["parameters"],
        "status": {"coefficients": first.status_name, "joint": last.status_name},
        "seconds": round(time.perf_counter() - begin, 1),
        "validation": {k: errors(n, validate) for k, n in networks.items()},
        "test": {k: errors(n, test) for k, n in networks.items()},
    }
    show(row)
    return row


def show(row: dict[str, Any]) -> None:
    """One line a row: RMSE on the test records, one step and free run."""
    parts = []
    for k in ROWS:
        score = row["test"][k]
        bad = len(score["free_run"]["diverged"])
        free = f"{score['free_run']['rmse']:.3f}" + (f" ({bad} div.)" if bad else "")
        guard = row["validation"][k]["free_run"]["rmse"]
        parts.append(f"{k} {score['one_step']['rmse']:.4f} {free} [val {guard:.3f}]")
    head = f"{row['output']:10s} {row['memory']:12s}"
    print(head, "  ".join(parts), f"{row['seconds']} s", flush=True)


def chosen_memory(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The rule of the module's docstring, over the outputs that all tried have.

    A memory with which a validation record diverges is passed over.
    """
    tried = [m for m in MEMORY if any(r["memory"] == m for r in rows)]
    outputs = [{r["output"] for r in rows if r["memory"] == m} for m in tried]
    shared = set.intersection(*outputs)
    means: dict[str, float] = {}
    for memory in tried:
        own = [r for r in rows if r["memory"] == memory and r["output"] in shared]
        scores = [r["validation"]["joint"]["free_run"] for r in own]
        if own and not any(s["diverged"] for s in scores):
            logs = [math.log(s["nrmse"]) for s in scores]
            means[memory] = math.exp(sum(logs) / len(logs))
    best = min(means, key=means.__getitem__) if means else None
    return {"validation": means, "over": sorted(shared), "chosen": best}


def verdicts(rows: list[dict[str, Any]], memory: str | None) -> dict[str, Any]:
    """Whether refinement lowered the free-run error of every output, by records."""
    found = {}
    for row in (r for r in rows if r["memory"] == memory):
        entry = {}
        for part in ("validation", "test"):
            before, after = (row[part][k]["free_run"] for k in (ROWS[0], ROWS[-1]))
            ladder = [(len(s["diverged"]), s["rmse"]) for s in (before, after)]
            entry[f"{part}_better"] = ladder[1] < ladder[0]
            entry[f"{part}_ratio"] = after["rmse"] / before["rmse"]
        found[row["output"]] = entry
    return found


def main() -> None:
    """Fill the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="short records, one row")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    split = jnx.read_split(DESCRIPTION)
    assert split.train is not None and split.test is not None
    train, test = split.train, split.test
    outputs, memories = tuple(train.channels.output_names), MEMORY
    if options.smoke:
        train, test = train[[9, 19, 8, 18]], test[:1]
        outputs, memories = ("T_exhaust",), MEMORY[:1]
    train, validate = hold_out(train)
    folder = results_folder(options.results, smoke=options.smoke)
    path = folder / "gengine1_outputs.json"
    rows = json.loads(path.read_text())["figures"]["rows"] if path.exists() else []
    done = {(r["output"], r["memory"]) for r in rows}
    for key in [(o, m) for m in memories for o in outputs]:
        if key in done:
            continue
        rows.append(fit(train, validate, test, *key, small=options.smoke))
        choice = chosen_memory(rows)
        figures = {
            "held_out": validate.names,
            "choice": choice,
            "refinement": verdicts(rows, choice["chosen"]),
            "rows": rows,
        }
        record("gengine1_outputs", figures, folder=folder)
    for row in rows:
        show(row)
    print(json.dumps(chosen_memory(rows)))


if __name__ == "__main__":
    main()
