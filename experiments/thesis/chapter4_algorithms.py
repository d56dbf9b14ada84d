"""One regression by four algorithms and three scalings (thesis 4.1 and 4.2.3)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from chapter4_models import START, merit, narx_pool

import jaxnarx as jnx
from jaxnarx.linear.regression import Regression, least_squares
from jaxnarx.models import assemble, global_model
from jaxnarx.regressors import Pool, evaluate
from jaxnarx.regressors.rows import regression_rows
from jaxnarx.settings.least_squares import LeastSquares

ALGORITHMS = ("normal", "qr", "svd", "recursive")
SCALINGS = ("norm", "mean", "none")
REFERENCE = ("qr", "norm")
UNCUT = "none, no cut-off"
"""Columns as they are, and no direction left out; for the normal equations."""
LIMIT = 0.5
"""Mismatch of the simulated outputs in the thesis [%]."""

Ways = dict[tuple[str, str], Regression]
Runs = dict[tuple[str, str], np.ndarray]


def regression(
    pool: Pool, data: jnx.Dataset
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Columns (time, terms) and speed of the first record, in physical units."""
    one = np.ones(len(data.channels.all))
    rows = regression_rows(
        data[:1],
        pool.variables,
        pool.outputs,
        history=pool.variables.longest,
        gain=one,
    )
    columns = np.asarray(evaluate(pool.factor, rows.v)).T
    return columns, np.asarray(rows.y)[0], tuple(pool.names)


def free_run(pool: Pool, data: jnx.Dataset, theta: np.ndarray) -> np.ndarray:
    """Speed [rpm] of the validation record with these coefficients."""
    one = np.ones(len(data.channels.all))
    network = assemble(pool, data[:1], one, [global_model(pool.factor, theta)])
    return np.asarray(jnx.simulate(network, data[1:2]).value.outputs[0])[:, 0]


def by_all_ways(pool: Pool, data: jnx.Dataset) -> tuple[Ways, Runs]:
    """Every algorithm with every scaling, and what it simulates."""
    columns, y, names = regression(pool, data)
    methods = {(a, s): LeastSquares(a, s) for a in ALGORITHMS for s in SCALINGS}
    methods["normal", UNCUT] = LeastSquares("normal", "none", cutoff=0.0)
    ways = {
        way: least_squares(columns, y, method, names=names).value
        for way, method in methods.items()
    }
    runs = {way: free_run(pool, data, r.coefficient) for way, r in ways.items()}
    return ways, runs


def way_rows(ways: Ways, runs: Runs, speed: np.ndarray) -> list[dict[str, Any]]:
    """Distances from QR on columns of norm one.

    `coefficient` is the largest relative one; `errors` the largest in standard errors;
    `mismatch_percent` that of the free runs, in per cent of the range of the speed.
    """
    reference, run = ways[REFERENCE], runs[REFERENCE]
    theta, error = reference.coefficient, reference.standard_error
    return [
        {
            "algorithm": way[0],
            "scaling": way[1],
            "rank": r.rank,
            "condition": r.condition if np.isfinite(r.condition) else None,
            "coefficient": float(np.max(np.abs(r.coefficient / theta - 1))),
            "errors": float(np.max(np.abs(r.coefficient - theta) / error)),
            "mismatch_percent": mismatch(runs[way], run, speed),
            "free_run_fit": merit(speed, runs[way])["fit"],
        }
        for way, r in ways.items()
    ]


def mismatch(run: np.ndarray, other: np.ndarray, speed: np.ndarray) -> float:
    """Largest distance of two runs in per cent of the range of the measured speed."""
    gap = np.abs(run - other)[START:]
    return float(100 * gap.max() / np.ptp(speed[START:]))


def algorithms(
    data: jnx.Dataset, pools: Mapping[str, Pool]
) -> dict[str, dict[str, Any]]:
    """Rows of every structure, and the free runs for the figure."""
    speed = data.records[1].y[:, 0]
    found = {}
    for name, pool in pools.items():
        ways, runs = by_all_ways(pool, data)
        found[name] = {"rows": way_rows(ways, runs, speed), "runs": runs}
    return found


def one_by_one(data: jnx.Dataset, *, most: int = 6) -> list[dict[str, Any]]:
    """Squares of the speed added one at a time (4.2.3), nearest lag first."""
    pool = narx_pool(data.channels)
    columns, y, names = regression(pool, data)
    squares = [n for n, (low, _) in enumerate(pool.factor.tolist()) if low > 0]
    speed, rows = data.records[1].y[:, 0], []
    for count in range(most + 1):
        left_out = squares[count:]
        used = [n for n in range(len(pool)) if n not in left_out]
        found = least_squares(columns[:, used], y, LeastSquares(*REFERENCE)).value
        theta = np.zeros(len(pool))
        theta[used] = found.coefficient
        run = free_run(pool, data, theta)
        rows.append(
            {
                "added": names[squares[count - 1]] if count else "-",
                "condition": found.condition,
                "sigma": found.sigma,
                "free_run_fit": merit(speed, run)["fit"],
            }
        )
    return rows
