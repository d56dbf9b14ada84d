"""The verb `select`: checks, the search, and what it found as a value."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.arrays.contraction import positions
from jaxnarx.arrays.least_squares import least_squares
from jaxnarx.data import Dataset, match_channels
from jaxnarx.errors import DataError, SpecError
from jaxnarx.methods import ForwardOLS
from jaxnarx.regressors import Pool, evaluate
from jaxnarx.regressors.rows import Rows, regression_rows
from jaxnarx.selection.criteria import criteria
from jaxnarx.selection.forward_ols import Path, forward_ols
from jaxnarx.selection.selection import Selection
from jaxnarx.solution import RESULTS, Solution

_search = jax.jit(forward_ols, static_argnames="max_terms")


def _stacked(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    columns = np.concatenate([np.concatenate([r.u, r.y], axis=1) for r in data])
    return columns, np.concatenate([r.valid for r in data])


def unusable_signals(data: Dataset, pool: Pool) -> dict[str, str]:
    """Signals of the pool whose terms are passed over, with the reason.

    Constant inputs, and channels equal to or a multiple of an earlier one. A modelled
    output that is constant raises `DataError`, and so does a pool without any excited
    input.
    """
    columns, valid = _stacked(data)
    names = data.channels.names
    inputs = len(data.channels.inputs)
    signals = sorted({s for s, _ in pool.variables})
    reasons: dict[str, str] = {}
    unit: dict[int, np.ndarray] = {}
    for s in sorted({*signals, *(inputs + o for o in pool.outputs)}):
        x = columns[valid[:, s], s]
        peak = np.max(np.abs(x), initial=0.0)
        if x.size == 0 or np.ptp(x) <= 1e-12 * peak:
            if s >= inputs:
                raise DataError(
                    f"output {names[s]!r} is constant over all records; there is "
                    "nothing to identify. Choose another output or other records",
                    channel=names[s],
                )
            reasons[names[s]] = "constant"
            continue
        scaled = columns[:, s] / peak
        for other, reference in unit.items():
            both = valid[:, s] & valid[:, other]
            if _proportional(scaled[both], reference[both]):
                reasons[names[s]] = f"the same as {names[other]}"
                break
        else:
            unit[s] = scaled
    if any(s < inputs for s in signals) and not any(s < inputs for s in unit):
        raise DataError(
            "every input is constant, so nothing excites the engine: "
            + ", ".join(n for n, r in reasons.items() if r == "constant"),
            channel=next(iter(reasons), None),
        )
    return reasons


def _proportional(a: np.ndarray, b: np.ndarray) -> bool:
    """True where a = c b but for rounding, that of a text file included."""
    if not a.size:
        return False
    ratio = float(np.vdot(a, b)) / float(np.vdot(b, b))
    rms = float(np.sqrt(np.mean(a**2)))
    return bool(np.max(np.abs(a - ratio * b)) <= 1e-4 * rms)


def _candidates(pool: Pool, passed_over: dict[str, str]) -> Bool[np.ndarray, " terms"]:
    names = pool.channels.names
    bad = [v + 1 for v, (s, _) in enumerate(pool.variables) if names[s] in passed_over]
    return np.logical_not(np.any(np.isin(pool.factor, bad), axis=1))


def _constant_term(pool: Pool) -> int | None:
    rows = np.flatnonzero(~pool.factor.any(axis=1))
    return int(rows[0]) if rows.size else None


def _run(pool: Pool, rows: Rows, candidate, method: ForwardOLS) -> Path:
    constant = _constant_term(pool)
    forced = [constant] if method.constant == "first" and constant is not None else []
    candidate = candidate.copy()
    if method.constant == "after" and constant is not None:
        candidate[constant] = False
    dtype = rows.v.dtype
    number = partial(jnp.asarray, dtype=dtype)
    return jax.block_until_ready(
        _search(
            rows.v,
            rows.y,
            rows.weight,
            pool.factor,
            positions(pool.factor, len(pool.variables) + 1),
            candidate,
            np.array(forced, dtype=np.int32),
            max_terms=min(method.max_terms, len(pool)),
            rho=number(method.rho),
            tau=number(method.tau),
            tau_absolute=number(method.tau_absolute),
        )
    )


def _with_constant(pool: Pool, rows: Rows, path: Path) -> Path:
    """The thesis's ending: the constant joins the chosen terms, all are fitted anew."""
    constant = _constant_term(pool)
    if constant is None:
        raise SpecError("the pool has no constant term to add", field="constant")
    slot = np.asarray(path.count)[:, None] == np.arange(path.index.shape[1] + 1)[None]
    index = np.where(slot, constant, np.pad(path.index, ((0, 0), (0, 1))))
    err = np.pad(path.err, ((0, 0), (0, 1)))
    theta = np.zeros(err.shape, err.dtype)
    cond = []
    for o, n in enumerate(np.asarray(path.count) + 1):
        columns = evaluate(jnp.asarray(pool.factor[index[o, :n]]), rows.v)
        theta[o, :n], _, c = least_squares(columns, rows.y[o], rows.weight[o])
        cond.append(float(c))
        residual = rows.y[o] - theta[o, :n] @ columns
        left = float(jnp.sum(rows.weight[o] * residual**2)) / float(path.power[o])
        err[o, n - 1] = max(1.0 - err[o].sum() - left, 0.0)
    return dataclasses.replace(
        path,
        index=jnp.asarray(index),
        err=jnp.asarray(err),
        count=path.count + 1,
        coefficient=jnp.asarray(theta),
        cond=jnp.asarray(cond),
    )


def select(
    pool: Pool,
    data: Dataset,
    method: ForwardOLS | None = None,
    *,
    weights: list[Float[np.ndarray, " time"]] | None = None,
) -> Solution[Selection]:
    """Choose terms of `pool` for every modelled output by `method`.

    `weights` holds one non-negative weight per sample and record. Signals are scaled by
    their root mean square, never centred. Terms of constant or duplicate channels are
    passed over and listed in `stats["passed_over"]`. `stats` also holds, per output,
    the nested criteria (`aic`, `aicc`, `bic`, `fpe`, `cp`), `sse` (scaled) and `cond`.

    Status `pool_exhausted` when no candidate was left, `unidentifiable` when the chosen
    columns' scaled condition exceeds 1/sqrt(eps). Too few rows, constant outputs and
    data without excitation raise `DataError`.
    """
    method = ForwardOLS() if method is None else method
    data, _ = match_channels(data, pool.channels)
    passed_over = unusable_signals(data, pool)
    need = min(method.max_terms, len(pool)) + 1
    rows = regression_rows(
        data,
        pool.variables,
        pool.outputs,
        history=pool.variables.longest,
        need=need,
        weights=weights,
    )
    path = _run(pool, rows, _candidates(pool, passed_over), method)
    if method.constant == "after":
        path = _with_constant(pool, rows, path)
    return _finish(pool, rows, path, passed_over, method)


def _finish(
    pool: Pool, rows: Rows, path: Path, passed_over, method
) -> Solution[Selection]:
    index, err = np.asarray(path.index), np.asarray(path.err)
    used = np.arange(index.shape[1])[None] < np.asarray(path.count)[:, None]
    value = Selection(
        pool,
        index,
        used,
        np.where(used, err, 0.0),
        np.asarray(path.coefficient),
        rows.gain,
    )
    power = np.asarray(path.power)[:, None]
    sse = np.maximum(power * (1.0 - np.cumsum(value.err, axis=1)), 0.0)
    samples = np.asarray((rows.weight > 0).sum(axis=1))
    tables = [criteria(s, int(n)) for s, n in zip(sse, samples, strict=True)]
    cond = np.asarray(path.cond)
    stats: dict = {name: np.stack([t[name] for t in tables]) for name in tables[0]}
    stats |= {
        "sse": sse,
        "samples": samples,
        "cond": cond,
        "count": np.asarray(path.count),
        "passed_over": passed_over,
        "candidates": len(pool),
    }
    limit = 1.0 / np.sqrt(np.finfo(sse.dtype).eps)
    names = [pool.channels.output_names[o] for o in pool.outputs]
    if np.any(cond > limit):
        o = int(np.argmax(cond))
        detail = (
            f"the chosen terms of {names[o]} are collinear (condition {cond[o]:.1e}): "
            + ", ".join(pool.name(t) for t in value.terms(o)[-3:])
        )
        return Solution(value, RESULTS.unidentifiable, stats, detail)
    explained = 1.0 - value.err.sum(axis=1) <= method.rho
    exhausted = np.logical_not(explained) & (np.asarray(path.count) < method.max_terms)
    if np.any(exhausted):
        o = int(np.argmax(exhausted))
        detail = f"{int(path.count[o])} terms of {names[o]} qualify"
        return Solution(value, RESULTS.pool_exhausted, stats, detail)
    return Solution(value, RESULTS.ok, stats)
