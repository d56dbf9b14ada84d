"""Tables of thesis chapter 4 over all seeds, with the thesis's own figures."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from chapter4_algorithms import LIMIT
from chapter4_models import MODES, PARTS, STRUCTURE
from multi_models import spread, table

THESIS = {
    "fit, ARX by the toolbox": 75.8,
    "fit, ARX by least squares": 73.93,
    "R2, ARX by least squares": 99.8,
    "fit, NARX with squares beyond ARX": 5.0,
    "unexplained variance, best ARX": 31.6,
    "residual of NARX [rpm]": {"least": -10.0, "largest": 30.0, "mean": 7.5848},
    "mismatch of algorithms, below": LIMIT,
}
"""In per cent; which record and run a figure scores is not always said."""


def merits(seeds: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Fit and R2 of every model by record and run: median and least of the seeds."""
    rows = []
    for name in seeds[0]["models"]:
        own = [seed["models"][name] for seed in seeds]
        row: dict[str, Any] = {"model": name}
        row["parameters"] = float(np.median([m["parameters"] for m in own]))
        row["diverged"] = sum(m["diverged"] for m in own)
        for part in PARTS:
            for mode in MODES:
                for score in ("fit", "r2"):
                    values = [m[part][mode][score] for m in own]
                    row[f"{part}_{mode}_{score}"] = spread(values)
        rows.append(row)
    return rows


def gains(seeds: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Points of free-run fit that a model has beyond the ARX model (6, 6, 6)."""
    found = {}
    for name in seeds[0]["models"]:
        found[name] = {
            part: spread(
                [
                    s["models"][name][part]["free_run"]["fit"]
                    - s["models"][STRUCTURE][part]["free_run"]["fit"]
                    for s in seeds
                ]
            )
            for part in PARTS[1:]
        }
    return found


def way_summary(seeds: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The worst of the seeds for every structure, algorithm and scaling."""
    rows = []
    for name, first in seeds[0]["algorithms"].items():
        for n, row in enumerate(first):
            own = [seed["algorithms"][name][n] for seed in seeds]
            worst = {
                key: max(r[key] for r in own)
                for key in ("coefficient", "errors", "mismatch_percent")
            }
            conditions = [r["condition"] for r in own if r["condition"] is not None]
            rows.append(
                {
                    "structure": name,
                    "algorithm": row["algorithm"],
                    "scaling": row["scaling"],
                    "condition": max(conditions, default=None),
                    "rank": min(r["rank"] for r in own),
                    **worst,
                    "met": worst["mismatch_percent"] < LIMIT,
                }
            )
    return rows


def summary(seeds: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What is said of all seeds together."""
    return {
        "seeds": len(seeds),
        "coherence_least_in_band": spread(
            [s["coherence"]["least_in_band"] for s in seeds]
        ),
        "coherence_median_in_band": spread(
            [s["coherence"]["median_in_band"] for s in seeds]
        ),
        "nonlinear_share": spread([s["coherence"]["nonlinear_share"] for s in seeds]),
        "orders": {k: [s["orders"][k] for s in seeds] for k in ("mdl", "aic")},
        "fits": merits(seeds),
        "fit_beyond_arx": gains(seeds),
        "algorithms": way_summary(seeds),
        "dc_gain": {
            name: spread([s["transfer"][name]["dc_gain_rpm_per_duty"] for s in seeds])
            for name in seeds[0]["transfer"]
        },
    }


def show(found: Mapping[str, Any], first: Mapping[str, Any]) -> None:
    """Print the tables; transfer functions and sizes are the first seed's."""
    sizes = [
        row | {"orders": str(tuple(row["orders"]))} for row in first["orders"]["sizes"]
    ]
    columns = {"parameters": "d", "orders": "", "unexplained_percent": ".5f"}
    print(table(sizes, columns | {"free_run_fit": ".2f"}))
    print(f"\nMDL {found['orders']['mdl']}, AIC {found['orders']['aic']}\n")
    for name, own in first["transfer"].items():
        print(f"{name}: G = {own['text']}, gain {own['dc_gain_rpm_per_duty']:.5g}")
    columns = {"structure": "", "algorithm": "", "scaling": "", "rank": "d"}
    columns |= {"condition": ".3g", "coefficient": ".2g", "errors": ".2g"}
    print("\nLargest distances from QR, worst of the seeds")
    print(table(found["algorithms"], columns | {"mismatch_percent": ".2g"}))
    for score in ("fit", "r2"):
        rows = [_medians(row, score) for row in found["fits"]]
        names = [key for key in rows[0] if key not in ("model", "parameters")]
        kinds = {"model": "", "parameters": ".0f", **dict.fromkeys(names, ".2f")}
        print(f"\n{score} [%], median (and least) of {found['seeds']} seeds")
        print(table(rows, kinds))
    rows = [
        {"model": name, "gain": gain["validation"]["median"]}
        for name, gain in found["fit_beyond_arx"].items()
    ]
    print("\nFree-run fit on validation beyond ARX(6, 6, 6) (thesis: 5 for squares)")
    print(table(rows, {"model": "", "gain": ".2f"}))
    print(f"\nThesis: {THESIS}")


def _medians(row: Mapping[str, Any], score: str) -> dict[str, Any]:
    short = {"identification": "ident.", "validation": "valid.", "unseen": "unseen"}
    values = {
        f"{text} {mode.split('_')[0]}": row[f"{part}_{mode}_{score}"]["median"]
        for mode in MODES
        for part, text in short.items()
    }
    least = row[f"unseen_free_run_{score}"]["least"]
    out = {"model": row["model"], "parameters": row["parameters"], **values}
    return out | {"(least)": least}
