"""Inverse multi-model of a turbocharged engine, and its feedforward control (7.3).

TODO
"""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from inverse_bed import TARGETS
from inverse_diesel import reversal
from inverse_drawings import draw, draw_reversal
from inverse_seed import Size, seed_of
from multi_models import (
    parsed,
    record,  # pyright: ignore[reportAttributeAccessIssue]
    spread,
    table,
)

NAME = "chapter7_inverse"
SEEDS, DIESEL = 3, 3
RUNS = ("constant", "PI", "direct", "air terms", "refined", "refined + PI")
THESIS = {"SA": {"fit": 68.6, "r2": 0.90}, "THR": {"fit": 63.8, "r2": 0.90}}
GOAL = {"refined_lower_by": 0.30, "static_gain_within": 0.05}


def kept(folder: Path) -> dict[str, Any]:
    """Rows of an earlier run."""
    path = folder / f"{NAME}.json"
    if not path.exists():
        return {"rows": [], "diesel": []}
    figures = json.loads(path.read_text(encoding="utf-8"))["figures"]
    return {"rows": figures["rows"], "diesel": figures["diesel"]}


def middle(values: Sequence[float]) -> dict[str, Any]:
    return spread([float(v) for v in values])


def summary(rows: Sequence[dict]) -> dict[str, Any]:
    """Medians over seeds (and engines) of what the rows hold, on test records."""
    inverse = {
        channel: {
            mode: {
                k: middle(
                    [r["inverse"]["direct"]["test"][mode][channel][k] for r in rows]
                )
                for k in ("fit", "r2")
            }
            for mode in ("persistence", "one_step", "free_run")
        }
        for channel in THESIS
    }
    bed = {
        run: {t: middle([r["bed"][run][t] for r in rows]) for t in (*TARGETS, "trim")}
        for run in RUNS
    }
    others = [one for r in rows for one in r["mismatch"]]
    mismatch = {
        run: {t: middle([o[run][t] for o in others]) for t in (*TARGETS, "trim")}
        for run in RUNS
    }
    lower = {
        where: {
            t: middle([1 - r[k]["refined"][t] / r[k]["direct"][t] for r in rows])
            for t in TARGETS
        }
        for where, k in (("bed", "bed"), ("model", "on_model"))
    }
    spark = {
        who: {
            k: middle([r["spark"][who][k] for r in rows]) for k in rows[0]["spark"][who]
        }
        for who in rows[0]["spark"]
    }
    unity = {
        name: {
            k: {
                t: middle(
                    [
                        r["unity"][name][k][t]
                        for r in rows
                        if r["unity"][name][k][t] is not None
                    ]
                    or [np.inf]
                )
                for t in TARGETS
            }
            for k in ("median", "worst", "within_5_percent")
        }
        for name in ("direct", "air terms", "refined")
    }
    return {
        "inverse": inverse,
        "bed": bed,
        "mismatch": mismatch,
        "refined_lower_by": lower,
        "spark": spark,
        "unity": unity,
    }


def show(found: dict[str, Any], diesel: Sequence[dict]) -> None:
    """Print the medians beside the thesis."""
    print("\nfree run of the inverse on unseen data, medians; thesis beside it")
    rows = [
        {"command": c, "mode": mode, "thesis fit": THESIS[c]["fit"]}
        | {k: v[k]["median"] for k in ("fit", "r2")}
        for c, modes in found["inverse"].items()
        for mode, v in modes.items()
    ]
    print(
        table(
            rows,
            {"command": "", "mode": "", "fit": ".1f", "r2": ".3f", "thesis fit": ".1f"},
        )
    )
    print("\ntracking on the bed, NRMSE, medians; trim: rms share of the fuel")
    rows = [
        {"run": run, "engine": where}
        | {t: found[where][run][t]["median"] for t in (*TARGETS, "trim")}
        for where in ("bed", "mismatch")
        for run in RUNS
    ]
    print(
        table(
            rows,
            {"run": "", "engine": "", "TRQ": ".4f", "lambda": ".4f", "trim": ".4f"},
        )
    )
    for where, lower in found["refined_lower_by"].items():
        print(
            where,
            "refined lower by",
            {t: round(v["median"], 3) for t, v in lower.items()},
        )
    for row in diesel:
        print("diesel", row["seed"], row["target"], row["status"], row["region"])


def main() -> None:
    options = parsed(__doc__ or "", "one seed, short records, few steps")
    jax.config.update("jax_enable_x64", True)
    folder, smoke = options.results, options.smoke
    size = (
        Size(length=300, steps=1, trained=1, relatives=1, points=4) if smoke else Size()
    )
    found = kept(folder)

    def write(**figures: Any) -> None:
        record(
            NAME, {**figures, "thesis": THESIS, "goal": GOAL, **found}, folder=folder
        )

    for seed in range(1 if smoke else SEEDS):
        if any(row["seed"] == seed for row in found["rows"]):
            continue
        row, case = seed_of(seed, size)
        if seed == 0:
            draw(case, folder, NAME, size.points)
        found["rows"].append({"seed": seed, "size": dataclasses.asdict(size), **row})
        write()
    for seed in range(1 if smoke else DIESEL):
        if any(row["seed"] == seed for row in found["diesel"]):
            continue
        for made in reversal(seed, smoke=smoke):
            if seed == 0 and made["target"] == "W_c":
                draw_reversal(made, folder, NAME)
            short = {k: v for k, v in made.items() if not isinstance(v, np.ndarray)}
            found["diesel"].append({"seed": seed, **short})
        write()
    total = summary(found["rows"])
    write(summary=total)
    show(total, found["diesel"])


if __name__ == "__main__":
    main()
