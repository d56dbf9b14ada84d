"""The verb `grow`: from chosen terms to a network of local models."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.arrays.least_squares import least_squares
from jaxnarx.data import Dataset, match_channels
from jaxnarx.errors import DataError
from jaxnarx.methods import Global, Lolimot
from jaxnarx.models import (
    Network,
    OutputModel,
    assemble,
    global_model,
    output_model,
)
from jaxnarx.partition.lolimot import Stage, gaussians, lolimot
from jaxnarx.partition.scaffold import chosen_terms, scheduling_table
from jaxnarx.regressors import Pool, Variables, evaluate, row_columns, variable_names
from jaxnarx.regressors.rows import Rows, regression_rows
from jaxnarx.selection import Selection
from jaxnarx.solution import RESULTS, Solution

_lolimot = jax.jit(lolimot, static_argnames="max_models")


def grow(
    source: Selection | Pool, data: Dataset, method: Global | Lolimot
) -> Solution[Network]:
    """Fit a network with the terms of `source` to one-step prediction of `data`.

    `Global()` is one local model by orthogonal least squares; `Lolimot(...)` divides
    the space of its scheduling variables until the corrected Akaike criterion
    deteriorates `patience` times in a row and returns the best stage (`stats["aicc"]`,
    `"sse"`, `"effective"` per output and stage). A pool stands for all its terms. Too
    few rows raise `DataError`; collinear terms give `unidentifiable`.
    """
    pool, factors = chosen_terms(source)
    data, _ = match_channels(data, pool.channels)
    scheduling = Variables(())
    if isinstance(method, Lolimot):
        scheduling = scheduling_table(pool, tuple(method.scheduling))
    rows = regression_rows(
        data,
        pool.variables,
        pool.outputs,
        history=max(pool.variables.longest, scheduling.longest),
        need=max(len(f) for f in factors) + 1,
        gain=source.gain if isinstance(source, Selection) else None,
    )
    if isinstance(method, Lolimot):
        return _grow_lolimot(pool, factors, data, rows, scheduling, method)
    return _grow_global(pool, factors, data, rows)


def _grow_global(pool: Pool, factors, data: Dataset, rows: Rows) -> Solution[Network]:
    models, ranks, conds = [], [], []
    for o, factor in enumerate(factors):
        columns = evaluate(factor, rows.v)
        theta, rank, cond = least_squares(columns, rows.y[o], rows.weight[o])
        models.append(global_model(factor, theta))
        ranks.append(int(rank))
        conds.append(float(cond))
    network = assemble(pool, data, rows.gain, models)
    stats = {"rank": np.array(ranks), "cond": np.array(conds)}
    short = [o for o, f in enumerate(factors) if ranks[o] < len(f)]
    if short:
        o = short[0]
        detail = (
            f"the terms of {network.output_names[o]} have rank {ranks[o]} of "
            f"{len(factors[o])}; remove collinear terms"
        )
        return Solution(network, RESULTS.unidentifiable, stats, detail)
    return Solution(network, RESULTS.ok, stats)


def _scheduling_range(pool, rows: Rows, scheduling: Variables, sample_time: float):
    """Scheduling variables of every row in physical units, their offset and span."""
    x = row_columns(rows.batch, rows.at, scheduling, sample_time)
    low, high = x.min(axis=1), x.max(axis=1)
    names = variable_names(pool.channels, scheduling)
    # a filter leaves rounding errors on a constant
    least = 100 * np.finfo(x.dtype).eps * np.maximum(np.abs(low), np.abs(high))
    constant = ~(high - low > least)
    for s, name, a, flat in zip(scheduling.signal, names, low, constant, strict=True):
        if flat:
            raise DataError(
                f"scheduling variable {name} is constant ({a:g}); choose one that "
                "moves",
                channel=pool.channels.names[s],
            )
    return jnp.asarray(x), low, high - low


def _grow_lolimot(
    pool: Pool, factors, data: Dataset, rows: Rows, scheduling, method: Lolimot
) -> Solution[Network]:
    x, offset, span = _scheduling_range(pool, rows, scheduling, data.sample_time)
    z = (x - offset[:, None]) / span[:, None]
    number = functools.partial(jnp.asarray, dtype=z.dtype)
    models, figures, statuses = [], [], []
    for o, factor in enumerate(factors):
        stages = _lolimot(
            evaluate(factor, rows.v),
            z,
            rows.y[o],
            rows.weight[o],
            k_sigma=number(method.k_sigma),
            max_models=method.max_models,
        )
        best, figure = _best_stage(stages, rows.weight[o], method)
        models.append(
            _stage_model(stages, best, factor, scheduling, offset, span, method)
        )
        figures.append(figure)
        statuses.append(figure["stopped"])
    network = assemble(pool, data, rows.gain, models)
    stats = {k: [f[k] for f in figures] for k in figures[0]}
    if any(s == "criterion" for s in statuses):
        return Solution(network, RESULTS.no_improvement, stats)
    return Solution(network, RESULTS.ok, stats)


def _best_stage(stages: Stage, weight, method: Lolimot) -> tuple[int, dict]:
    """Stage with the best AICc before `patience` successive deteriorations."""
    count = np.asarray(stages.count)
    distinct = int(np.sum(np.diff(count) > 0)) + 1
    n = np.asarray(stages.effective)[:distinct]
    sse = np.asarray(stages.sse)[:distinct]
    samples = float(np.sum(np.asarray(weight) > 0))
    spare = np.maximum(samples - n - 1, 1.0)
    tiny = np.finfo(sse.dtype).tiny
    aicc = samples * np.log(np.maximum(sse, tiny) / samples)
    aicc += 2 * n + 2 * n * (n + 1) / spare
    best, stopped = 0, "capacity"
    for stage in range(1, distinct):
        if aicc[stage] < aicc[best]:
            best = stage
        elif stage - best >= method.patience:
            stopped = "criterion"
            break
    if stopped == "capacity" and distinct < method.max_models:
        stopped = "data"
    return best, {
        "models": count[:distinct],
        "sse": sse,
        "aicc": aicc,
        "effective": n,
        "best": best,
        "stopped": stopped,
    }


def _stage_model(
    stages: Stage, best: int, factor, scheduling, offset, span, method: Lolimot
) -> OutputModel:
    count = int(stages.count[best])
    low, high = stages.low[best, :count], stages.high[best, :count]
    validity = gaussians(low, high, method.k_sigma)
    theta = stages.theta[best, :count]
    return output_model(factor, theta, validity, scheduling, offset, span)
