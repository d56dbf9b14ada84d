"""The verb `select`: checks, the search, and what it found as a value."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Float, Int

from jaxnarx.arrays.contraction import positions
from jaxnarx.data import Dataset, match_channels
from jaxnarx.errors import DataError, SpecError
from jaxnarx.methods import (
    Anova,
    Backward,
    ForwardOLS,
    Selector,
    SimulationOLS,
    StepwiseF,
)
from jaxnarx.regressors import Pool, evaluate
from jaxnarx.regressors.rows import Rows, regression_rows
from jaxnarx.selection.anova import anova, significant_terms
from jaxnarx.selection.own import own_choice
from jaxnarx.selection.path import Path, padded, path_of
from jaxnarx.selection.program import Method, Plan, constant_term, plan
from jaxnarx.selection.search import Program, make_lanes, search
from jaxnarx.selection.selection import Selection
from jaxnarx.selection.simulation_ols import Progress, simulation_ols
from jaxnarx.selection.sizes import criteria_of
from jaxnarx.selection.unusable import unusable_signals, usable_terms
from jaxnarx.solution import RESULTS, Solution

# Three programs rather than one: compiled together they take twice the memory.
_lanes = jax.jit(make_lanes)
_search = jax.jit(search, static_argnames=("max_terms", "removes", "exchanges"))
_path = jax.jit(jax.vmap(path_of))


def select(
    source: Pool | Selection,
    data: Dataset,
    method: ForwardOLS
    | StepwiseF
    | Backward
    | SimulationOLS
    | Anova
    | Selector
    | None = None,
    *,
    weights: list[Float[np.ndarray, " _"]] | None = None,
    progress: Progress | None = None,
) -> Solution[Selection]:
    """Choose terms of a pool for every modelled output by `method`.

    A selection as `source` is a start: its terms are in the model before the first
    choice. `weights` holds one non-negative weight per sample and record; a validity
    function is one. Signals are scaled by their root mean square, never centred. Terms
    of constant or duplicate channels are passed over and listed in
    `stats["passed_over"]`.

    `stats` also holds, per output and nested size, the criteria of `criteria` ("aic",
    "bic", "press", ...) and `sse` (scaled); per output `count`, `samples`, `cond`; per
    output and term the `t` values and two-sided `p_value` of the coefficients, which
    know nothing of the search before them. With partial F, `f_level` is the level at
    the end, and `history` lists for every output the partial F of all terms in the
    model after each round (thesis Table 5.2), by term text in order of entry.

    `Anova` keeps all terms whose variables lie in a significant effect; the tables of
    effects are `stats["anova"]`, one per output. It narrows a pool: choose further from
    `value.narrowed()`.

    `SimulationOLS` takes one output, no weights, and calls `progress` on the host with
    a dictionary after every round. Its selection holds the one-step coefficients;
    `stats["network"]` is the network with those refined on the free run, `history` the
    rounds, `loss` the mean squared free-run error over the output's variance.

    A function of one's own chooses, too: `jaxnarx.methods.Selector` says what it is
    given and returns.

    Status `pool_exhausted` when a search by ERR ran out of candidates, `unidentifiable`
    when the chosen columns' scaled condition exceeds 1/sqrt(eps). Too few rows,
    constant outputs and data without excitation raise `DataError`.
    """
    method = ForwardOLS() if method is None else method
    if isinstance(method, SimulationOLS) and weights is not None:
        raise SpecError("SimulationOLS takes no sample weights", field="weights")
    pool = source.pool if isinstance(source, Selection) else source
    data, _ = match_channels(data, pool.channels)
    passed_over = unusable_signals(data, pool)
    outputs = range(len(pool.outputs))
    chosen = [source.terms(o) if source is not pool else [] for o in outputs]  # pyright: ignore
    rows = regression_rows(
        data,
        pool.variables,
        pool.outputs,
        history=pool.variables.longest,
        need=max(_terms_asked(pool, method), *map(len, chosen)) + 1,
        weights=weights,
    )
    usable = usable_terms(pool, passed_over)
    if isinstance(method, Anova):
        solution = _by_variance(pool, rows, method, usable)
    elif isinstance(method, Selector):
        if any(chosen):
            raise SpecError(
                "a selector of one's own takes a pool, not a selection to start from",
                field="source",
            )
        kept = own_choice(pool, rows, method, usable)
        solution = _as_chosen(pool, rows, kept, method)
    elif isinstance(method, SimulationOLS):
        solution = _on_free_run(pool, data, rows, method, usable, chosen, progress)
    else:
        path, made = choose_terms(pool, rows, method, usable, chosen)
        return solution_of(pool, rows, path, passed_over, method, made)
    stats = solution.stats | {"passed_over": passed_over}
    return Solution(solution.value, solution.status, stats, solution.detail)


def _terms_asked(pool: Pool, method: Any) -> int:
    open_end = isinstance(method, Anova | Selector)
    return 1 if open_end else min(method.max_terms, len(pool))


def _by_variance(pool: Pool, rows: Rows, method: Anova, usable) -> Solution[Selection]:
    tables = [anova(pool, rows, o, method) for o in range(len(pool.outputs))]
    kept = [[t for t in significant_terms(pool, a) if usable[t]] for a in tables]
    names = [pool.channels.output_names[o] for o in pool.outputs]
    for name, terms in zip(names, kept, strict=True):
        if not terms:
            raise DataError(
                f"no effect of the lagged variables on {name} is significant; use "
                "other lags or a larger `significance`",
                channel=name,
            )
    found = _as_chosen(pool, rows, kept, method)
    return dataclasses.replace(found, stats=found.stats | {"anova": tables})


def _as_chosen(pool: Pool, rows: Rows, kept: list[list[int]], method):
    """The solution of terms that are chosen, in their order."""
    path = refit(pool, rows, kept)
    value = selection_of(pool, rows, path)
    stats = _figures(value, path) | {"candidates": len(pool)}
    status, detail = _status(value, np.asarray(path.cond), method)
    return Solution(value, status, stats, detail)


def _on_free_run(
    pool: Pool, data: Dataset, rows: Rows, method: SimulationOLS, usable, chosen, tell
) -> Solution[Selection]:
    if len(pool.outputs) > 1:
        raise SpecError(
            "SimulationOLS chooses for one output at a time; make a pool for each, "
            "with outputs=['...']",
            field="outputs",
        )
    start = chosen[0]
    if len(start) > method.max_terms:
        raise SpecError(
            f"the start has {len(start)} terms, max_terms is {method.max_terms}",
            field="max_terms",
        )
    if not start:
        few = ForwardOLS(max_terms=min(method.start_terms, len(pool)))
        path, _ = choose_terms(pool, rows, few, usable, [[]])
        start = chosen_of(path)[0]
    path = refit(pool, rows, [start])
    theta = np.asarray(path.nested)[0, -1]
    found = simulation_ols(pool, data, rows.gain, start, theta, method, usable, tell)
    path = refit(pool, rows, [found.terms])
    value = selection_of(pool, rows, path)
    stats = _figures(value, path) | {
        "candidates": len(pool),
        "network": found.network,
        "loss": found.loss,
        "history": found.history,
    }
    return Solution(value, found.status, stats, found.detail)


def choose_terms(
    pool: Pool, rows: Rows, method: Method, usable, chosen: Sequence[Sequence[int]]
) -> tuple[Path, Plan]:
    """The search on rows that are made; every row of `rows.y` is a lane."""
    samples = int(np.asarray((rows.weight > 0).sum(axis=1)).min())
    dtype = rows.v.dtype
    made = plan(pool, method, usable, chosen, samples, dtype)
    path = run(rows.v, rows.y, rows.weight, pool.factor, made)
    if isinstance(method, ForwardOLS) and method.constant == "after":
        path = _with_constant(pool, rows, path)
    return path, made


def run(
    v: Float[Array, "vars rows"],
    y: Float[Array, "lanes rows"],
    weight: Float[Array, "lanes rows"],
    factor: Int[np.ndarray, "terms degree"],
    made: Plan,
) -> Path:
    """Run a plan on every lane."""
    place = positions(factor, v.shape[0])
    lanes = _lanes(v, y, weight, factor, place, made.start, made.starts)
    basis, history = _search(
        v,
        lanes,
        factor,
        place,
        made.program,
        max_terms=made.max_terms,
        removes=made.removes,
        exchanges=made.exchanges,
    )
    return jax.block_until_ready(_path(basis, lanes, history))


def _with_constant(pool: Pool, rows: Rows, path: Path) -> Path:
    """The thesis's ending: the constant joins the chosen terms, all are fitted anew."""
    constant = constant_term(pool)
    if constant is None:
        raise SpecError("the pool has no constant term to add", field="constant")
    return refit(pool, rows, [[*terms, constant] for terms in chosen_of(path)])


def chosen_of(path: Path) -> list[list[int]]:
    """Terms of every lane, in order."""
    index, count = np.asarray(path.index), np.asarray(path.count)
    return [index[lane, :n].tolist() for lane, n in enumerate(count)]


def refit(pool: Pool, rows: Rows, chosen: Sequence[Sequence[int]]) -> Path:
    """Least squares of given terms in a given order; collinear ones are left out.

    Each lane's columns serve as the variables of a search that has nothing to choose.
    """
    slots = max(len(terms) for terms in chosen)
    paths = [
        padded(_refit_one(pool, rows, o, terms), slots)
        for o, terms in enumerate(chosen)
    ]
    return jax.tree.map(lambda *lanes: jnp.concatenate(lanes), *paths)


def _refit_one(pool: Pool, rows: Rows, lane: int, terms: Sequence[int]) -> Path:
    columns = evaluate(pool.factor[np.asarray(terms)], rows.v)
    ones = jnp.ones((1, columns.shape[1]), columns.dtype)
    number = jnp.asarray(0.0, columns.dtype)
    size = len(terms)
    nothing = Program(
        stages=jnp.zeros((1, size), bool),
        limits=jnp.zeros(1, int),
        keep=jnp.zeros(size, bool),
        rho=number - 1.0,
        tau=jnp.asarray(1e-24, columns.dtype),
        tau_absolute=number,
        f_in=number,
        f_out=number,
        f_last=number,
        rounds=jnp.asarray(0),
    )
    made = Plan(
        nothing,
        start=np.arange(size)[None],
        starts=np.array([size]),
        max_terms=size,
        removes=False,
        exchanges=False,
        candidates=0,
        f_level=0.0,
    )
    path = run(
        jnp.concatenate([ones, columns]),
        rows.y[lane][None],
        rows.weight[lane][None],
        np.arange(1, size + 1)[:, None],
        made,
    )
    index = np.asarray(terms)[np.asarray(path.index)]
    return dataclasses.replace(path, index=jnp.asarray(index))


def selection_of(pool: Pool, rows: Rows, path: Path) -> Selection:
    """The value from the arrays."""
    count = np.asarray(path.count)
    last = np.maximum(count - 1, 0)
    lanes = np.arange(len(count))
    nested, errors = np.asarray(path.nested), np.asarray(path.errors)
    return Selection(
        pool,
        np.asarray(path.index),
        np.arange(nested.shape[1])[None] < count[:, None],
        np.asarray(path.err),
        nested[lanes, last],
        errors[lanes, last],
        nested,
        errors,
        np.asarray(path.sse),
        np.asarray(path.press),
        _total(rows),
        np.asarray(path.samples).astype(int),
        rows.gain,
    )


def _total(rows: Rows) -> Float[np.ndarray, " lanes"]:
    """Weighted sum of squares of the outputs about their means."""
    y, w = np.asarray(rows.y), np.asarray(rows.weight)
    mass = np.maximum(w.sum(axis=1), np.finfo(w.dtype).tiny)
    mean = (w * y).sum(axis=1) / mass
    return (w * (y - mean[:, None]) ** 2).sum(axis=1)


def solution_of(
    pool: Pool, rows: Rows, path: Path, passed_over, method: Method, made: Plan
) -> Solution[Selection]:
    """Value, figures and status from what the search returned."""
    value = selection_of(pool, rows, path)
    stats = _figures(value, path)
    stats |= {"passed_over": passed_over, "candidates": len(pool)}
    if made.removes:
        stats |= {"f_level": made.f_level, "history": _histories(pool, path)}
    status, detail = _status(value, np.asarray(path.cond), method)
    return Solution(value, status, stats, detail)


def _figures(value: Selection, path: Path) -> dict[str, Any]:
    t, p_value = _t_values(value)
    return _tables(value) | {
        "sse": value.sse,
        "samples": value.samples,
        "cond": np.asarray(path.cond),
        "count": np.asarray(path.count),
        "t": t,
        "p_value": p_value,
    }


def _tables(value: Selection) -> dict[str, np.ndarray]:
    """Criteria of all outputs; past an output's last size they repeat."""
    slots = value.index.shape[1]
    tables = [criteria_of(value, o) for o in range(len(value.index))]
    return {
        name: np.stack(
            [np.pad(t[name], (0, slots - len(t[name])), mode="edge") for t in tables]
        )
        for name in tables[0]
    }


def _t_values(value: Selection):
    """Coefficients over their standard errors, and the probability of larger ones."""
    positive = value.error > 0
    t = np.where(
        positive, value.coefficient / np.where(positive, value.error, 1.0), 0.0
    )
    spare = np.maximum(value.samples - value.used.sum(axis=1), 1)[:, None]
    p_value = 2.0 * scipy.special.stdtr(spare, -np.abs(t))
    return t, np.where(value.used, p_value, 1.0)


def _histories(pool: Pool, path: Path) -> list[list[dict[str, float]]]:
    h = jax.tree.map(np.asarray, path.history)
    return [
        [
            {
                pool.name(int(h.term[o, r, s])): float(h.f[o, r, s])
                for s in np.flatnonzero(h.used[o, r])
            }
            for r in range(int(h.rounds[o]))
        ]
        for o in range(len(h.rounds))
    ]


def _status(value: Selection, cond, method: Any) -> tuple[RESULTS, str]:
    pool, names = value.pool, value.output_names
    limit = 1.0 / np.sqrt(np.finfo(value.sse.dtype).eps)
    if np.any(cond > limit):
        o = int(np.argmax(cond))
        return RESULTS.unidentifiable, (
            f"the chosen terms of {names[o]} are collinear (condition {cond[o]:.1e}): "
            + ", ".join(pool.name(t) for t in value.terms(o)[-3:])
        )
    if isinstance(method, ForwardOLS):
        count = value.used.sum(axis=1)
        explained = 1.0 - value.err.sum(axis=1) <= method.rho
        exhausted = np.logical_not(explained) & (count < method.max_terms)
        if np.any(exhausted):
            o = int(np.argmax(exhausted))
            detail = f"{int(count[o])} terms of {names[o]} qualify"
            return RESULTS.pool_exhausted, detail
    return RESULTS.ok, ""
