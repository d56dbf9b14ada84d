"""Tables of thesis section 6.3 as text, with the thesis's own choice beside ours."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from multi_models import spread, table

FIVE = 5
"""Regressors of a local model in Table 6.2; more lowered the fitness (figure 6.6)."""
SPEEDS = (1150, 1350, 1550, 1750)
_ABV, _FPW = "ABV[t-1]*ABV[t-1]", "FPW[t-1]*FPW[t-1]"
THESIS = {
    ("TRQ", "local cubic, F"): (
        "TRQ[t-1] ABV[t-2] RPM[t-5]*TRQ[t-3] RPM[t-1]*TRQ[t-3] FPW[t-1]*ABV[t-1]^2",
        "TRQ[t-1] ABV[t-2] RPM[t-6]*TRQ[t-3] RPM[t-1]*TRQ[t-3] "
        "FPW[t-1]*ABV[t-4]*ABV[t-6]",
        "TRQ[t-1] RPM[t-1] MAP[t-1]*FPW[t-2] MAP[t-2]*TRQ[t-2] "
        "RPM[t-5]*RPM[t-4]*RPM[t-4]",
        "TRQ[t-1] RPM[t-1] RPM[t-2]*RPM[t-3] ABV[t-1]*TRQ[t-3] "
        "FPW[t-1]*RPM[t-1]*RPM[t-3]",
    ),
    ("TRQ", "local cubic, ERR"): (
        f"TRQ[t-1] TRQ[t-3] {_ABV} {_FPW} ABV[t-3]^2*ABV[t-5]",
        f"TRQ[t-1] TRQ[t-3] {_ABV} {_FPW} ABV[t-4]^2*ABV[t-6]",
        f"TRQ[t-1] TRQ[t-2] {_FPW} ABV[t-2]*ABV[t-2] FPW[t-5]^2*ABV[t-5]",
        f"TRQ[t-1] TRQ[t-3] MAP[t-1]*FPW[t-1] {_FPW} FPW[t-5]^2*ABV[t-5]",
    ),
    ("AFR", "local cubic, F"): (
        "AFR[t-1] FPW[t-5] ABV[t-6]*AFR[t-2] MAP[t-4]*AFR[t-3] "
        "AFR[t-1]*FPW[t-6]*AFR[t-2]",
        "AFR[t-1] ABV[t-5] FPW[t-4]*FPW[t-6] MAP[t-5]*AFR[t-2] "
        "AFR[t-3]*MAP[t-4]*RPM[t-1]",
        "AFR[t-1] AFR[t-2] FPW[t-6]*AFR[t-3] AFR[t-3]*MAP[t-6]*RPM[t-3]",
        "AFR[t-1] AFR[t-2] FPW[t-6]*AFR[t-1] MAP[t-4]*RPM[t-1] "
        "AFR[t-3]*RPM[t-1]*RPM[t-3]",
    ),
    ("AFR", "local cubic, ERR"): (
        "AFR[t-1] AFR[t-2] FPW[t-5]*FPW[t-5] ABV[t-5]*ABV[t-5] "
        "AFR[t-3]*ABV[t-6]*ABV[t-6]",
        "AFR[t-1] AFR[t-2] FPW[t-4]*FPW[t-4] ABV[t-5]*ABV[t-5] FPW[t-6]^2*AFR[t-2]",
        "AFR[t-1] AFR[t-2] FPW[t-6]*FPW[t-6] AFR[t-3]*MAP[t-6]*FPW[t-2] "
        "ABV[t-5]*ABV[t-5]",
        "AFR[t-1] AFR[t-2] FPW[t-6]*FPW[t-6] MAP[t-1]*MAP[t-1] "
        "AFR[t-3]*MAP[t-5]*MAP[t-5]",
    ),
}
"""Regressors of Table 6.2 beside the constant, region by region; factors that the table
breaks over two lines are put together."""

KEY = ("output", "series", "regressors", "width", "inputs")


def summary(rows: Sequence[dict]) -> list[dict[str, Any]]:
    """Every series at every size: fit over the seeds, and how many runs diverged."""
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault(tuple(row.get(k) for k in KEY), []).append(row)
    return [
        {
            **dict(zip(KEY, key, strict=True)),
            "multiplications": float(
                np.median([row["cost"]["multiplications"] for row in group])
            ),
            "diverged": sum(row["test"]["free_run"]["diverged"] for row in group),
            **{
                f"{part}_{mode}": spread([row[part][mode]["fit"] for row in group])
                for part in ("validation", "test")
                for mode in ("one_step", "free_run")
            },
        }
        for key, group in groups.items()
    ]


def best_sizes(found: Sequence[dict]) -> dict[tuple[str, str], int]:
    """Regressors with the largest median fit of the free run on validation."""
    best: dict[tuple[str, str], dict] = {}
    for row in found:
        if row["regressors"] is None or row["series"].endswith("refined"):
            continue
        key, fit = (row["output"], row["series"]), row["validation_free_run"]["median"]
        if key not in best or fit > best[key]["validation_free_run"]["median"]:
            best[key] = row
    return {key: row["regressors"] for key, row in best.items()}


def show_quality(found: Sequence[dict]) -> None:
    """Fit of five regressors and of the perceptrons, and the best sizes."""
    columns = {"series": "", "width": "", "inputs": "", "mult.": ".0f"}
    scores = {
        f"{mode} {part}".replace("_", " "): f"{part}_{mode}"
        for mode in ("one_step", "free_run")
        for part in ("validation", "test")
    }
    columns |= dict.fromkeys(scores, ".1f") | {"diverged": "d"}
    for output in dict.fromkeys(row["output"] for row in found):
        print(f"\n{output}: median fit [%], {FIVE} regressors or a perceptron")
        shown = [
            row
            | {"mult.": row["multiplications"]}
            | {text: row[name]["median"] for text, name in scores.items()}
            for row in found
            if row["output"] == output and row["regressors"] in (None, FIVE)
        ]
        print(table(shown, columns))
    print(f"\nRegressors with the best free run on validation (thesis: {FIVE})")
    for (output, series), n in best_sizes(found).items():
        print(f"  {output} {series}: {n}")


def show_terms(rows: Sequence[dict]) -> None:
    """Regressors of one seed beside those of Table 6.2."""
    for row in rows:
        printed = THESIS.get((row["output"], row["series"]))
        if row.get("regressors") != FIVE or printed is None:
            continue
        print(f"\n{row['output']}, {row['series']} (Table 6.2)")
        for speed, ours, theirs in zip(SPEEDS, row["terms"], printed, strict=True):
            print(f"  {speed} rpm  {' '.join(t for t in ours if t != '1')}")
            print(f"    thesis  {theirs}")
