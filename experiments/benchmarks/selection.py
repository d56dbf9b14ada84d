"""Time, memory and matrix product rate of term selection, and peers on the same data.

100,000 samples, 41 lagged variables, degree 3: 13,244 terms, 15 of them chosen. A dense
pool would take 10.6 GB. With `--peers` the same choice by SysIdentPy (FROLS) and
fastcan at 10,000 samples, in the same run and on the same numbers.

    python experiments/benchmarks/selection.py
    python experiments/benchmarks/selection.py --peers path/to/venv/bin/python
"""

import argparse
import dataclasses
import importlib
import importlib.metadata
import importlib.util
import json
import math
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from common import (
    available_memory,
    best_of,
    child,
    matmul_rate,
    record,
    resident,
    results_folder,
    target,
    worker,
)

SEED = 1
TERMS = 15
INPUTS = ("u1", "u2", "u3")
INPUT_LAGS = tuple(range(1, 14))
OUTPUT_LAGS = (1, 2)
VARIABLES = len(INPUTS) * len(INPUT_LAGS) + len(OUTPUT_LAGS)
SECONDS, MEGABYTES = 6.0, 500.0
"""Targets: wall time of one choice, memory above the imports."""

PEER_LIMIT = 900.0
"""Seconds after which a peer is stopped."""

COPIES = 6
"""Sizes of the pool that must be free before a dense peer is started."""


@dataclasses.dataclass(frozen=True)
class Sizes:
    """How large everything is."""

    samples: int = 100_000
    degree: int = 3
    peer_samples: int = 10_000
    peer_degrees: tuple[int, ...] = (2, 3)
    repeats: int = 3
    matrix: int = 2048


SMOKE = Sizes(1_500, 2, 1_000, (2,), 1, 256)


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description="Benchmark of term selection.")
    parser.add_argument("--smoke", action="store_true", help="small, in seconds")
    parser.add_argument(
        "--peers",
        nargs="?",
        const=sys.executable,
        metavar="PYTHON",
        help="compare with the peers this interpreter has (default: the own one)",
    )
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--note", default="", help="a remark kept with the figures")
    parser.add_argument("--worker", nargs=2, metavar=("NAME", "JSON"))
    chosen = parser.parse_args()
    if chosen.worker:
        name, options = chosen.worker
        print(json.dumps(WORKERS[name](**json.loads(options))))
        return
    sizes = SMOKE if chosen.smoke else Sizes()
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    with tempfile.TemporaryDirectory() as temporary:
        data = Path(temporary) / "data.npz"
        figures = measure(sizes, data)
        print(record("selection", figures, folder=folder, note=chosen.note))
        _show_own(figures)
        if chosen.peers:
            data = Path(temporary) / "peers.npz"
            figures, versions = compare(sizes, data, chosen.peers)
            path = record(
                "selection_peers",
                figures,
                folder=folder,
                versions=versions,
                note=chosen.note,
            )
            print(path)
            _show_peers(figures)


def _run(name: str, **options: Any) -> dict[str, Any]:
    result, done = worker(__file__, "--worker", name, json.dumps(options))
    if result is None:
        raise SystemExit(f"the worker {name!r} failed:\n{done.stderr}")
    return result


# The package -------------------------------------------------------------------------


def measure(sizes: Sizes, data: Path) -> dict[str, Any]:
    """`select`, and its kernel alone, each in a fresh process."""
    made = _run("data", path=str(data), samples=sizes.samples)
    common = {"path": str(data), "degree": sizes.degree, "repeats": sizes.repeats}
    runs = {
        "select": _run("select", **common, matrix=sizes.matrix),
        "kernel": _run("kernel", **common, matrix=sizes.matrix),
    }
    select = runs["select"]
    return {
        "samples": sizes.samples,
        "variables": VARIABLES,
        "degree": sizes.degree,
        "candidates": select["candidates"],
        "terms": TERMS,
        "dense_pool_gb": round(8e-9 * sizes.samples * select["candidates"], 2),
        "data_generation_s": made["seconds"],
        "rate_note": (
            "nominal operations are those of the plain product, 2 * left rows * right "
            "variables * samples in each of terms + 1 passes; the package computes the "
            "part `computed` of them, so a share above 1 is possible"
        ),
        "memory_note": (
            "peak of the process during the first call, compilation included, less its "
            "memory after the imports; reading the data is in it and stated by itself, "
            "generating the data happens in another process"
        ),
        **runs,
        "targets": {
            "first_call_s": target(select["first_call_s"], SECONDS),
            "compiled_s": target(select["compiled_s"]["best"], SECONDS),
            "memory_above_imports_mb": target(
                select["memory"]["above_imports_mb"], MEGABYTES
            ),
        },
    }


def nominal_operations(samples: int, degree: int) -> float:
    """Floating-point operations of `TERMS` + 1 plain passes over the pool."""
    ones = VARIABLES + 1
    left = ones if degree <= 2 else ones * (ones + 1) // 2
    return 2.0 * left * ones * samples * (TERMS + 1)


def make_data(path: str, samples: int) -> dict[str, Any]:
    """White inputs through a NARX process of 15 terms with noise, into an npz file."""
    import numpy as np

    begin = time.perf_counter()
    rng = np.random.default_rng(SEED)
    u = rng.uniform(-1.0, 1.0, (samples, len(INPUTS)))
    noise = 0.02 * rng.standard_normal(samples)

    def lag(channel: int, d: int):
        return np.concatenate([np.zeros(d), u[: samples - d, channel]])

    free = (
        0.3
        + 0.9 * lag(0, 1)
        - 0.7 * lag(1, 2)
        + 0.6 * lag(2, 5)
        + 0.5 * lag(0, 3) * lag(1, 1)
        - 0.45 * lag(2, 2) ** 2
        + 0.4 * lag(1, 7) * lag(2, 1)
        + 0.35 * lag(0, 2) ** 2 * lag(2, 3)
        - 0.3 * lag(1, 4) ** 3
        + 0.28 * lag(0, 9) * lag(1, 6) * lag(2, 8)
        + 0.2 * lag(2, 12)
        + noise
    ).tolist()
    by_first = (0.45 + 0.2 * lag(0, 4)).tolist()
    by_second = (-0.15 + 0.1 * lag(2, 6)).tolist()
    y, one, two = [], 0.0, 0.0
    for constant, first, second in zip(free, by_first, by_second, strict=True):
        one, two = constant + first * one + second * two, one
        y.append(one)
    np.savez(path, u=u, y=np.array(y)[:, None])
    return {"seconds": round(time.perf_counter() - begin, 3)}


def _arrays(path: str):
    import numpy as np

    with np.load(path) as saved:
        return saved["u"], saved["y"]


def _dataset(u, y):
    from jaxnarx import Dataset

    return Dataset.from_arrays(u, y, inputs=INPUTS, outputs=("y",), sample_time=1.0)


def _pool(data, degree: int):
    from jaxnarx import polynomial_pool

    return polynomial_pool(
        data.channels, input_lags=INPUT_LAGS, output_lags=OUTPUT_LAGS, degree=degree
    )


def run_select(
    path: str,
    degree: int,
    repeats: int,
    matrix: int | None = None,
    constant: str = "first",
) -> dict[str, Any]:
    """From the arrays at `path` through the public `select`, in this process."""
    import jax

    import jaxnarx
    from jaxnarx import ForwardOLS, select

    jax.config.update("jax_enable_x64", True)
    method = ForwardOLS(max_terms=TERMS, constant=constant)  # pyright: ignore
    assert jaxnarx.Dataset and jaxnarx.polynomial_pool, "everything is imported now"
    imports, _ = resident()
    u, y = _arrays(path)
    read, _ = resident()

    def call():
        data = _dataset(u, y)
        return select(_pool(data, degree), data, method)

    begin = time.perf_counter()
    solution = call()
    first = time.perf_counter() - begin
    _, peak = resident()
    compiled = best_of(call, repeats, warm_up=0)
    result = {
        "candidates": len(solution.value.pool),
        "status": solution.status_name,
        "chosen": _names(solution.value.pool, solution.value.terms(0)),
        "first_call_s": round(first, 3),
        "compiled_s": compiled,
        "memory": _memory(imports, peak, after_data=read),
    }
    if matrix is not None:
        result["rate"] = _rate(len(y), degree, compiled["best"], matrix)
    return result


def run_kernel(path: str, degree: int, repeats: int, matrix: int) -> dict[str, Any]:
    """The search alone, on rows that are made beforehand."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxnarx.arrays.contraction import positions
    from jaxnarx.regressors.rows import regression_rows
    from jaxnarx.selection.forward_ols import forward_ols

    jax.config.update("jax_enable_x64", True)
    imports, _ = resident()
    data = _dataset(*_arrays(path))
    pool = _pool(data, degree)
    longest = pool.variables.longest
    rows = regression_rows(data, pool.variables, pool.outputs, history=longest)
    jax.block_until_ready(rows.v)
    prepared, _ = resident()
    search = jax.jit(forward_ols, static_argnames="max_terms")
    at = positions(pool.factor, len(pool.variables) + 1)
    constant = np.flatnonzero(~pool.factor.any(axis=1)).astype(np.int32)

    def call():
        return jax.block_until_ready(
            search(
                rows.v,
                rows.y,
                rows.weight,
                pool.factor,
                at,
                np.ones(len(pool), bool),
                constant,
                max_terms=TERMS,
                rho=jnp.asarray(0.0),
                tau=jnp.asarray(1e-10),
                tau_absolute=jnp.asarray(0.0),
            )
        )

    begin = time.perf_counter()
    path_found = call()
    first = time.perf_counter() - begin
    _, peak = resident()
    compiled = best_of(call, repeats, warm_up=0)
    return {
        "chosen": _names(pool, np.asarray(path_found.index)[0]),
        "first_call_s": round(first, 3),
        "compiled_s": compiled,
        "memory": _memory(imports, peak, after_rows=prepared),
        "rate": _rate(data.samples, degree, compiled["best"], matrix),
    }


def _names(pool, terms) -> list[str]:
    """Terms in a form that is comparable between tools."""
    names = pool.variable_names
    return [_term(names[f - 1] for f in pool.factor[t] if f) for t in terms]


def _term(variables: Iterable[str]) -> str:
    return "*".join(sorted(variables)) or "1"


def _memory(imports: int, peak: int, **stages: int) -> dict[str, float]:
    """Megabytes after the imports, and above them at every stage and at the peak."""
    above = {**stages, "above_imports": peak}
    return {"imports_mb": round(imports / 1e6, 1)} | {
        f"{key}_mb": round((now - imports) / 1e6, 1) for key, now in above.items()
    }


def _rate(samples: int, degree: int, seconds: float, matrix: int) -> dict[str, Any]:
    from jaxnarx.arrays.contraction import plan

    reached = nominal_operations(samples, degree) / seconds / 1e9
    machine = matmul_rate(matrix)
    tables = plan(VARIABLES + 1, degree)
    computed = tables.offsets[-1] / (len(tables.left) * len(tables.right))
    return {
        "nominal_gflops": round(reached, 1),
        "computed": round(float(computed), 3),
        "matrix_product_gflops": machine,
        "share": {key: round(reached / value, 3) for key, value in machine.items()},
    }


# Peers -------------------------------------------------------------------------------


PEERS = {
    "SysIdentPy FROLS": ("frols", "sysidentpy", "candidate", True),
    "fastcan FastCan": ("fastcan", "fastcan", "first", True),
    "fastcan LazyFastCan": ("lazyfastcan", "fastcan", "first", False),
}
"""Worker, distribution, the constant's part in jaxnarx that matches, dense pool."""


def compare(
    sizes: Sizes, data: Path, python: str
) -> tuple[dict[str, Any], dict[str, str]]:
    """Every peer that `python` has, against `select` with the matching constant."""
    versions = _installed(python)
    figures: dict[str, Any] = {"samples": sizes.peer_samples, "terms": TERMS}
    figures["scope"] = (
        "from arrays to ordered terms, imports excluded; ratios are the peer's one "
        "call over the first call of jaxnarx, which compiles, and over the median of "
        "those after it"
    )
    if not versions:
        return figures | {"skipped": "no peer is installed"}, {}
    _run("data", path=str(data), samples=sizes.peer_samples)
    for degree in sizes.peer_degrees:
        own = {
            constant: _run(
                "select",
                path=str(data),
                degree=degree,
                repeats=sizes.repeats,
                constant=constant,
            )
            for constant in ("first", "candidate")
        }
        figures[f"degree {degree}"] = {
            "candidates": own["first"]["candidates"],
            "jaxnarx": own,
            **{
                name: _peer(name, sizes, data, degree, python, versions, own)
                for name in PEERS
            },
        }
    return figures, versions


def _installed(python: str) -> dict[str, str]:
    done = child([python, __file__, "--worker", "installed", "{}"])
    return json.loads(done.stdout) if done.code == 0 else {}


def _peer(name, sizes, data, degree, python, versions, own) -> dict[str, Any]:
    key, package, constant, dense = PEERS[name]
    if package not in versions:
        return {"skipped": f"{package} is not installed"}
    terms = math.comb(VARIABLES + degree, degree)
    need = 8 * COPIES * terms * sizes.peer_samples
    if dense and need > available_memory():
        return {"skipped": f"needs about {need / 1e9:.1f} GB of free memory"}
    options = json.dumps({"path": str(data), "degree": degree})
    arguments = ["--worker", key, options]
    result, done = worker(__file__, *arguments, python=python, limit=PEER_LIMIT)
    if result is None:
        if done.wall >= PEER_LIMIT:
            return {"skipped": f"stopped after {PEER_LIMIT:g} s"}
        return {"failed": (done.stderr.strip().splitlines() or ["no message"])[-1]}
    mine = own[constant]
    equal = [a == b for a, b in zip(result["chosen"], mine["chosen"], strict=False)]
    return result | {
        "constant": constant,
        "ratio_to_first_call": round(result["wall_s"] / mine["first_call_s"], 2),
        "ratio_to_compiled": round(result["wall_s"] / mine["compiled_s"]["median"], 2),
        "same_ordered_terms": result["chosen"] == mine["chosen"],
        "equal_up_to": equal.index(False) if False in equal else len(equal),
    }


def installed() -> dict[str, str]:
    """Versions of the peers this interpreter has, and of their numpy."""
    packages = sorted({package for _, package, *_ in PEERS.values()})
    found = {
        p: importlib.metadata.version(p)
        for p in packages
        if importlib.util.find_spec(p) is not None
    }
    if found:
        found["numpy of the peers"] = importlib.metadata.version("numpy")
    return found


def _peer_result(wall: float, imports: int, chosen: list[str]) -> dict[str, Any]:
    _, peak = resident()
    memory = _memory(imports, peak)
    return {"wall_s": round(wall, 3), "memory": memory, "chosen": chosen}


def run_frols(path: str, degree: int) -> dict[str, Any]:
    """SysIdentPy's forward selection by ERR; the constant is one candidate of many."""
    structure = importlib.import_module("sysidentpy.model_structure_selection")
    basis = importlib.import_module("sysidentpy.basis_function")
    estimation = importlib.import_module("sysidentpy.parameter_estimation")
    u, y = _arrays(path)
    imports, _ = resident()
    begin = time.perf_counter()
    model = structure.FROLS(
        basis_function=basis.Polynomial(degree=degree),
        ylag=list(OUTPUT_LAGS),
        xlag=[list(INPUT_LAGS)] * len(INPUTS),
        order_selection=False,
        n_terms=TERMS,
        estimator=estimation.LeastSquares(),
    ).fit(X=u, y=y)
    wall = time.perf_counter() - begin
    names = ("y", *INPUTS)
    chosen = [
        _term(f"{names[c // 1000 - 1]}[t-{c % 1000}]" for c in row if c)
        for row in model.final_model.astype(int).tolist()
    ]
    return _peer_result(wall, imports, chosen)


def run_fastcan(path: str, degree: int, lazy: bool = False) -> dict[str, Any]:
    """fastcan's greedy search; it centres, which is a constant chosen first."""
    import functools

    import numpy as np

    fastcan = importlib.import_module("fastcan")
    narx = importlib.import_module("fastcan.narx")
    signals = np.concatenate(_arrays(path), axis=1)
    imports, _ = resident()
    begin = time.perf_counter()
    lags = [(i, d) for i in range(len(INPUTS)) for d in INPUT_LAGS]
    lags += [(len(INPUTS), d) for d in OUTPUT_LAGS]
    longest = max(INPUT_LAGS + OUTPUT_LAGS)
    lagged = narx.make_time_shift_features(signals, np.array(lags))[longest:]
    target_column = signals[longest:, -1:]
    ids = narx.make_poly_ids(len(lags), degree)
    if lazy:
        terms = functools.partial(narx.gen_poly_features, ids=ids)
        search = fastcan.LazyFastCan(TERMS - 1, feature_generator=terms)
        search.fit(lagged, target_column)
    else:
        columns = narx.make_poly_features(lagged, ids)
        search = fastcan.FastCan(TERMS - 1, verbose=0).fit(columns, target_column)
    wall = time.perf_counter() - begin
    names = [f"{(*INPUTS, 'y')[i]}[t-{d}]" for i, d in lags]
    rows = np.asarray(ids)[np.asarray(search.indices_)].tolist()
    chosen = ["1"] + [_term(names[f] for f in row if f >= 0) for row in rows]
    return _peer_result(wall, imports, chosen)


def run_lazyfastcan(path: str, degree: int) -> dict[str, Any]:
    """fastcan's search that makes one column at a time and stores none."""
    return run_fastcan(path, degree, lazy=True)


WORKERS = {
    "data": make_data,
    "select": run_select,
    "kernel": run_kernel,
    "installed": installed,
    "frols": run_frols,
    "fastcan": run_fastcan,
    "lazyfastcan": run_lazyfastcan,
}


# Tables ------------------------------------------------------------------------------


def _show_own(figures: dict[str, Any]) -> None:
    print(f"{TERMS} of {figures['candidates']} terms, {figures['samples']} samples")
    print(f"{'':8s}{'first [s]':>10s}{'then [s]':>10s}{'MB':>8s}{'share':>8s}")
    for name in ("select", "kernel"):
        run = figures[name]
        print(
            f"{name:8s}{run['first_call_s']:10.2f}{run['compiled_s']['best']:10.3f}"
            f"{run['memory']['above_imports_mb']:8.0f}{run['rate']['share']['jax']:8.2f}"
        )


def _show_peers(figures: dict[str, Any]) -> None:
    if "skipped" in figures:
        print(figures["skipped"])
    for key, part in figures.items():
        if not key.startswith("degree"):
            continue
        print(f"{key}: {part['candidates']} terms, {figures['samples']} samples")
        for name in PEERS:
            run = part[name]
            if "wall_s" not in run:
                print(f"  {name:20s} {run.get('skipped') or run.get('failed')}")
                continue
            print(
                f"  {name:20s}{run['wall_s']:9.2f} s{run['ratio_to_compiled']:9.1f} x  "
                f"{'same terms' if run['same_ordered_terms'] else 'other terms'}"
            )


if __name__ == "__main__":
    main()
