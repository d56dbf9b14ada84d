"""Many selections at once: several weightings of the same rows, or several engines."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset, match_channels
from jaxnarx.errors import DataError, SpecError
from jaxnarx.guard import guarded
from jaxnarx.methods import Backward, ForwardOLS, StepwiseF
from jaxnarx.regressors import Pool, Rows, flat_weights, regression_rows
from jaxnarx.selection.select_terms import choose_terms, solution_of
from jaxnarx.selection.selection import Selection
from jaxnarx.selection.unusable import unusable_signals, usable_terms
from jaxnarx.solution import RESULTS, Solution

Method = ForwardOLS | StepwiseF | Backward

MEMORY = 2.5e8
"""Bytes that the directions of all lanes of one call may take."""


@guarded
def select_weighted(
    pool: Pool,
    data: Dataset,
    method: Method,
    weightings: Sequence[Sequence[Float[np.ndarray, " _"]]],
) -> list[Solution[Selection]]:
    """`select` with each of several weightings of the samples, in one program.

    A weighting is one array per record with a weight per sample, such as the validity
    of one local model. All of them share the passes over the pool; as many run at once
    as fit into memory. A weighting that leaves fewer rows than terms gets the status
    `too_short` and no terms.
    """
    data, _ = match_channels(data, pool.channels)
    passed_over = unusable_signals(data, pool)
    size = min(method.max_terms, len(pool))
    history = pool.variables.longest
    rows = regression_rows(
        data, pool.variables, pool.outputs, history=history, need=size + 1
    )
    longest = rows.batch.signals.shape[1]
    outputs = len(pool.outputs)
    width = max(int(MEMORY / (8 * size * rows.v.shape[1] * outputs)), 1)
    usable = usable_terms(pool, passed_over)
    found: list[Solution[Selection]] = []
    for first in range(0, len(weightings), width):
        part = list(weightings[first : first + width])
        # The last call is filled up, so that all of them run the same program.
        spare = min(width, len(weightings)) - len(part)
        flat = [flat_weights(w, data, longest)[rows.at] for w in part]
        flat += [flat[0]] * spare
        lanes = _lanes(rows, flat)
        choice = choose_terms(pool, lanes, method, usable, [[]] * lanes.y.shape[0])
        for n in range(len(part)):
            own = slice(n * outputs, (n + 1) * outputs)
            mine = choice._replace(
                path=jax.tree.map(lambda a, own=own: a[own], choice.path),
                collinear=choice.collinear[own],
            )
            solution = solution_of(pool, lanes.of_lanes(own), mine, passed_over, method)
            found.append(_enough(solution, size))
    return found


def _lanes(rows: Rows, flat: list[Float[np.ndarray, " rows"]]) -> Rows:
    """Every weighting of every output as a lane of its own, weighting by weighting."""
    weight = jnp.concatenate([rows.weight * jnp.asarray(w)[None] for w in flat])
    return dataclasses.replace(rows, y=jnp.tile(rows.y, (len(flat), 1)), weight=weight)


def _enough(solution: Solution[Selection], size: int) -> Solution[Selection]:
    if solution.value.samples.min() > size:
        return solution
    detail = (
        f"{int(solution.value.samples.min())} rows with weight, fewer than the "
        f"{size + 1} that {size} terms need"
    )
    empty = dataclasses.replace(solution.value, used=np.zeros_like(solution.value.used))
    return Solution(empty, RESULTS.too_short, solution.stats, detail)


@guarded
def select_each(
    pool: Pool, datasets: Sequence[Dataset], method: Method
) -> list[Solution[Selection]]:
    """`select` for each of several engines, whose rows are padded to one length.

    One compiled program serves them all. An engine whose data are refused gets the
    status `crashed`, with the reason as detail and a selection without terms.
    """
    if not len(datasets):
        raise SpecError("no dataset to select on", field="datasets")
    prepared = [_prepare(pool, data, method) for data in datasets]
    longest = max(
        (p[0].v.shape[1] for p in prepared if not isinstance(p, str)), default=0
    )
    found = []
    for item in prepared:
        if isinstance(item, str):
            found.append(_refused(pool, item))
            continue
        rows, passed_over = item
        rows = _padded(rows, longest)
        usable = usable_terms(pool, passed_over)
        choice = choose_terms(pool, rows, method, usable, [[]] * len(pool.outputs))
        found.append(solution_of(pool, rows, choice, passed_over, method))
    return found


def _prepare(pool: Pool, data: Dataset, method: Method):
    try:
        data, _ = match_channels(data, pool.channels)
        passed_over = unusable_signals(data, pool)
        rows = regression_rows(
            data,
            pool.variables,
            pool.outputs,
            history=pool.variables.longest,
            need=min(method.max_terms, len(pool)) + 1,
        )
    except DataError as error:
        return str(error)
    return rows, passed_over


def _padded(rows: Rows, length: int) -> Rows:
    """With more rows, of weight zero; their place is that of the first sample."""
    more = length - rows.v.shape[1]
    wide = ((0, 0), (0, more))
    return Rows(
        jnp.pad(rows.v, wide),
        jnp.pad(rows.y, wide),
        jnp.pad(rows.weight, wide),
        np.pad(rows.at, (0, more)),
        rows.batch,
        rows.gain,
    )


def _refused(pool: Pool, reason: str) -> Solution[Selection]:
    outputs = len(pool.outputs)
    row, square = np.zeros((outputs, 1)), np.zeros((outputs, 1, 1))
    value = Selection(
        pool,
        np.zeros((outputs, 1), int),
        np.zeros((outputs, 1), bool),
        row,
        row,
        row,
        square,
        square,
        row,
        row,
        np.zeros(outputs),
        np.zeros(outputs, int),
        np.ones(len(pool.channels.all)),
    )
    return Solution(value, RESULTS.crashed, {}, reason)
