"""Trees of local models on two functions: sigmoid trees, LOLIMOT, linear-tree.

    surface   y = 0.1/(0.1 + (1 - u1)/2 + (1 - u2)/2), grid of 25 x 25, 6 models
    fraction  y = 0.1/(0.1 + sum_i (1 - u_i)/4), four variables, 10,000 uniform points,
              noise of 5 % of the standard deviation, 20 models, several seeds

The first is scored on its own points, the second on 100,000 fresh points without noise.
Both bend along the diagonal: cuts across one variable cannot follow it. Affine local
models throughout. Sigmoid trees are grown with straight and with turned gates, and the
latter refined together with all coefficients. Each is grown with several smoothnesses,
one compiled program for all, and kept with the one of the smallest AICc: no test point
takes part in a choice. linear-tree takes a depth, not a number of models: the smallest
depth that gives as many leaves or more, and as few samples in each as ours.

Growth by itself ends near 0.015 in four variables; refinement takes it to 0.010. With
little ridge the refinement fits its training points better and ends far off between
them: local models that overlap run apart.

    python experiments/benchmarks/trees.py [--smoke] [--peers PYTHON] [--results DIR]

Reference: O. Nelles 2006; the first function is that of B. Hartmann and O. Nelles 2009.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from common import benchmark_parser, record, results_folder, target, worker

SEEDS, NOISE, LIMIT = 3, 0.05, 1800.0
SMOOTHNESSES = (0.7, 1.0, 1.4, 2.0)
RIDGE = 1e-4
LIMITS = {"surface": 0.040, "fraction": 0.015}
REFINED = "sigmoid tree, refined"
NOTES = {
    "nrmse": "RMSE over the standard deviation, against values without noise: of the "
    "surface on its training grid, of the fraction on fresh points",
    "seconds": "wall time of one growth: the first call of a process, with "
    "compilation, and a second one",
    "refined": f"PredictionError(ridge={RIDGE:g}) from the grown tree; its seconds are "
    "those of one call, with compilation",
    "smoothness": f"of {SMOOTHNESSES}, the one with the smallest AICc",
}


def problem(name: str, seed: int, samples: int):
    """Inputs and outputs of training, then inputs and noise-free outputs of the test.

    Uses numpy alone: the peers' interpreter has no jax.
    """
    import numpy as np

    rng = np.random.default_rng(seed)
    if name == "surface":
        axis = np.linspace(0, 1, 25)
        u = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
        return u, fraction(u), u, fraction(u)
    u, test = rng.uniform(size=(samples, 4)), rng.uniform(size=(100_000, 4))
    clean = fraction(u)
    return (
        u,
        clean + NOISE * clean.std() * rng.normal(size=samples),
        test,
        fraction(test),
    )


def fraction(u):
    """0.1/(0.1 + mean_i (1 - u_i))."""
    return 0.1 / (0.1 + (1 - u).mean(axis=1))


def nrmse(y, predicted) -> float:
    """RMSE over the standard deviation of `y`."""
    return float(f"{((y - predicted) ** 2).mean() ** 0.5 / y.std():.4g}")


def timed(call: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    """The result of the second call, and the seconds of both."""
    seconds, result = [], None
    for _ in range(2):
        begin = time.perf_counter()
        result = call()
        seconds.append(float(f"{time.perf_counter() - begin:.3g}"))
    return result, dict(zip(("first", "again"), seconds, strict=True))


def own(name: str, seed: int, samples: int, models: int) -> dict[str, Any]:
    """Our rows: LOLIMOT, and sigmoid trees of three kinds."""
    import jax
    import numpy as np

    jax.config.update("jax_enable_x64", True)
    import jaxnarx as jnx

    u, y, test, clean = problem(name, seed, samples)
    names = [f"u{n + 1}" for n in range(u.shape[1])]
    settings = {"inputs": names, "outputs": ["y"], "sample_time": 1.0}
    data = jnx.Dataset.from_arrays(u, y, **settings)
    fresh = jnx.Dataset.from_arrays(test, clean, **settings)
    pool = jnx.polynomial_pool(data.channels, input_lags=(0,), output_lags=(), degree=1)
    common = {"max_models": models, "criterion": "none"}
    scheduling = [f"{n}[t]" for n in names]
    methods = {
        "LOLIMOT": [jnx.Lolimot(scheduling, **common)],
        "sigmoid tree, straight": [
            jnx.SigmoidTree(scheduling, smoothness=s, oblique=False, **common)
            for s in SMOOTHNESSES
        ],
        "sigmoid tree": [
            jnx.SigmoidTree(scheduling, smoothness=s, **common) for s in SMOOTHNESSES
        ],
    }
    rows: dict[str, Any] = {}

    def add(row: str, network: jnx.Network, seconds: Any, **more: Any) -> None:
        predicted = np.concatenate(jnx.predict(network, fresh).value)[:, 0]
        size = int(network.models[0].active.sum())
        error = nrmse(clean, predicted)
        rows[row] = {"models": size, "nrmse": error, "seconds": seconds, **more}

    grown = None
    for row, settings in methods.items():
        _, seconds = timed(lambda m=settings[0]: jnx.grow(pool, data, m))
        found = [jnx.grow(pool, data, method) for method in settings]
        best = min(range(len(found)), key=lambda n: found[n].stats["aicc"][0][-1])
        grown = found[best].value
        kept = {"smoothness": SMOOTHNESSES[best]} if len(found) > 1 else {}
        add(row, grown, seconds, **kept)
    assert grown is not None
    begin = time.perf_counter()
    refined = jnx.refine(grown, data, jnx.PredictionError(ridge=RIDGE))
    seconds = {"first": float(f"{time.perf_counter() - begin:.3g}")}
    add(REFINED, refined.value, seconds, status=refined.status_name)
    return rows


def linear_tree(name: str, seed: int, samples: int, models: int) -> dict[str, Any]:
    """linear-tree with linear regressions in its leaves."""
    import importlib.metadata

    from lineartree import (  # pyright: ignore[reportMissingImports]
        LinearTreeRegressor,
    )
    from sklearn.linear_model import (  # pyright: ignore[reportMissingImports]
        LinearRegression,
    )

    u, y, test, clean = problem(name, seed, samples)
    rows = {}
    for depth in range(1, 12):
        fitted, seconds = timed(
            lambda depth=depth: LinearTreeRegressor(
                LinearRegression(),
                max_depth=depth,
                min_samples_leaf=u.shape[1] + 1,
            ).fit(u, y)
        )
        leaves = len(fitted.summary(only_leaves=True))
        if leaves >= models:
            score = nrmse(clean, fitted.predict(test))
            row = {"models": leaves, "nrmse": score, "seconds": seconds}
            rows["linear-tree"] = row | {"depth": depth}
            break
    version = importlib.metadata.version("linear-tree")
    return {"rows": rows, "versions": {"linear-tree": version}}


WORKERS = {"own": own, "linear-tree": linear_tree}


def measure(peers: str | None, *, smoke: bool) -> tuple[dict[str, Any], dict[str, str]]:
    """All rows of both functions, and the peers' versions."""
    sizes = (
        {"samples": 600, "models": 4} if smoke else {"samples": 10_000, "models": 20}
    )
    plan = {
        "surface": [{"seed": 0, "samples": 625, "models": 6}],
        "fraction": [{"seed": s, **sizes} for s in range(1 if smoke else SEEDS)],
    }
    versions: dict[str, str] = {}
    figures: dict[str, Any] = {"notes": NOTES}
    for name, runs in plan.items():
        found = []
        for options in runs:
            rows = run("own", sys.executable, name=name, **options)
            if peers is not None:
                peer = run("linear-tree", peers, name=name, **options)
                rows |= peer["rows"]
                versions |= peer["versions"]
            found.append(rows)
            show(name, rows)
        figures[name] = {**runs[0], "runs": found, "summary": summary(found)}
    figures["targets"] = {
        name: target(_aim(figures[name]["summary"]), LIMITS[name]) for name in plan
    }
    return figures, versions


def run(name: str, python: str, /, **options: Any) -> dict[str, Any]:
    """A worker in a process of its own; a peer that fails leaves a note."""
    script, text = str(Path(__file__).resolve()), json.dumps(options)
    found, done = worker(script, "--worker", name, text, python=python, limit=LIMIT)
    if found is not None:
        return found
    why = (done.stderr.strip().splitlines() or ["stopped"])[-1]
    if name == "own":
        raise SystemExit(why)
    return {"rows": {name: {"failed": why}}, "versions": {}}


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """The median and the largest error of every row over the seeds."""
    out = {}
    for row in runs[0]:
        errors = sorted(r[row]["nrmse"] for r in runs if "nrmse" in r.get(row, {}))
        if errors:
            median, worst = errors[len(errors) // 2], errors[-1]
            out[row] = {"median": median, "worst": worst, "seeds": len(errors)}
    return out


def _aim(rows: dict[str, Any]) -> float:
    """The worst seed of the better of our two turned trees."""
    return min(rows[row]["worst"] for row in ("sigmoid tree", REFINED))


def show(name: str, rows: dict[str, Any]) -> None:
    """One line a row."""
    for row, one in rows.items():
        if "failed" in one:
            print(f"{name:9s} {row:24s} {one['failed']}")
            continue
        print(
            f"{name:9s} {row:24s}{one['models']:4d} models  NRMSE {one['nrmse']:.4f}  "
            f"{one['seconds']} smoothness {one.get('smoothness', '-')}",
            flush=True,
        )


def main() -> None:
    """Run what the command line asks for."""
    parser = benchmark_parser("Trees of local models.", "few points and models")
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(json.dumps(WORKERS[name](**json.loads(options))))
        return
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    figures, versions = measure(chosen.peers, smoke=chosen.smoke)
    path = record("trees", figures, folder=folder, versions=versions, note=chosen.note)
    print(path, figures["targets"])


if __name__ == "__main__":
    main()
