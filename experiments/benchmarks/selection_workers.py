"""What the selection benchmark measures, each function in a fresh process.

Every one goes from arrays to chosen terms in one call, imports excluded. Only the
standard library is imported here; the rest inside the functions.
"""

import functools
import importlib
import importlib.metadata
import importlib.util
import statistics
import time
from collections.abc import Callable
from typing import Any

from common import matmul_rate, resident
from selection_data import (
    INPUT_LAGS,
    INPUTS,
    OUTPUT_LAGS,
    TERMS,
    VARIABLES,
    arrays,
    lagged_variables,
    make_data,
    term,
    variable_names,
)

PEERS = {
    "SysIdentPy FROLS": ("frols", "sysidentpy", "candidate", True),
    "fastcan FastCan": ("fastcan", "fastcan", "first", True),
    "fastcan LazyFastCan": ("lazyfastcan", "fastcan", "first", False),
    "pysindy STLSQ": ("stlsq", "pysindy", None, True),
}
"""Worker, distribution, the constant's part in jaxnarx that matches (None: no order to
compare), dense pool."""


def timed(call: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    """The result of `call`, and its wall and processor time [s]."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = call()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return result, {"wall_s": float(f"{wall:.4g}"), "cpu_s": float(f"{cpu:.4g}")}


def memory(imports: int, peak: int, **stages: int) -> dict[str, float]:
    """Megabytes after the imports, and above them at every stage and at the peak."""
    above = {**stages, "above_imports": peak}
    return {"imports_mb": round(imports / 1e6, 1)} | {
        f"{key}_mb": round((now - imports) / 1e6, 1) for key, now in above.items()
    }


# The package -------------------------------------------------------------------------


def run_select(path: str, degree: int, repeats: int, constant: str) -> dict[str, Any]:
    """From the arrays at `path` through the public `select`: pool, rows and search."""
    import jax

    from jaxnarx import Dataset, ForwardOLS, polynomial_pool, select

    jax.config.update("jax_enable_x64", True)
    method = ForwardOLS(max_terms=TERMS, constant=constant)  # pyright: ignore
    imports, _ = resident()
    u, y = arrays(path)
    read, _ = resident()

    def call():
        data = Dataset.from_arrays(u, y, inputs=INPUTS, outputs=("y",), sample_time=1.0)
        pool = polynomial_pool(
            data.channels, input_lags=INPUT_LAGS, output_lags=OUTPUT_LAGS, degree=degree
        )
        return select(pool, data, method)

    solution, first = timed(call)
    _, peak = resident()
    later = [timed(call)[1] for _ in range(repeats)]
    pool = solution.value.pool
    names = pool.variable_names
    return {
        "candidates": len(pool),
        "status": solution.status_name,
        "chosen": [
            term(names[f - 1] for f in pool.factor[t] if f)
            for t in solution.value.terms(0)
        ],
        "first_call": first,
        "compiled": {
            key: statistics.median(times[key] for times in later) for key in first
        },
        "best_wall_s": min(times["wall_s"] for times in later),
        "repeats": repeats,
        "memory": memory(imports, peak, after_data=read),
    }


def nominal_operations(samples: int, degree: int) -> float:
    """Floating-point operations of one plain pass over the pool with one vector."""
    ones = VARIABLES + 1
    left = ones if degree <= 2 else ones * (ones + 1) // 2
    return 2.0 * left * ones * samples


def run_contract(
    samples: int, degree: int, repeats: int, matrix: int, vectors: int = 16
) -> dict[str, Any]:
    """One bare pass over the pool: with the saving by symmetry, plain, many vectors.

    The passes and the machine's matrix products take turns, so that their ratios hold
    on a machine whose speed changes.
    """
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxnarx.arrays.contraction import contract, plan

    jax.config.update("jax_enable_x64", True)
    rng = np.random.default_rng(0)
    x = rng.standard_normal((VARIABLES, samples))
    v = jnp.asarray(np.concatenate([np.ones((1, samples)), x]))
    q = jnp.asarray(rng.standard_normal((vectors, samples)))
    sorted_rows = jax.jit(functools.partial(contract, degree=degree))
    calls = {
        "symmetric": functools.partial(sorted_rows, v, q[:1]),
        "plain": functools.partial(jax.jit(plain_pass(degree)), v, q[:1]),
        "vectors": functools.partial(sorted_rows, v, q),
    }
    for call in calls.values():
        jax.block_until_ready(call())
    rounds: list[dict[str, float]] = []
    for _ in range(repeats):
        rates = matmul_rate(matrix)
        times = {
            name: timed(lambda call=call: jax.block_until_ready(call()))[1]["wall_s"]
            for name, call in calls.items()
        }
        rounds.append(times | {f"rate_{key}": value for key, value in rates.items()})
    middle = {key: statistics.median(r[key] for r in rounds) for key in rounds[0]}
    nominal = nominal_operations(samples, degree) / 1e9
    rate = max(middle["rate_jax"], middle["rate_numpy"])
    tables = plan(VARIABLES + 1, degree)
    compiled = sorted_rows.lower(v, q[:1]).compile().memory_analysis()
    return {
        "pass_s": float(f"{middle['symmetric']:.4g}"),
        "matrix_product_gflops": {k: middle[f"rate_{k}"] for k in ("jax", "numpy")},
        "nominal_gflops": round(nominal / middle["symmetric"], 1),
        "share": round(nominal / middle["symmetric"] / rate, 3),
        "computed": round(2e-9 * samples * float(tables.offsets[-1]) / nominal, 3),
        "plain_pass_s": float(f"{middle['plain']:.4g}"),
        "gain_of_symmetry": round(middle["plain"] / middle["symmetric"], 2),
        "vectors": vectors,
        "share_with_vectors": round(nominal * vectors / middle["vectors"] / rate, 3),
        "temporary_mb": compiled and round(compiled.temp_size_in_bytes / 1e6, 1),
    }


def plain_pass(degree: int):
    """All pairs on the left (degree 3), all variables on the right: no symmetry used.

    Blocks and their fetching are those of `contract`; the last, shorter block is left
    out, which only flatters the plain pass.
    """
    import jax
    import jax.numpy as jnp

    from jaxnarx.arrays.contraction import BLOCK_SAMPLES

    def contract_plainly(v, q):
        def fetch(n):
            return [
                jax.lax.dynamic_slice_in_dim(
                    x, n * BLOCK_SAMPLES, BLOCK_SAMPLES, axis=1
                )
                for x in (v, q)
            ]

        def left(vb):
            if degree <= 2:
                return vb
            return jnp.concatenate([vb[: j + 1] * vb[j, None] for j in range(len(vb))])

        def body(carry, n):
            total, vb, qb = carry
            right = jnp.pad(vb * qb, ((0, -len(vb) % 16), (0, 0)))
            return (total + left(vb) @ right.T, *fetch(n + 1)), None

        rows = len(v) if degree <= 2 else len(v) * (len(v) + 1) // 2
        total = jnp.zeros((rows, len(v) + -len(v) % 16), v.dtype)
        blocks = jnp.arange(v.shape[1] // BLOCK_SAMPLES)
        return jax.lax.scan(body, (total, *fetch(0)), blocks)[0][0]

    return contract_plainly


# Peers -------------------------------------------------------------------------------


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


def _peer(path: str, search: Callable[..., list[str]]) -> dict[str, Any]:
    """One timed call of a peer, everything it needs imported before."""
    u, y = arrays(path)
    imports, _ = resident()
    chosen, times = timed(lambda: search(u, y))
    _, peak = resident()
    return times | {"memory": memory(imports, peak), "chosen": chosen}


def run_frols(path: str, degree: int) -> dict[str, Any]:
    """SysIdentPy's forward selection by ERR; the constant is one candidate of many."""
    structure = importlib.import_module("sysidentpy.model_structure_selection")
    basis = importlib.import_module("sysidentpy.basis_function")
    estimation = importlib.import_module("sysidentpy.parameter_estimation")
    names = ("y", *INPUTS)

    def search(u, y):
        model = structure.FROLS(
            basis_function=basis.Polynomial(degree=degree),
            ylag=list(OUTPUT_LAGS),
            xlag=[list(INPUT_LAGS)] * len(INPUTS),
            order_selection=False,
            n_terms=TERMS,
            estimator=estimation.LeastSquares(),
        ).fit(X=u, y=y)
        return [
            term(f"{names[c // 1000 - 1]}[t-{c % 1000}]" for c in row if c)
            for row in model.final_model.astype(int).tolist()
        ]

    return _peer(path, search)


def _lagged(u, y):
    """Lagged variables and targets of all samples with full history."""
    import numpy as np

    signals = np.concatenate([u, y], axis=1)
    longest = max(INPUT_LAGS + OUTPUT_LAGS)
    columns = [signals[longest - d : len(y) - d, i] for i, d in lagged_variables()]
    return np.stack(columns, axis=1), y[longest:]


def run_fastcan(path: str, degree: int, lazy: bool = False) -> dict[str, Any]:
    """fastcan's greedy search; it centres, which is a constant chosen first."""
    import numpy as np

    fastcan = importlib.import_module("fastcan")
    narx = importlib.import_module("fastcan.narx")
    names = variable_names()

    def search(u, y):
        lagged, target = _lagged(u, y)
        ids = narx.make_poly_ids(len(names), degree)
        if lazy:
            terms = functools.partial(narx.gen_poly_features, ids=ids)
            found = fastcan.LazyFastCan(TERMS - 1, feature_generator=terms)
            found.fit(lagged, target)
        else:
            columns = narx.make_poly_features(lagged, ids)
            found = fastcan.FastCan(TERMS - 1, verbose=0).fit(columns, target)
        rows = np.asarray(ids)[np.asarray(found.indices_)].tolist()
        return ["1"] + [term(names[f] for f in row if f >= 0) for row in rows]

    return _peer(path, search)


def run_lazyfastcan(path: str, degree: int) -> dict[str, Any]:
    """fastcan's search that makes one column at a time and stores none."""
    return run_fastcan(path, degree, lazy=True)


def run_stlsq(path: str, degree: int) -> dict[str, Any]:
    """pysindy's library and sparse regression, the output on the lagged variables.

    Sequentially thresholded least squares has no number of terms and no order: it drops
    coefficients below 0.1 until none is left to drop. Its time counts; which terms it
    keeps is recorded, not compared.
    """
    import numpy as np

    pysindy = importlib.import_module("pysindy")
    names = variable_names()

    def search(u, y):
        lagged, target = _lagged(u, y)
        library = pysindy.PolynomialLibrary(degree=degree)
        columns = np.asarray(library.fit_transform(lagged))
        fitted = pysindy.STLSQ(threshold=0.1).fit(columns, target)
        powers = np.asarray(library.powers_)[np.flatnonzero(fitted.coef_[0])]
        return [
            term(names[f] for f in np.flatnonzero(row) for _ in range(row[f]))
            for row in powers
        ]

    return _peer(path, search)


WORKERS: dict[str, Callable[..., dict[str, Any]]] = {
    "data": make_data,
    "select": run_select,
    "contract": run_contract,
    "installed": installed,
    "frols": run_frols,
    "fastcan": run_fastcan,
    "lazyfastcan": run_lazyfastcan,
    "stlsq": run_stlsq,
}
