"""What experiments on fleets share: options, runs that go on, rows, spreads."""

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.settings import Identification
from jaxnarx.sweep import (
    Comparison,
    Fleet,
    IdentificationWork,
    Interval,
    SweepTable,
    run_sweep,
)
from jaxnarx.sweep.cases import Case, setting_label

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from common import results_folder  # noqa: E402 # pyright: ignore[reportMissingImports]

LANES, CHUNK = 4, 16
"""Fits in one call of the program, and in one file of the run folder."""
SCORES = tuple(
    f"{part}_{mode}"
    for part in ("validation", "test")
    for mode in ("one_step", "free_run")
)
KEPT = ("engine", "status")
SETTINGS = {
    "models": "grow.max_models",
    "train": "refine.train",
    "scatter": "grow.scatter",
    "seed": "grow.seed",
    "k_sigma": "grow.k_sigma",
}
"""Short names of the settings that a row tells, swept or not."""

Row = dict[str, Any]


def options(description: str, folder: Path, smoke: str) -> tuple[bool, Path]:
    """Whether to run small, and the folder for results."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--smoke", action="store_true", help=smoke)
    parser.add_argument("--results", metavar="DIR", help="folder for the results")
    chosen = parser.parse_args()
    own = None if chosen.smoke else str(folder / "results")
    return chosen.smoke, results_folder(chosen.results or own, smoke=chosen.smoke)


def slug(text: str) -> str:
    """A text as the name of a folder."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def identified(
    fleet: Fleet,
    method: Identification,
    cases: Sequence[Case],
    folder: Path,
    **names: Any,
) -> list[Row]:
    """Rows of one sweep, kept in `folder/runs` under `names`, which the rows carry.

    A row has the scores of the end, and of what was grown under `..._start`.
    """
    place = folder / "runs" / "_".join(slug(str(v)) for v in names.values())
    work = IdentificationWork(fleet, method, cases, lanes=LANES)
    solution = run_sweep(work, place, chunk=CHUNK, progress=shown(place.name))
    wanted = KEPT + SCORES + tuple(f"{s}_start" for s in SCORES)
    told = [
        {name: setting_label(method, path) or 0 for name, path in SETTINGS.items()}
        for method in work.methods
    ]
    return [
        names | told[row["case"]] | {k: row[k] for k in wanted}
        for row in solution.value.rows()
    ]


def shown(name: str) -> Callable[[dict[str, Any]], None]:
    """Progress as lines."""

    def show(news: dict[str, Any]) -> None:
        print(f"{name}: {news['done']} of {news['of']}", flush=True)

    return show


def start_row(row: Row, **names: Any) -> Row:
    """What was grown, as a row of its own."""
    lost = not np.isfinite(row["validation_free_run_start"])
    lost |= not np.isfinite(row["test_free_run_start"])
    scores = {s: row[f"{s}_start"] for s in SCORES}
    return row | scores | {"status": "diverged" if lost else "ok"} | names


def table_of(rows: Sequence[Row]) -> SweepTable:
    """Rows as a table, without the scores of the start."""
    return SweepTable.from_rows(
        [{k: v for k, v in row.items() if not k.endswith("_start")} for row in rows]
    )


def write_table(table: SweepTable, path: Path) -> None:
    """Write a table as Parquet."""
    from pyarrow import parquet

    parquet.write_table(table.arrow, path, compression="zstd")


def spread(rows: Sequence[Row], score: str = "test_free_run") -> dict[str, Any]:
    """Median and quartiles over members that hold, the largest and whose it is."""
    held = [r for r in rows if np.isfinite(r[score])]
    if not held:
        return {"members": len(rows), "diverged": len(rows)}
    values = [r[score] for r in held]
    worst = max(held, key=lambda r: r[score])
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return {
        "members": len(rows),
        "median": rounded(middle),
        "quartiles": [rounded(low), rounded(high)],
        "largest": rounded(worst[score]),
        "worst": worst["engine"],
        "diverged": len(rows) - len(held),
    }


def rounded(value: float) -> float:
    """Four significant digits."""
    return float(f"{value:.4g}")


def compared(found: Comparison) -> dict[str, Any]:
    """A comparison as plain values."""

    def interval(i: Interval) -> list[float]:
        return [rounded(i.value), rounded(i.low), rounded(i.high)]

    worst = {
        k: rounded(v) if isinstance(v, float) else v for k, v in found.worst.items()
    }
    return {
        "pairs": len(found.before),
        "ratio": interval(found.ratio),
        "improved": interval(found.improved),
        "worst": worst,
        "failed": [found.failed_before, found.failed_after, found.failed_both],
    }
