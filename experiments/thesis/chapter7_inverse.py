"""Inverse multi-model of a turbocharged engine, and its feedforward control (7.3).

The `gtdi` bed read backwards: torque and lambda (0.24 and 0.48 s ahead), fuel, speed
and manifold pressure to spark and throttle. Products of two by ERR, three regions over
pressure and speed by sigmoids whose borders are optimised in the free run. Four records
of 1,200 samples (one cycle of the engine each) to identify, one to choose, one unseen.

Then the inverse in front of the bed, which is asked for outputs recorded under other
commands: noise on the sensors, dead times, one engine a seed with parameters off by a
spread of 10 %. `air terms` is the direct inverse with lambda times fuel (the air asked
for) and the pressure forced into its terms, `refined` that one with its throttle
trained on the tracking error through a forward network (cubic terms, free run) on
references that this network reaches itself. A PI from torque on throttle and from
lambda on fuel stands alone and beside it (`inverse_bench`), its speed chosen by
validation. `constant` holds the mean commands. On the `diesel` bed `invertible` looks
for the sign reversal of the turbine (`inverse_diesel`).

Differences from the thesis: the engine; fuel and speed are given, as the fuel of the
record follows its air; a preview of what is asked for.

What came out, medians over three seeds on unseen records. Free run of the direct
inverse: throttle 78.1 % and R2 0.95 (thesis 63.8 %, 0.90; persistence one step ahead
66.6 %), spark 44.9 % and 0.70 (thesis 68.6 %). Near the best spark a degree moves the
torque by 0.13 Nm, far from it by 0.86: who knows everything but the spark and reads the
torque with the sensor's 0.4 Nm reaches 69.8 %, and with our inverse's torque error of
2.0 Nm 46.7 %. So 30 of the missing 55 % are the engine's, nearly all the rest is that
the torque is not modelled to a hundredth; the wrong spark costs 0.7 Nm in the median.

Open loop on the bed, NRMSE of torque and lambda: constant 0.57 and 3.36, direct 0.060
and 0.188, air terms 0.064 and 0.182, refined 0.060 and 0.176. Lambda is 12 % lower (35,
12 and -15 % by seed), torque is not: the 30 % that were aimed at are reached on the
model (41 % lower for lambda), not on the bed, where the forward network's own error of
lambda, 0.16 to 0.21, is what is left. Spark through that network fits its error, so it
stays as it is. With an engine that is off, lambda is 0.48 to 0.55 open loop and 0.38
with the PI; the PI alone has 0.91 on the nominal engine and needs a trim of 10 % of the
fuel in place of 1 %. Asked for what the model holds at rest, fuel and speed of the
reference included, the cascade has a static gain of 1.012 for torque and 0.983 for
lambda (refined; 0.99 to 1.04 and 0.91 to 1.02 by seed), direct 0.994 and 0.939. One
reference moved alone under a fuel that stays is another matter: off one by 9 % for
lambda (worst point 32 %), and by 43 % for the torque, which spark alone cannot move
there, least of all at the best spark.

Diesel: the reversal of VGT on compressor flow is found on all three seeds, where VGT is
below 43 to 45 % and EGR above 27 to 32 % (one seed: where EGR is above 17 %), at 8 to
14 % of the points (6 to 11 % on the bed itself); 92 to 93 % of the clear signs agree.
On intake pressure, whose gain keeps its sign, none, at no point.

Run as `python experiments/thesis/chapter7_inverse.py [--smoke] [--results DIR]`. Goes
on where an earlier run stopped. Writes chapter7_inverse.json and, of the first seed,
its figures: _data (7.9), _tree (7.10), _regions (7.11), _fits (7.12, 7.13), _tracking
(7.14), _spark, _unity and _diesel.
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
    at_rest = {
        name: {
            k: {t: middle([r["at_rest"][name][k][t] for r in rows]) for t in TARGETS}
            for k in ("slope", "nrmse")
        }
        for name in ("direct", "air terms", "refined")
        if all("slope" in r["at_rest"][name] for r in rows)
    }
    return {
        "inverse": inverse,
        "at_rest": at_rest,
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
        Size(length=300, steps=1, trained=1, points=6, brief=True) if smoke else Size()
    )
    folder.mkdir(parents=True, exist_ok=True)
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
