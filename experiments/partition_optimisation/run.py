"""Where local models should lie: LOLIMOT, HILOMOT, drawn and clustered starts, refined.

Affine local models of Nelles' four processes (3 draws of excitation and noise each, 4
of Wiener's), of `gtdi` and `diesel` (2 each) and of the measured `gengine1`.
Partitions: halving of the worst model (`lolimot`), oblique sigmoid gates (`tree`),
Gaussians at samples drawn at random (`random`) or at means of clusters (`cluster`), and
LOLIMOT's moved at random (`scatter_partition`). From each the coefficients alone are
refined on the free run, or, staged, first these and then everything, centres and widths
or gates too.

- 1 to 8 models of `lolimot` and `tree`: how many does an error need?
- 32 starts with 4 models, of which the validation record chooses: how far is the greedy
  partition from the best that was found?

All are judged by the free run of validation records. Test records, those of simulated
systems without noise, take no part in any choice.

    python experiments/partition_optimisation/run.py [--smoke] [--results DIR]

Finished parts are kept in DIR/runs; the same command goes on. Writes
partition_optimisation.json and .parquet and two figures; README.md tells what came out.
"""

import sys
from pathlib import Path
from typing import Any

import jax

from jaxnarx.settings import replace_at
from jaxnarx.sweep.cases import Case, grid_cases

HERE = Path(__file__).resolve().parent
for folder in ("fleets", "benchmarks"):
    sys.path.insert(0, str(HERE.parent / folder))
sys.path.insert(0, str(HERE))
from common import record  # noqa: E402 # pyright: ignore[reportMissingImports]
from drawing import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    save_small,
)
from fleet_runs import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    Row,
    identified,
    options,
    start_row,
    table_of,
    write_table,
)
from partition_figures import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    draw_curves,
    draw_starts,
)
from partition_tables import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    BEST,
    chosen,
    comparisons,
    curves,
    needed,
    starts,
)
from problems import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    PROBLEMS,
    missing,
)

NAME = "partition_optimisation"
SEEDS = dict.fromkeys(PROBLEMS, 3) | {
    "Wiener": 4,
    "gtdi": 2,
    "diesel": 2,
    "gengine1": 1,
}
ORDER = (
    *("Wiener", "difference equation", "gengine1"),
    *("Hammerstein", "dynamic nonlinearity", "diesel", "gtdi"),
)
PARTITIONS = ("lolimot", "tree", "random", "cluster")
SIZES, MODELS = (1, 2, 3, 4, 6, 8), 4
DRAWN, SCATTERED, SCATTER = 10, 12, 0.7
"""Starts drawn at random and by clusters, starts moved from LOLIMOT's, and how far."""
REFINEMENT = {
    "refine.horizons": (10, 30, 100, 1000),
    "refine.window_steps": 8,
    "refine.max_steps": 30,
}
SMALL = {
    "refine.horizons": (10, 1000),
    "refine.window_steps": 3,
    "refine.max_steps": 3,
}
KINDS = {
    "lolimot": {},
    "tree": {"grow": "tree"},
    "random": {"grow": "placed", "grow.at": "samples"},
    "cluster": {"grow": "placed", "grow.at": "clusters"},
}
MOVED = ("coefficients", "staged")


def cases(partition: str, small: bool) -> list[Case]:
    """What is tried of a partition."""
    sizes, drawn, scattered = (SIZES, DRAWN, SCATTERED) if not small else ((2,), 2, 2)
    models = min(MODELS, max(sizes))
    moved: dict[str, Any] = {"refine.train": MOVED}
    if partition in ("random", "cluster"):
        own = {"grow.max_models": [models]} | moved | {"grow.seed": range(drawn)}
        return grid_cases(own)
    found = grid_cases({"grow.max_models": sizes} | moved)
    if partition == "lolimot":
        own = {"grow.max_models": [models], "refine.train": ["staged"]}
        own |= {"grow.scatter": [SCATTER], "grow.seed": range(scattered)}
        found += grid_cases(own)
    return found


def part(name: str, partition: str, small: bool, folder: Path) -> list[Row]:
    """Rows of one problem and partition, what was placed as rows of its own."""
    problem = PROBLEMS[name]
    fleet = problem.fleet(*((2, 300) if small else (SEEDS[name],)))
    tried = cases(partition, small)
    how = SMALL if small else REFINEMENT
    method = replace_at(problem.method, KINDS[partition] | how)
    names = {"problem": name, "partition": partition}
    rows = identified(fleet, method, tried, folder, **names)
    for row in rows:
        row["partition"] = "scattered" if row["scatter"] else partition
    placed = [start_row(r, train="none") for r in rows if r["train"] == "staged"]
    return placed + rows


def main() -> None:
    """Fill the table part by part."""
    small, folder = options(__doc__ or "", HERE, "one process, short records")
    jax.config.update("jax_enable_x64", True)
    rows: list[Row] = []
    skipped: dict[str, str] = {}
    for name in ORDER[1:2] if small else ORDER:
        if reason := missing(PROBLEMS[name]):
            print(f"{name}: {reason}", flush=True)
            skipped[name] = reason
            continue
        for partition in PARTITIONS[::2] if small else PARTITIONS:
            rows += part(name, partition, small, folder)
        every = rows + chosen(rows)
        figures = {
            "curves": curves(rows),
            "needed": needed(rows),
            "starts": starts(every),
            "comparisons": comparisons(every),
            "skipped": skipped,
        }
        record(NAME, figures, folder=folder)
        write_table(table_of(rows), folder / f"{NAME}.parquet")
        save_small(draw_curves(curves(rows)), folder / f"{NAME}_curves.png")
        save_small(draw_starts(every, BEST), folder / f"{NAME}_starts.png")
        for row in starts(every):
            if row["problem"] == name:
                print(row, flush=True)


if __name__ == "__main__":
    main()
