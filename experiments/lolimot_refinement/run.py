"""LOLIMOT results refined by gradient: what to move, by which error, along which way.

Affine local models, placed by LOLIMOT, of Nelles' four processes (20 draws of
excitation and noise each), the torque of `gtdi` and the intake pressure of `diesel` (8
each). Levenberg-Marquardt moves

- `coefficients`: of the local models alone;
- `partition`: centres and widths alone;
- `joint`: everything at once;
- `staged`: coefficients alone in windows, then everything on full records,

and lowers the error of free runs (windows of growing length, then full records, or
these at once) or that of one step. All are judged by the free run of the validation
record, the best there is kept, and scored on a test record without noise.

    python experiments/lolimot_refinement/run.py [--smoke] [--results DIR]

Finished parts are kept in DIR/runs; the same command goes on. Writes
lolimot_refinement.json, .parquet and .png; README.md tells what came out.
"""

import sys
from pathlib import Path
from typing import Any

import jax

from jaxnarx.settings import replace_at
from jaxnarx.sweep import SweepTable, grid_cases, paired_comparison

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
    compared,
    identified,
    options,
    spread,
    start_row,
    table_of,
    write_table,
)
from problems import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    ENGINES,
    PROBLEMS,
    PROCESSES,
)
from refinement_figure import draw  # noqa: E402 # pyright: ignore[reportMissingImports]

NAME = "lolimot_refinement"
SEEDS = dict.fromkeys(PROCESSES, 20) | dict.fromkeys(ENGINES, 8)
SHORT, LONG = "to 100", "to full"
SCHEDULES: dict[str, dict[str, Any]] = {
    LONG: {"horizons": (10, 30, 100, 1000), "window_steps": 8, "max_steps": 30},
    "one step": {"max_steps": 30, "ridge": 1e-5},
    "at once": {"horizons": (), "max_steps": 60},
    SHORT: {"horizons": (10, 30, 100), "window_steps": 8, "max_steps": 30},
}
"""How the refinement gets to its end; `to full`: windows up to the whole record."""
MOVED = ("coefficients", "partition", "joint")
PLAN = [
    *((LONG, name, (4,), (*MOVED, "staged")) for name in PROCESSES),
    *(("one step", name, (4,), MOVED) for name in PROCESSES),
    *((LONG, name, (4, 8), (*MOVED, "staged")) for name in ENGINES),
    *(("at once", name, (4,), MOVED) for name in PROCESSES),
    *((LONG, name, (8,), (*MOVED, "staged")) for name in PROCESSES),
    *(("one step", name, (4, 8), MOVED) for name in ENGINES),
    *(
        (SHORT, name, (4,), (*MOVED, "staged"))
        for name in ("Wiener", "difference equation")
    ),
]
"""Schedule, problem, numbers of local models, what is moved."""
SMOKE = [(LONG, "difference equation", (2,), ("coefficients", "staged"))]
SMALL = {"horizons": (10, 1000), "window_steps": 3, "max_steps": 3}
START = "LOLIMOT"
PAIRS = [
    *(
        (f"staged, {LONG}", other)
        for other in (f"coefficients, {LONG}", f"joint, {LONG}")
    ),
    (f"joint, {LONG}", f"coefficients, {LONG}"),
    (f"partition, {LONG}", f"coefficients, {LONG}"),
    ("coefficients, one step", f"coefficients, {LONG}"),
    ("joint, one step", f"joint, {LONG}"),
    ("coefficients, at once", f"coefficients, {LONG}"),
    ("joint, at once", f"joint, {LONG}"),
    (f"staged, {SHORT}", f"staged, {LONG}"),
]
"""What is compared beside everything with the start: the first against the second."""


def part(
    schedule: str,
    name: str,
    sizes: tuple[int, ...],
    moved: tuple[str, ...],
    small,
    folder,
) -> list[Row]:
    """Rows of one entry of the plan."""
    problem = PROBLEMS[name]
    fleet = problem.fleet(*((2, 300) if small else (SEEDS[name],)))
    how = SMALL if small else SCHEDULES[schedule]
    told = {f"refine.{field}": value for field, value in how.items()}
    if schedule == "one step":
        told["refine"] = "prediction"
    method = replace_at(problem.method, told)
    cases = grid_cases({"grow.max_models": sizes, "refine.train": moved})
    size = " ".join(map(str, sizes))
    names = {"problem": name, "schedule": schedule, "sizes": size}
    return identified(fleet, method, cases, folder, **names)


def ways(rows: list[Row]) -> list[Row]:
    """Every row with what was done as `how`; the starts as rows of their own, once."""
    starts = {(r["problem"], r["engine"], r["models"]): r for r in reversed(rows)}
    found = [start_row(r, how=START) for r in starts.values()]
    return found + [r | {"how": f"{r['train']}, {r['schedule']}"} for r in rows]


def summary(rows: list[Row]) -> list[dict[str, Any]]:
    """Spread of every way on every problem, beside its start."""
    table = table_of(rows)
    groups: dict[tuple, list[Row]] = {}
    for row in rows:
        groups.setdefault((row["problem"], row["models"], row["how"]), []).append(row)
    return [
        {
            "problem": problem,
            "models": models,
            "how": how,
            "free_run": spread(own),
            "one_step": spread(own, "test_one_step"),
            "kept_start": sum(r["status"] == "no_improvement" for r in own),
            "against_start": pair(table, problem, models, (START, how)),
        }
        for (problem, models, how), own in groups.items()
    ]


def pair(table: SweepTable, problem: str, models: int, levels: tuple[str, str]):
    """Two ways compared over the members of one problem; None where one is missing."""
    own = table.where(problem=problem, models=models)
    if levels[0] == levels[1] or set(levels) - set(own.column("how").tolist()):
        return None
    settings = {"factor": "how", "by": "test_free_run", "levels": levels}
    return compared(paired_comparison(own, pair=["engine"], **settings))


def contrasts(rows: list[Row]) -> list[dict[str, Any]]:
    """The pairs of `PAIRS` on every problem."""
    table = table_of(rows)
    places = dict.fromkeys((r["problem"], r["models"]) for r in rows)
    found = [
        {"problem": p, "models": m, "of": after, "to": before, "found": both}
        for after, before in PAIRS
        for p, m in places
        if (both := pair(table, p, m, (before, after))) is not None
    ]
    return found


def show(found: list[dict[str, Any]]) -> None:
    """Medians, worst members and divergences."""
    for entry in found:
        free, gain = entry["free_run"], entry["against_start"]
        ratio = (
            ""
            if gain is None
            else f"ratio {gain['ratio']}, better {gain['improved'][0]}"
        )
        print(
            f"{entry['problem']:22s}{entry['models']:2d} {entry['how']:24s}"
            f"{free.get('median', float('nan')):8.4f}  worst {free.get('largest')} "
            f"{free.get('worst', '')}, diverged {free['diverged']}, one step "
            f"{entry['one_step'].get('median')}  {ratio}"
        )


def main() -> None:
    """Fill the table part by part."""
    small, folder = options(__doc__ or "", HERE, "one process, short records")
    jax.config.update("jax_enable_x64", True)
    rows: list[Row] = []
    for schedule, name, sizes, moved in SMOKE if small else PLAN:
        rows += part(schedule, name, sizes, moved, small, folder)
        every = ways(rows)
        figures = {"summary": summary(every), "contrasts": contrasts(every)}
        record(NAME, figures, folder=folder)
        write_table(table_of(every), folder / f"{NAME}.parquet")
        save_small(draw(every, START), folder / f"{NAME}.png")
    show(summary(ways(rows)))


if __name__ == "__main__":
    main()
