"""25 terms for a real engine: by ERR, by stepwise F, by the free run itself.

One global polynomial of degree 2 for each of NOx, HC and the exhaust temperature, with
output lags, with inputs through first-order lags (no feedback, so it cannot run away),
and with both. Terms are chosen on the training records, then every model gets the same
refinement on the free run, guarded by the records that `hold_out` keeps back. The six
test records are scored once, at the end; nothing is chosen by them. Degree 2 was fixed
beforehand: cubics leave the planet at the edge of the data (DESIGN section 7).

    python experiments/gengine1/select_terms.py [--smoke] [--results DIR]

Every row is written as soon as it is there; a second run goes on where the first
stopped.
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
from jaxnarx.data import Dataset, hold_out
from jaxnarx.evaluation.metrics import nrmse, rmse
from jaxnarx.shell.progress import selection_progress
from jaxnarx.simulation import Trajectories

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from common import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    record,
    results_folder,
)

DESCRIPTION = Path(__file__).with_name("gengine1.toml")
OUTPUTS = ("NOx", "HC", "T_exhaust")
TERMS, DEGREE = 25, 2
INPUT_LAGS, OUTPUT_LAGS = (0, 1, 2, 4, 8, 16), (1, 2)
TIME_CONSTANTS = (1.0, 4.0, 16.0, 60.0)
"""First-order lags of every input [s], those of the project's first prototypes."""
MEMORIES = {
    "output lags": {"input_lags": INPUT_LAGS, "output_lags": OUTPUT_LAGS},
    "filtered inputs": {"input_lags": (0,), "output_lags": (), "filtered": True},
    "both": {"input_lags": (0,), "output_lags": OUTPUT_LAGS, "filtered": True},
}
METHODS = {
    "ERR": jnx.ForwardOLS(max_terms=TERMS),
    "stepwise F": jnx.StepwiseF(max_terms=TERMS),
    "simulation error": jnx.SimulationOLS(
        max_terms=TERMS, shortlist=40, steps=4, max_rounds=40
    ),
}
REFINEMENT = jnx.SimulationError(window_steps=10, max_steps=30)


def pool_of(data: Dataset, output: str, memory: dict[str, Any]) -> jnx.Pool:
    """Candidates: products of up to two lagged or filtered variables."""
    settings = dict(memory)
    if settings.pop("filtered", False):
        settings["filters"] = [jnx.LowPass(tau) for tau in TIME_CONSTANTS]
    return jnx.polynomial_pool(
        data.channels, outputs=[output], degree=DEGREE, **settings
    )


def errors(network: jnx.Network, data: Dataset) -> dict[str, Any]:
    """Pooled errors one step ahead and in free run, and the records that diverge."""
    (o,) = network.modelled
    verbs = {"one_step": jnx.predict, "free_run": jnx.simulate}
    return {k: errors_of(f(network, data).value, o, data) for k, f in verbs.items()}


def errors_of(run: Trajectories, output: int, data: Dataset) -> dict[str, Any]:
    """Pooled errors of the run of one output, and the records that diverge."""
    y = np.concatenate([r.y[:, [output]] for r in data])
    mask, predicted = np.concatenate(run.scored), np.concatenate(run.outputs)
    bad = [n for n, d in zip(run.names, run.diverged, strict=True) if d.any()]
    return {
        "rmse": float(rmse(y, predicted, mask)[0]),
        "nrmse": float(nrmse(y, predicted, mask)[0]),
        "diverged": bad,
    }


def fit(
    train: Dataset, validate: Dataset, test: Dataset, output: str, memory: str, how: str
) -> dict[str, Any]:
    """One row: choose, fit, refine, score."""
    pool = pool_of(train, output, MEMORIES[memory])
    begin = time.perf_counter()
    chosen = jnx.select(pool, train, METHODS[how], progress=selection_progress)
    chosen_s = time.perf_counter() - begin
    network = chosen.stats.get("network")
    if network is None:
        network = jnx.grow(chosen.value, train, jnx.Global()).value
    begin = time.perf_counter()
    refined = jnx.refine(network, train, REFINEMENT, validation=validate)
    row = {
        "output": output,
        "memory": memory,
        "chosen_by": how,
        "candidates": len(pool),
        "terms": chosen.value.size(),
        "names": chosen.value.names,
        "status": {"selection": chosen.status_name, "refinement": refined.status_name},
        "seconds": {
            "selection": round(chosen_s, 1),
            "refinement": round(time.perf_counter() - begin, 1),
        },
        "validation": errors(refined.value, validate),
        "test": errors(refined.value, test),
        "test_before_refinement": errors(network, test),
    }
    show(row)
    return row


def show(row: dict[str, Any]) -> None:
    """One line a row."""

    def text(part: dict[str, Any]) -> str:
        bad = len(part["free_run"]["diverged"])
        free = f"diverged ({bad})" if bad else f"{part['free_run']['rmse']:.3f}"
        return f"{part['one_step']['rmse']:.4f} {free:>12s}"

    print(
        f"{row['output']:10s} {row['memory']:16s} {row['chosen_by']:17s}"
        f"{row['terms']:3d}  before {text(row['test_before_refinement'])}"
        f"  refined {text(row['test'])}  {row['seconds']}",
        flush=True,
    )


def main() -> None:
    """Fill the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="short records, few rows")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    split = jnx.read_split(DESCRIPTION)
    assert split.train is not None and split.test is not None
    train, test = split.train, split.test
    outputs, memories, methods = OUTPUTS, tuple(MEMORIES), tuple(METHODS)
    if options.smoke:
        train, test = train[[9, 19, 8, 18]], test[:1]
        outputs, memories, methods = OUTPUTS[:1], ("filtered inputs",), ("stepwise F",)
    train, validate = hold_out(train)
    folder = results_folder(options.results, smoke=options.smoke)
    path = folder / "gengine1_selection.json"
    rows = json.loads(path.read_text())["figures"]["rows"] if path.exists() else []
    done = {(r["output"], r["memory"], r["chosen_by"]) for r in rows}
    for output in outputs:
        for memory in memories:
            for how in methods:
                if (output, memory, how) in done:
                    continue
                rows.append(fit(train, validate, test, output, memory, how))
                figures = {"held_out": validate.names, "rows": rows}
                record("gengine1_selection", figures, folder=folder)
    for row in rows:
        show(row)


if __name__ == "__main__":
    main()
