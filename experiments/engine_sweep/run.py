"""One identification for 256 perturbed engines of each of four test beds.

What does a structure that was found on one engine say about its sisters? The
parameters of every bed are perturbed (each by its weight in the bed's `varied` times
`spread`), all engines are run under the same excitation and measured with noise of
their own, and one output of each is identified: up to ten terms by forward orthogonal
least squares from a quadratic pool, up to four local models by LOLIMOT, refined on the
free run. Beside the engines stand two controls: the nominal engine with other noise,
and with another excitation. Asked is

* which terms are chosen how often;
* which partitions are grown, and how far refined centres move with the parameters;
* how well the structure of the nominal engine, or of some sister, serves an engine:
  its terms alone with regions of the engine's own, terms and regions with coefficients
  made anew, and the nominal engine's network as it is.

Steps are judged on the validation record; figures are of the free run of a third one.

    python experiments/engine_sweep/run.py [--smoke] [--results DIR] [--bed NAME ...]

Goes on where an earlier run stopped: records and run folders are kept in `runs/` of the
results. Writes engine_sweep.json, engine_sweep.parquet and three figures.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import jax
import pyarrow.parquet as parquet
from answers import (
    compared,
    halving_figures,
    movement_figures,
    score_figures,
    term_figures,
)
from beds import BEDS, Records, Size, fleet_of, records_of
from draw import draw_partitions, draw_terms, draw_transfer
from structures import RefitWork, restricted

import jaxnarx as jnx
from jaxnarx.settings import replace_at
from jaxnarx.shell.figures.style import save

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from common import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    record,
    results_folder,
)

NAME = "engine_sweep"
FULL = Size(engines=256, repetitions=48, lengths=(1000, 500, 500), spread=0.1)
SMALL = Size(engines=6, repetitions=3, lengths=(600, 600, 600), spread=0.1)
SETTINGS: dict[str, Any] = {
    "pool.output_lags": (1, 2),
    "pool.degree": 2,
    "select.max_terms": 10,
    "grow": {"method": "lolimot", "max_models": 4, "criterion": "none"},
    "refine.max_steps": 10,
    "refine.window_steps": 5,
    "refine.horizons": (10, 50),
    # A search makes all its steps.
    **{"refine.tolerance": 0, "refine.patience": 1000},
}
LITTLE = {
    "pool.degree": 1,
    "select.max_terms": 6,
    "grow.max_models": 2,
    "refine.max_steps": 1,
    "refine.horizons": (),
}
CASES: dict[str, dict[str, Any]] = {
    "LOLIMOT": {"refine.train": "coefficients"},
    "refined": {},
    "one model": {"grow.max_models": 1},
}
"""What is refined: coefficients alone, the partition too; and no partition."""
CHUNK, LANES, REFITTED = 32, 16, 128
"""Members of a chunk, fits of one call, and engines on which structures are refitted:
those go through the verbs one by one."""
KEPT = ("bed", "engine", "structure", "donor", "status", "term_names", "centre") + (
    *("train_free_run", "validation_free_run", "test_free_run"),
)
"""Columns of the table that is kept; the run folders have them all."""
Row = dict[str, Any]


def rows_of(bed: str, size: Size, settings: Row, folder: Path) -> tuple[list[Row], Row]:
    """Everything that is computed for a bed, and what is known of its engines."""
    records = records_of(bed, size, folder)
    fleet = fleet_of(records, size.seed)
    method = replace_at(jnx.Identification(), settings | BEDS[bed].settings)
    work = jnx.sweep.IdentificationWork(
        fleet, method, list(CASES.values()), lanes=LANES
    )
    rows = swept(work, folder / bed)
    names = list(CASES)
    rows = [row | {"structure": names[row["case"]]} for row in rows]
    chosen = {r["engine"]: r for r in rows if r["structure"] == "refined"}
    nominal = chosen["noise 0"]
    few = restricted(work, nominal)
    few_rows = swept(few, folder / f"{bed}_terms")
    rows += [row | {"structure": "nominal terms"} for row in few_rows]
    refinement = replace_at(method.refine, {"tolerance": 1e-4, "patience": 15})
    pairs = pairs_of(chosen, min(REFITTED, size.engines), size.repetitions)
    refit = RefitWork(work, chosen, pairs, refinement)
    rows += swept(refit, folder / f"{bed}_refitted")
    known = {
        "records": records,
        "pool": len(work.pool),
        "seconds": round(sum(row["seconds"] for row in rows), 1),
    }
    return [row | {"bed": bed} for row in rows], known


def swept(work: jnx.sweep.Work, folder: Path) -> list[Row]:
    """The rows of a sweep in its folder."""

    def tell(state: Row) -> None:
        print(folder.name, {k: state[k] for k in sorted(state)}, flush=True)

    return list(jnx.run_sweep(work, folder, chunk=CHUNK, progress=tell).value.rows())


def pairs_of(
    chosen: dict[str, Row], count: int, repetitions: int
) -> list[tuple[str, str, str]]:
    """Engine, structure and donor.

    The sister is half a family away. The nominal engine is measured anew for every
    engine, as long as there are repetitions: a single measurement of it is one draw.
    """
    found = []
    for n in range(count):
        nominal = f"noise {n % repetitions}"
        donors = {"own": f"engine {n}", "sister": f"engine {(n + count // 2) % count}"}
        donors |= {"nominal": nominal, "as it is": nominal}
        found += [
            (f"engine {n}", structure, donor)
            for structure, donor in donors.items()
            if chosen[donor]["term_index"]
        ]
    return found


def figures_of(rows: list[Row], records: Records, seed: int) -> dict[str, Any]:
    """All answers for one bed."""
    by = {
        s: [r for r in rows if r["structure"] == s]
        for s in {r["structure"]: 0 for r in rows}
    }
    k_sigma = jnx.Lolimot.k_sigma
    varied = list(records.bed.make().varied)
    engines = {
        s: [r for r in own if r["engine"].startswith("engine")] for s, own in by.items()
    }
    score = "test_free_run"
    found: dict[str, Any] = {
        "status": {s: _counts(own) for s, own in by.items()},
        "broken": [
            [r["engine"], r["detail"]] for r in by["LOLIMOT"] if not r["term_index"]
        ],
        score: {
            s: score_figures(own, jnx.sweep.SweepTable.from_rows(own).okay, score)
            for s, own in engines.items()
        },
        "terms": term_figures(by["refined"]),
        "halving": halving_figures(by["LOLIMOT"], k_sigma),
        "movement": movement_figures(
            by["refined"], by["LOLIMOT"], records.factors, varied, k_sigma, seed
        ),
    }
    pairs = [
        *(("one model", "LOLIMOT"), ("LOLIMOT", "refined"), ("one model", "refined")),
        *(("refined", "nominal terms"), ("own", "nominal"), ("own", "sister")),
        *(("own", "as it is"), ("refined", "own")),
    ]
    both = [r for own in engines.values() for r in own]
    found["comparisons"] = {
        f"{after} against {before}": compared(
            both, "structure", before, after, score, seed
        )
        for before, after in pairs
    }
    return found


def kept(row: Row) -> Row:
    """What is kept of a row; terms do not change between the cases."""
    found = {key: row.get(key) for key in KEPT}
    if row["structure"] not in ("refined", "nominal terms"):
        found["term_names"] = None
    if row["structure"] not in ("LOLIMOT", "refined"):
        found["centre"] = None
    centre = found["centre"]
    scores = {k: v and float(f"{v:.5g}") for k, v in found.items() if "_run" in k}
    return found | scores | {"centre": centre and [round(x, 3) for x in centre]}


def _counts(rows: list[Row]) -> dict[str, int]:
    return jnx.sweep.summary(jnx.sweep.SweepTable.from_rows(rows))


def main() -> None:
    """Simulate, sweep, answer, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="six engines of one bed")
    parser.add_argument("--results", metavar="DIR", help="folder for the results")
    parser.add_argument("--bed", nargs="+", choices=list(BEDS), help="only these")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    own = None if options.smoke else str(Path(__file__).with_name("results"))
    folder = results_folder(options.results or own, smoke=options.smoke)
    folder.mkdir(parents=True, exist_ok=True)
    size, settings = (SMALL, SETTINGS | LITTLE) if options.smoke else (FULL, SETTINGS)
    rows, found = [], {}
    for bed in options.bed or (["pfi"] if options.smoke else list(BEDS)):
        own_rows, known = rows_of(bed, size, settings, folder / "runs")
        records = known.pop("records")
        rows += own_rows
        found[bed] = known | figures_of(own_rows, records, size.seed)
        record(NAME, {"size": vars(size), "beds": found}, folder=folder)
        print(bed, json.dumps(found[bed]["comparisons"], indent=1), flush=True)
    table = jnx.sweep.SweepTable.from_rows([kept(row) for row in rows])
    written = {"compression": "zstd", "compression_level": 19}
    parquet.write_table(table.arrow, folder / f"{NAME}.parquet", **written)
    save(draw_terms(found), folder / "terms.png")
    save(draw_partitions(rows, list(found)), folder / "partitions.png")
    save(draw_transfer(rows), folder / "transfer.png")


if __name__ == "__main__":
    main()
