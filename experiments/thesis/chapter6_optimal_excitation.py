"""Optimal adjustment of an excitation plan (thesis 6.2.1) on the `pfi` bed.

Question: does a plan whose log det of the information matrix was raised by gradient
also lead to smaller parameter errors once the engine is identified from it?

For each of 20 seeds: a random APRBS plan of the valve duty, and the same plan with its
levels adjusted under the same length, hold times, range and rate limit. The design does
not know the engine: it uses parameters that are wrong by 5 %. Then the true engine is
run under both plans, measurement noise is added several times, and eight of its
parameters are identified from speed and manifold pressure by Gauss-Newton, started from
the wrong values. The error is the root mean square over parameters of the relative
error, the bound that of Cramer and Rao at the true parameters.

Run as `python experiments/thesis/chapter6_optimal_excitation.py [--results DIR]
[--smoke]`. Writes chapter6_optimal_excitation.json and .png.
"""

import argparse
import json
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.figure
import numpy as np

from jaxnarx.design import ResponseSensitivity, adjust, criteria
from jaxnarx.engines import Pfi
from jaxnarx.excitation import AprbsPlan, aprbs_plan, render
from jaxnarx.settings import OptimalDesign

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from common import record  # noqa: E402 # pyright: ignore[reportMissingImports]

jax.config.update("jax_enable_x64", True)  # before an engine is made

SEEDS, REPEATS, STEPS, LENGTH = 20, 5, 60, 1500
HOLD, RATE = (20, 120), 0.002  # events, duty per event
WRONG = 0.05  # what the design and the identification start from is wrong by this
ITERATIONS = 10
PARAMETERS = (
    *("valve_flow", "valve_width", "valve_time", "leak_flow"),
    *("manifold_volume", "inertia", "load_constant", "load_quadratic"),
)
KINDS = ("random", "adjusted")
NOISE = jnp.array([2.5, 0.3])  # rpm, kPa


class Bench(eqx.Module):
    """Speed and manifold pressure as a function of relative parameters."""

    engine: Pfi

    def __call__(self, p, inputs):
        where = lambda e: [getattr(e, name) for name in PARAMETERS]  # noqa: E731
        values = [v * jnp.exp(x) for v, x in zip(where(self.engine), p, strict=True)]
        return eqx.tree_at(where, self.engine, values).run(inputs)


BENCH = Bench(Pfi())


@eqx.filter_jit
def linearised(p, inputs):
    """Outputs, and their derivative in units of the noise."""
    slope = ResponseSensitivity(BENCH, p, NOISE)(inputs)
    return BENCH(p, inputs), slope


def identify(inputs, measured, start):
    """Gauss-Newton on relative parameters; the last estimate."""
    p = start
    for _ in range(ITERATIONS):
        outputs, slope = linearised(p, inputs)
        error = np.asarray((measured - outputs) / NOISE[None]).ravel()
        step = np.linalg.lstsq(np.asarray(slope).reshape(len(error), -1), error)[0]
        # Far steps are cut: the model is nonlinear, the engine may stall.
        p = p + jnp.asarray(step * min(1.0, 0.1 / np.abs(step).max()))
    return np.asarray(p)


def judged(plan: AprbsPlan, key, start) -> dict:
    """Criteria at the truth, its bound, and the errors of repeated identification."""
    inputs = render(plan)
    outputs, slope = linearised(jnp.zeros(len(PARAMETERS)), inputs)
    found = criteria(slope, slope)
    errors = []
    for k in jax.random.split(key, REPEATS):
        noise = NOISE[None] * jax.random.normal(k, outputs.shape)
        estimate = identify(inputs, outputs + noise, start)
        errors.append(float(np.sqrt(np.mean(estimate**2))))
    bound = float(jnp.sqrt(found.trace / len(PARAMETERS)))
    return {"log_det": float(found.log_det), "bound": bound, "errors": errors}


def trial(seed: int, *, length: int, steps: int) -> tuple[dict, dict]:
    """Both plans of one seed, judged, and their signals."""
    keys = jax.random.split(jax.random.key(seed), 3)
    span = Pfi().ranges["duty"]
    plan = aprbs_plan(
        keys[0],
        length,
        inputs={"duty": span},
        hold=HOLD,
        rate=RATE,
        placement="uniform",
        shorten=True,
    )
    guess = WRONG * jax.random.normal(keys[1], (len(PARAMETERS),))
    sensitivity = ResponseSensitivity(BENCH, guess, NOISE)
    solution = adjust(plan, sensitivity, OptimalDesign(max_steps=steps))
    plans = dict(zip(KINDS, (plan, solution.value), strict=True))
    row = {"seed": seed, "status": solution.status_name}
    row["efficiency_at_guess"] = solution.stats["efficiency"]
    row |= {kind: judged(plans[kind], keys[2], guess) for kind in KINDS}
    return row, {kind: np.asarray(render(plans[kind])) for kind in KINDS}


def summary(rows: list[dict]) -> dict:
    """Medians and quartiles over seeds of what the adjustment changed."""
    gain = [r["adjusted"]["log_det"] - r["random"]["log_det"] for r in rows]
    error = {k: [float(np.median(r[k]["errors"])) for r in rows] for k in KINDS}
    ratio = np.divide(error["adjusted"], error["random"])
    return {
        "seeds": len(rows),
        "log_det_rises_in": int(np.sum(np.array(gain) > 0)),
        "error_falls_in": int(np.sum(ratio < 1)),
        "log_det_gain": spread(gain),
        "error_ratio": spread(ratio),
        **{f"relative_error_{k}": spread(error[k]) for k in KINDS},
        **{f"bound_{k}": spread([r[k]["bound"] for r in rows]) for k in KINDS},
    }


def spread(values) -> dict:
    """Median, quartiles and extremes."""
    q = np.quantile(np.asarray(values, float), [0, 0.25, 0.5, 0.75, 1])
    names = ("least", "lower_quartile", "median", "upper_quartile", "largest")
    return dict(zip(names, q.tolist(), strict=True))


def draw(rows: list[dict], example: dict) -> matplotlib.figure.Figure:
    """Both plans of the first seed, and information against error of all."""
    figure = matplotlib.figure.Figure(figsize=(9, 6), layout="constrained")
    top, low = figure.subfigures(2, 1, squeeze=False)[:, 0]
    axes = top.subplots(1, 1)
    for kind, color in zip(KINDS, ("0.55", "C0"), strict=True):
        axes.plot(example[kind], color=color, lw=1.1, label=f"{kind} plan")
    axes.set(xlabel="event of 180°", ylabel="duty [-]", title="first seed")
    axes.legend(ncols=2, loc="lower left", bbox_to_anchor=(0.75, 1.0), frameon=False)
    left, right = np.ravel(low.subplots(1, 2))
    for r in rows:
        pair = [(r[k]["log_det"], 100 * np.median(r[k]["errors"])) for k in KINDS]
        left.plot(*np.transpose(pair), color="0.8", lw=0.8, zorder=0)
    for kind, color in zip(KINDS, ("0.35", "C0"), strict=True):
        x = [r[kind]["log_det"] for r in rows]
        y = [100 * np.median(r[kind]["errors"]) for r in rows]
        left.plot(x, y, "o", color=color, ms=4, label=kind)
        bound = [100 * r[kind]["bound"] for r in rows]
        right.plot(bound, y, "o", color=color, ms=4, label=kind)
    left.set(xlabel="log det of the information", ylabel="parameter error [%]")
    left.legend(frameon=False)
    ends = [0, max(right.get_xlim()[1], right.get_ylim()[1])]
    right.plot(ends, ends, color="0.7", lw=0.8, zorder=0)
    right.set(xlabel="Cramér-Rao bound [%]", ylabel="parameter error [%]")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description="Optimal excitation on pfi.")
    parser.add_argument("--results", default=str(Path(__file__).with_name("results")))
    parser.add_argument("--smoke", action="store_true", help="two seeds, short plans")
    options = parser.parse_args()
    seeds, length, steps = (2, 300, 3) if options.smoke else (SEEDS, LENGTH, STEPS)
    rows, plans = [], {}
    for seed in range(seeds):
        row, made = trial(seed, length=length, steps=steps)
        rows.append(row)
        plans = plans or made
        r = rows[-1]
        print(
            f"seed {seed}: log det {r['random']['log_det']:.2f} -> "
            f"{r['adjusted']['log_det']:.2f}, error "
            f"{100 * np.median(r['random']['errors']):.3f} % -> "
            f"{100 * np.median(r['adjusted']['errors']):.3f} %",
            flush=True,
        )
    found = summary(rows)
    print(json.dumps(found, indent=1))
    folder = Path(options.results)
    record("chapter6_optimal_excitation", found | {"rows": rows}, folder=folder)
    draw(rows, plans).savefig(folder / "chapter6_optimal_excitation.png", dpi=130)


if __name__ == "__main__":
    main()
