"""The verb `select`: checks, the search, and what it found as a value."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import positions
from jaxnarx.data import Dataset, match_channels
from jaxnarx.errors import DataError, SpecError
from jaxnarx.regressors import Centring, Pool, Rows, evaluate, regression_rows
from jaxnarx.selection._search import Program, make_lanes, search
from jaxnarx.selection.anova import anova, significant_terms
from jaxnarx.selection.basis import Basis, Lane
from jaxnarx.selection.centred import (
    backs,
    centred_search,
    give_back_offsets,
    target_offset,
)
from jaxnarx.selection.custom_selector import own_choice
from jaxnarx.selection.path import PartialFHistory, Path, path_of, resize
from jaxnarx.selection.program import (
    Method,
    SearchPlan,
    adds_constant,
    allowed_terms,
    constant_term,
    plan,
)
from jaxnarx.selection.selection import Selection
from jaxnarx.selection.simulation_ols import Progress, simulation_ols
from jaxnarx.selection.statistics import compute_statistics, partial_f_histories
from jaxnarx.selection.unusable import unusable_signals, usable_terms
from jaxnarx.settings import (
    SELECTORS,
    Anova,
    Backward,
    ForwardOLS,
    Selector,
    SimulationOLS,
    StepwiseF,
)
from jaxnarx.solution import RESULTS, Solution, tell_precision

COLLINEAR_WORDS = "collinear with the chosen terms"
ROOM_MULTIPLE = 8
"""Least squares of given terms are compiled for this many, twice, ... of them."""

# Three programs rather than one: compiled together they take twice the memory.
_lanes = jax.jit(make_lanes)
_search = jax.jit(search, static_argnames=("max_terms", "removes", "exchanges"))
_path = jax.jit(jax.vmap(path_of))


@guard_arguments
@tell_precision
def select(
    source: Pool | Selection,
    data: Dataset,
    method: ForwardOLS
    | StepwiseF
    | Backward
    | SimulationOLS
    | Anova
    | Selector
    | str
    | None = None,
    *,
    weights: list[Float[np.ndarray, " _"]] | None = None,
    progress: Progress | None = None,
) -> Solution[Selection]:
    """Choose terms of a pool for every modelled output by `method`.

    Signals are scaled by their root mean square, never centred. Terms of constant or
    duplicate channels are passed over, as are terms that are collinear with the chosen
    ones.

    Where a channel's mean is more than `jaxnarx.regressors.centring.FAR` standard
    deviations from zero a product of it is taken in after its parts, so that the choice
    does not hang on the offset; the sums of squares of such an output, and its ERR, are
    those about its mean.

    `Anova` keeps all terms whose variables lie in a significant effect. It narrows a
    pool: choose further from `value.narrow_pool()`. `SimulationOLS` takes one output
    and no weights; its selection holds the one-step coefficients.

    Status `pool_exhausted` when a search by ERR ran out of candidates, `unidentifiable`
    when the chosen columns' scaled condition exceeds 1/sqrt(eps). Too few rows,
    constant outputs and data without excitation raise `DataError`.

    Args:
        source: The pool, or a selection as a start: its terms are in the model before
            the first choice.
        data: Records with the channels of the pool.
        method: How to choose (default `ForwardOLS()`); a function of one's own, too,
            see `jaxnarx.settings.Selector`; or the
            name of a registered one.
        weights: For every record one non-negative weight per sample; a validity
            function is one.
        progress: A function called on the host with a dictionary after every round of
            `SimulationOLS`.

    Returns:
        `value` holds the terms of every output in order of choice. `stats` holds, per
        output and nested size, the criteria of `criteria` ("aic", "bic", "fpe" of
        errors in the output's unit, "press", ...) and `sse` (scaled); per output
        `count`, `samples`, `cond`; per output and term the `t` values and two-sided
        `p_value` of the coefficients, which know nothing of the search before them;
        and why channels and terms were `passed_over`.
        Partial F adds `f_level`, the level at the end, and as `history`, per output,
        the partial F of all terms in the model after each round (thesis Table 5.2), by
        term text in order of entry; `Anova` as `anova` a table of effects per output;
        `SimulationOLS` the `network` refined on the free run, the rounds as `history`
        and `loss`, the mean squared free-run error over the output's variance.

    Example:
        selection = jnx.select(pool, data, jnx.ForwardOLS(max_terms=2))
        print(selection.value)
    """
    method = ForwardOLS() if method is None else method
    if isinstance(method, str):
        method = SELECTORS.find(method, "method")
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
        solution = _select_by_variance(pool, rows, method, usable)
    elif isinstance(method, Selector):
        if any(chosen):
            raise SpecError(
                "a selector of one's own takes a pool, not a selection to start from",
                field="source",
            )
        kept = own_choice(pool, rows, method, usable)
        solution = _fit_chosen(pool, rows, kept, method)
    elif isinstance(method, SimulationOLS):
        solution = _select_on_free_run(
            pool, data, rows, method, usable, chosen, progress
        )
    else:
        choice = choose_terms(pool, rows, method, usable, chosen)
        return make_solution(pool, rows, choice, passed_over, method)
    stats = solution.stats | {"passed_over": passed_over}
    return Solution(solution.value, solution.status, stats, solution.detail)


def _terms_asked(pool: Pool, method: Any) -> int:
    open_end = isinstance(method, Anova | Selector)
    return 1 if open_end else min(method.max_terms, len(pool))


def _select_by_variance(
    pool: Pool, rows: Rows, method: Anova, usable
) -> Solution[Selection]:
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
    found = _fit_chosen(pool, rows, kept, method)
    return dataclasses.replace(found, stats=found.stats | {"anova": tables})


def _fit_chosen(pool: Pool, rows: Rows, kept: list[list[int]], method):
    """The solution of terms that are chosen, in their order."""
    path = refit(pool, rows, kept)
    value = make_selection(pool, rows, path)
    stats = compute_statistics(value, path) | {"candidates": len(pool)}
    status, detail = _status(value, np.asarray(path.cond), method)
    return Solution(value, status, stats, detail)


def _select_on_free_run(
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
        few = ForwardOLS(max_terms=min(method.first_terms, len(pool)))
        start = chosen_terms(choose_terms(pool, rows, few, usable, [[]]).path)[0]
    path = refit(pool, rows, [start])
    theta = np.asarray(path.nested)[0, -1]
    found = simulation_ols(pool, data, rows.gain, start, theta, method, usable, tell)
    path = refit(pool, rows, [found.terms])
    value = make_selection(pool, rows, path)
    stats = compute_statistics(value, path) | {
        "candidates": len(pool),
        "network": found.network,
        "loss": found.loss,
        "history": found.history,
    }
    return Solution(value, found.status, stats, found.detail)


class Choice(NamedTuple):
    """The end of a search: its path and plan, and the candidates it dropped."""

    path: Path
    made: SearchPlan
    collinear: Bool[np.ndarray, "lanes terms"]
    centre: Centring | None


def choose_terms(
    pool: Pool, rows: Rows, method: Method, usable, chosen: Sequence[Sequence[int]]
) -> Choice:
    """The search on rows that are made; every row of `rows.y` is a lane.

    Where channels are far from zero it searches in centred coordinates, in which a
    product has no share of its parts, and takes in a product after its parts; the terms
    and their coefficients are those of the pool all the same.
    """
    samples = int((np.asarray(rows.weight) > 0).sum(axis=1).min())
    v, y, factor, parents, target = rows.v, rows.y, pool.factor, None, None
    centre = rows.find_centring(pool.variables)
    if centre is not None:
        v, factor, parents = centred_search(pool, v, centre, method, usable)
        target = target_offset(pool, centre, allowed_terms(pool, method, usable))
        y = y - target
    made = plan(pool, method, usable, chosen, samples, v.dtype, parents)
    basis, lanes, history, collinear = _run(v, y, rows.weight, factor, made)
    back = None if centre is None else backs(pool, centre, basis)
    path = jax.block_until_ready(_path(basis, lanes, history, back))
    if target is not None:
        path = give_back_offsets(pool, path, target)
    if adds_constant(method):
        path = _with_constant(pool, rows, path)
    return Choice(path, made, np.asarray(collinear), centre)


def _run(
    v: Float[Array, "vars rows"],
    y: Float[Array, "lanes rows"],
    weight: Float[Array, "lanes rows"],
    factor: Int[np.ndarray, "terms degree"],
    made: SearchPlan,
) -> tuple[Basis, Lane, PartialFHistory, Bool[Array, "lanes terms"]]:
    """Run a plan on every lane."""
    place = positions(factor, v.shape[0])
    lanes = _lanes(v, y, weight, factor, place, made.start, made.starts)
    basis, history, collinear = _search(
        v,
        lanes,
        factor,
        place,
        made.program,
        max_terms=made.max_terms,
        removes=made.removes,
        exchanges=made.exchanges,
    )
    return basis, lanes, history, collinear


def _with_constant(pool: Pool, rows: Rows, path: Path) -> Path:
    """The thesis's ending: the constant joins the chosen terms, all are fitted anew."""
    constant = constant_term(pool)
    if constant is None:
        raise SpecError("the pool has no constant term to add", field="constant")
    return refit(pool, rows, [[*terms, constant] for terms in chosen_terms(path)])


def chosen_terms(path: Path) -> list[list[int]]:
    """Terms of every lane, in order."""
    index, count = np.asarray(path.index), np.asarray(path.count)
    return [index[lane, :n].tolist() for lane, n in enumerate(count)]


def refit(pool: Pool, rows: Rows, chosen: Sequence[Sequence[int]]) -> Path:
    """Least squares of given terms in a given order; collinear ones are left out.

    Each lane's columns serve as the variables of a search that has nothing to choose.
    """
    slots = max(len(terms) for terms in chosen)
    paths = [
        resize(_refit_one(pool, rows, o, terms), slots)
        for o, terms in enumerate(chosen)
    ]
    return jax.tree.map(lambda *lanes: jnp.concatenate(lanes), *paths)


def _refit_one(pool: Pool, rows: Rows, lane: int, terms: Sequence[int]) -> Path:
    own, back, target = rows.select_lanes(slice(lane, lane + 1)), None, None
    index, y = np.asarray(terms), own.y
    size = len(index)
    room = -(-size // ROOM_MULTIPLE) * ROOM_MULTIPLE
    # What fills the room is not asked for and may not enter.
    filled = np.resize(np.arange(size), room)
    centre = own.find_centring(pool.variables)
    if centre is None:
        columns = evaluate(pool.factor[index[filled]], rows.v)
    else:
        columns, back = centre.columns(pool.factor[index], rows.v)
        columns = columns[filled]
        target = target_offset(pool, centre, np.isin(np.arange(len(pool)), index))
        y = y - target
        wide = np.pad(back, (0, room - size)).astype(columns.dtype)
        back = jax.device_put(wide[None])
    ones = jnp.ones((1, columns.shape[1]), columns.dtype)
    zeros = dict.fromkeys(("tau_absolute", "f_in", "f_out", "f_last"), 0.0)
    numbers = zeros | {"rho": -1.0, "tau": 1e-24}
    arrays = {
        "stages": np.zeros((1, room), bool),
        "limits": np.zeros(1, int),
        "keep": np.zeros(room, bool),
        "rounds": np.asarray(0),
    }
    arrays |= {name: np.asarray(x, columns.dtype) for name, x in numbers.items()}
    nothing = Program(**jax.device_put(arrays))
    made = SearchPlan(
        nothing,
        start=np.arange(room)[None],
        starts=np.array([size]),
        max_terms=room,
        removes=False,
        exchanges=False,
        candidates=0,
        f_level=0.0,
    )
    basis, lanes, history, _ = _run(
        jnp.concatenate([ones, columns]),
        y,
        own.weight,
        np.arange(1, room + 1)[:, None],
        made,
    )
    if centre is not None and int(basis.count[0]) < size:
        # Columns made without the terms that are left out.
        kept = np.asarray(basis.index)[0, : int(basis.count[0])]
        return resize(_refit_one(pool, rows, lane, index[kept].tolist()), size)
    path = jax.block_until_ready(_path(basis, lanes, history, back))
    path = resize(path, size)
    own_index = index[np.asarray(path.index)]
    path = dataclasses.replace(path, index=jax.device_put(own_index))
    if target is not None:
        path = give_back_offsets(pool, path, target)
    return path


def make_selection(pool: Pool, rows: Rows, path: Path) -> Selection:
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


def make_solution(
    pool: Pool, rows: Rows, choice: Choice, passed_over, method: Method
) -> Solution[Selection]:
    """Value, figures and status from what the search returned."""
    path, made = choice.path, choice.made
    value = make_selection(pool, rows, path)
    stats = compute_statistics(value, path)
    terms = np.flatnonzero(choice.collinear.any(axis=0)).tolist()
    dropped = {pool.name(term): COLLINEAR_WORDS for term in terms}
    stats |= {"passed_over": passed_over | dropped, "candidates": len(pool)}
    if made.removes:
        stats |= {"f_level": made.f_level, "history": partial_f_histories(pool, path)}
    status, detail = _status(value, np.asarray(path.cond), method, choice.centre)
    return Solution(value, status, stats, detail)


def _status(
    value: Selection, cond, method: Any, centre: Centring | None = None
) -> tuple[RESULTS, str]:
    pool, names = value.pool, value.output_names
    for o, name in enumerate(names if centre is not None else []):
        assert centre is not None
        terms = value.terms(o)
        factor, theta = pool.factor[terms], value.coefficient[o, : len(terms)]
        size = float(np.sqrt(value.total[o] / max(value.samples[o], 1)))
        detail = centre.warning(factor, theta, size, pool.channels, pool.variables)
        if detail:
            return RESULTS.unidentifiable, f"{name}: {detail}"
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
