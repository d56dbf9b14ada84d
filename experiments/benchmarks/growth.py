"""Time and memory of partition growth, beside a tree of linear models of another maker.

LOLIMOT to 16 models on 1,500 samples of four variables, three of them scheduling, one
data set and twelve in a batch; to 20 models on 10,000 samples; both as affine models.
With `--peers` linear-tree grows its tree of affine models, with hard borders, to a
depth that has room for as many leaves on the same data; package and peer are measured
in turn. A worker of its own grows eight models of sixteen terms on all training records
of `gengine1`.

    python experiments/benchmarks/growth.py [--smoke] [--peers PYTHON] [--results DIR]
"""

import importlib
import importlib.metadata
import importlib.util
import json
import math
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from common import (
    benchmark_parser,
    best_of,
    record,
    resident,
    results_folder,
    target,
    worker,
)

CASES = {
    "1,500 rows to 16": (1500, 16, 0.05),
    "10,000 rows to 20": (10000, 20, 1.0),
}
"""Rows, models, and the limit [s]."""
SMOKE = {"300 rows to 4": (300, 4, 0.05)}
BATCH, BATCH_LIMIT = 12, 8.0
"""Data sets in one call, and the multiple of one that they may take."""
TOGETHER = 6
"""Data sets that grow side by side in the call of twelve; one by one for comparison."""
ROUNDS = 3
DESCRIPTION = Path(__file__).resolve().parents[1] / "gengine1" / "gengine1.toml"


def problem(rows: int, seed: int):
    """Four variables, three of them scheduling, and a bent surface with noise."""
    import numpy as np

    rng = np.random.default_rng(seed)
    u = rng.uniform(size=(rows, 4))
    y = 1 / (0.1 + u[:, 0]) + (2 * u[:, 1]) ** 2 + np.sin(4 * u[:, 2]) * u[:, 3]
    return u, y + 0.05 * y.std() * rng.normal(size=rows)


def ours(rows: int, models: int, repeats: int, batch: bool) -> dict[str, Any]:
    """The kernel on one data set, on twelve, and the errors it ends with."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxnarx.partition._lolimot import lolimot

    jax.config.update("jax_enable_x64", True)
    sets = [problem(rows, seed) for seed in range(BATCH)]
    p = jnp.asarray(np.stack([np.vstack([np.ones(rows), u.T]) for u, _ in sets]))
    z = jnp.asarray(np.stack([u[:, :3].T for u, _ in sets]))
    y = jnp.asarray(np.stack([y for _, y in sets]))

    def grown(p, z, y):
        return lolimot(
            p,
            z,
            y,
            jnp.ones_like(y),
            k_sigma=jnp.asarray(1 / 3),
            ridge=jnp.asarray(0.0),
            least=jnp.asarray(5.0),
            max_models=models,
        )

    single = jax.jit(grown)
    begin = time.perf_counter()
    last = jax.block_until_ready(single(p[0], z[0], y[0]))
    compiled = time.perf_counter() - begin

    def once():
        return jax.block_until_ready(single(p[0], z[0], y[0]))

    found: dict[str, Any] = {
        "first_call_s": round(compiled, 3),
        "one": best_of(
            lambda: jax.block_until_ready(single(p[0], z[0], y[0])), repeats
        ),
        "models": int(last.count[-1]),
        "nrmse": float(jnp.sqrt(last.sse[-1] / jnp.sum((y[0] - y[0].mean()) ** 2))),
    }
    if batch:

        def many(size: int):
            program = jax.jit(
                lambda *a: jax.lax.map(lambda s: grown(*s), a, batch_size=size)
            )
            return lambda *a: jax.block_until_ready(program(*a))

        together, in_turn = many(TOGETHER), many(1)
        found["batch"] = best_of(lambda: together(p, z, y), repeats)
        found["batch_in_turn"] = best_of(lambda: in_turn(p, z, y), repeats)
        halves = [
            tuple(a[half] for a in (p, z, y))
            for half in (slice(BATCH // 2), slice(BATCH // 2, None))
        ]
        with ThreadPoolExecutor(2) as pool:
            found["batch_on_two_threads"] = best_of(
                lambda: list(pool.map(lambda a: in_turn(*a), halves)), repeats
            )
    return found


def linear_tree(rows: int, models: int, repeats: int) -> dict[str, Any]:
    """linear-tree on the same data, with the same variables to divide."""
    from sklearn.linear_model import (  # pyright: ignore[reportMissingImports]
        LinearRegression,
    )

    kind = importlib.import_module("lineartree").LinearTreeRegressor
    u, y = problem(rows, 0)
    most: dict[str, Any] = {"max_bins": 25, "min_samples_leaf": 6}

    def fit(depth: int):
        settings = most | {"max_depth": depth}
        tree = kind(LinearRegression(), split_features=[0, 1, 2], **settings)
        return tree.fit(u, y)

    # It knows a depth but no number of leaves.
    depth = math.ceil(math.log2(models))
    tree = fit(depth)
    error = float((((tree.predict(u) - y) ** 2).mean()) ** 0.5 / y.std())
    return {
        "one": best_of(lambda: fit(depth), repeats, warm_up=0),
        "leaves": _leaves(tree),
        "nrmse": error,
    }


def _leaves(tree: Any) -> int:
    return len(tree.summary(only_leaves=True))


def gengine1(small: bool) -> dict[str, Any]:
    """Growth by the verb on all training records: seconds and peak memory."""
    import jax

    import jaxnarx as jnx

    jax.config.update("jax_enable_x64", True)
    train = jnx.read_split(DESCRIPTION).train
    assert train is not None
    if small:
        train = train[[9, 19]]
    pool = jnx.polynomial_pool(
        train.channels,
        outputs=["NOx"],
        input_lags=(0, 1, 2, 4, 8, 16),
        output_lags=(1, 2),
        degree=1,
    )
    terms = jnx.select(pool, train, jnx.ForwardOLS(max_terms=16)).value
    found: dict[str, Any] = {"samples": sum(len(r) for r in train)}
    methods = {
        "LOLIMOT": jnx.Lolimot(["speed[t]", "load[t]"], max_models=8, criterion="none"),
        "sigmoid tree": jnx.SigmoidTree(
            ["speed[t]", "load[t]"], max_models=8, criterion="none"
        ),
    }
    for name, method in methods.items():
        begin = time.perf_counter()
        grown = jnx.grow(terms, train, method)
        found[name] = {
            "seconds_with_compilation": round(time.perf_counter() - begin, 2),
            "models": int(grown.value.models[0].active.sum()),
            "peak_mb": round(resident()[1] / 1e6),
        }
    return found


def versions() -> dict[str, str]:
    """Of the peer, where this interpreter has it."""
    found = importlib.util.find_spec("lineartree")
    return {"linear-tree": importlib.metadata.version("linear-tree")} if found else {}


WORKERS = {f.__name__: f for f in (ours, linear_tree, gengine1, versions)}


def call(name: str, *arguments: Any, python: str = sys.executable) -> Any:
    """A worker's answer, or None with its complaint on the terminal."""
    with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
        json.dump(arguments, file)
        file.flush()
        script = str(Path(__file__).resolve())
        answer, done = worker(script, "--worker", name, file.name, python=python)
    if answer is None:
        print(done.stderr[-600:], file=sys.stderr)
    return answer


def measure(cases: dict[str, Any], peers: str | None, smoke: bool) -> dict[str, Any]:
    """All figures; rounds of package and peer in turn."""
    rounds, repeats = (1, 2) if smoke else (ROUNDS, 10)
    table: dict[str, Any] = {}
    for title, (rows, models, limit) in cases.items():
        batch = rows <= 1500
        both: dict[str, list[Any]] = {"ours": [], "linear-tree": []}
        for _ in range(rounds):
            both["ours"].append(call("ours", rows, models, repeats, batch))
            if peers:
                both["linear-tree"].append(
                    call("linear_tree", rows, models, 1, python=peers)
                )
        table[title] = _row(both, limit, batch)
        print(title, json.dumps(table[title]), flush=True)
    found = call("gengine1", smoke)
    if found is not None:
        grown = found["LOLIMOT"]
        found["limits"] = {
            "seconds": target(grown["seconds_with_compilation"], 60.0),
            "peak_mb": target(grown["peak_mb"], 4000.0),
        }
    print("gengine1", json.dumps(found), flush=True)
    return {"growth": table, "gengine1": found}


def _row(both: dict[str, list[Any]], limit: float, batch: bool) -> dict[str, Any]:
    own = [r for r in both["ours"] if r]
    fastest = min(own, key=lambda r: r["one"]["best"])
    row: dict[str, Any] = {
        "ours": fastest,
        "limit_s": target(fastest["one"]["best"], limit),
    }
    if batch:
        for kind in ("batch", "batch_in_turn", "batch_on_two_threads"):
            ratio = min(r[kind]["best"] for r in own) / fastest["one"]["best"]
            row[f"{kind}_of_12_over_one"] = target(round(ratio, 2), BATCH_LIMIT)
    theirs = [r for r in both["linear-tree"] if r]
    if theirs:
        peer = min(theirs, key=lambda r: r["one"]["best"])
        row["linear-tree"] = peer
        row["times_faster"] = round(peer["one"]["best"] / fastest["one"]["best"], 1)
    return row


def main() -> None:
    """Measure and record."""
    parser = benchmark_parser(__doc__ or "", "small data, one round")
    options = parser.parse_args()
    if options.worker:
        name, path = options.worker
        print(json.dumps(WORKERS[name](*json.loads(Path(path).read_text()))))
        return
    found = call("versions", python=options.peers) if options.peers else {}
    cases = SMOKE if options.smoke else CASES
    figures = measure(cases, options.peers, options.smoke)
    folder = results_folder(options.results, smoke=options.smoke)
    record("growth", figures, folder=folder, versions=found, note=options.note)


if __name__ == "__main__":
    main()
