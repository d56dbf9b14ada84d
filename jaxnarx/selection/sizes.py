"""How many of the chosen terms to keep: criteria, and errors along the path."""

from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset, match_channels
from jaxnarx.errors import SpecError, suggest
from jaxnarx.metrics import nrmse
from jaxnarx.models import Network, assemble, global_model
from jaxnarx.regressors import evaluate, regression_rows
from jaxnarx.selection.criteria import GREATER_IS_BETTER, criteria
from jaxnarx.selection.selection import Selection
from jaxnarx.simulation import Trajectories, predict, simulate

VALIDATION_CRITERIA = ("one_step", "free_run")
"""Criteria that need validation records."""
CRITERION_ALIASES = {"mdl": "bic"}


def criteria_of(
    selection: Selection, output: int = 0, *, variance: float | None = None
) -> dict[str, Float[np.ndarray, " sizes"]]:
    """Criteria of the nested models of one output, in its unit; see `criteria`.

    `variance` as `largest_variance` gives it adds "cp".
    """
    channels = selection.pool.channels
    signal = len(channels.inputs) + selection.pool.outputs[output]
    size = max(selection.size(output), 1)
    return criteria(
        selection.sse[output, :size],
        int(selection.samples[output]),
        total=float(selection.total[output]),
        press=selection.press[output, :size],
        variance=variance,
        gain=float(selection.gain[signal]),
    )


def largest_variance(
    selection: Selection, train: Dataset, output: int = 0
) -> float | None:
    """s^2 of Mallows' Cp (5.34): SSE/(N - rank) of all terms of the pool together.

    Scaled as `sse`. None where the records have not more rows than the pool terms, so
    that this model cannot be estimated.
    """
    pool = selection.pool
    train, _ = match_channels(train, pool.channels)
    rows = regression_rows(
        train,
        pool.variables,
        pool.outputs,
        history=pool.variables.longest,
        gain=selection.gain,
        exact=True,
    )
    root = np.sqrt(np.asarray(rows.weight[output]))
    samples = int(np.count_nonzero(root))
    if samples <= len(pool):
        return None
    columns = (np.asarray(evaluate(pool.factor, rows.v)) * root).T
    size = np.linalg.norm(columns, axis=0)
    columns /= np.where(size > 0, size, 1.0)
    y = np.asarray(rows.y[output]) * root
    theta, _, rank, _ = np.linalg.lstsq(columns, y, rcond=None)
    return float(np.sum((y - columns @ theta) ** 2) / (samples - rank))


@guard_arguments
def choose(
    selection: Selection,
    criterion: str = "bic",
    *,
    output: str | None = None,
    train: Dataset | None = None,
    validation: Dataset | None = None,
) -> int:
    """The size, 1, 2, ..., that `criterion` calls best among the nested models.

    "aic", "aicc", "bic" (or "mdl"), "fpe", "press", "adjusted_r2" and "overall_f" come
    from the search itself. "cp" takes the noise of the model with all terms of the pool
    (5.34), estimated on `train`, which must have more rows than the pool has terms.
    "one_step" and "free_run" are the normalised errors on the records of `validation`,
    with bounds and ranges from `train`. A size whose free run diverges counts as
    infinitely bad. `output` names one of several outputs; among equals the smallest
    size wins. `selection.head(size)` is the selection of that size.
    """
    place = _place(selection, output)
    name = CRITERION_ALIASES.get(criterion, criterion)
    if name in VALIDATION_CRITERIA:
        if train is None or validation is None:
            raise SpecError(
                f"criterion {criterion!r} needs `train` and `validation` records",
                field="validation",
            )
        values = errors_along(selection, train, validation)[name][:, place]
        return int(np.argmin(values[: selection.size(place)])) + 1
    noise = _noise(selection, train, place) if name == "cp" else None
    table = criteria_of(selection, place, variance=noise)
    if name not in table:
        known = [*table, *CRITERION_ALIASES, *VALIDATION_CRITERIA]
        raise SpecError(
            f"unknown criterion {criterion!r}. {suggest(criterion, known)}",
            field="criterion",
        )
    values = -table[name] if name in GREATER_IS_BETTER else table[name]
    return int(np.argmin(values)) + 1


def _noise(selection: Selection, train: Dataset | None, place: int) -> float:
    """The noise variance that Cp takes; SpecError where it cannot be estimated."""
    if train is None:
        raise SpecError(
            "criterion 'cp' needs the records of the selection as `train`: its noise "
            "is that of the model with all terms of the pool",
            field="train",
        )
    noise = largest_variance(selection, train, place)
    if noise is None:
        raise SpecError(
            f"criterion 'cp' needs more rows than the {len(selection.pool)} terms of "
            "the pool; choose another, such as 'bic'",
            field="criterion",
        )
    return noise


def _place(selection: Selection, output: str | None) -> int:
    names = selection.output_names
    if output is None:
        if len(names) > 1:
            raise SpecError(
                f"this selection has several outputs; name one of {names}",
                field="output",
            )
        return 0
    if output not in names:
        raise SpecError(
            f"no modelled output {output!r}. {suggest(output, names)}", field="output"
        )
    return names.index(output)


def network_of(selection: Selection, data: Dataset, size: int | None = None) -> Network:
    """The first `size` terms of every output as a network with one local model.

    All sizes have the same shapes, so that they share compiled programs. Ranges and
    feedback bounds come from `data`.
    """
    size = int(selection.index.shape[1]) if size is None else size
    models = []
    for o in range(len(selection.index)):
        last = max(min(size, selection.size(o)), 1) - 1
        factor = selection.pool.factor[selection.index[o]]
        theta = np.where(selection.used[o], selection.nested[o, last], 0.0)
        models.append(global_model(factor, theta.astype(selection.gain.dtype)))
    return assemble(selection.pool, data, selection.gain, models)


def errors_along(
    selection: Selection, train: Dataset, validation: Dataset
) -> dict[str, Float[np.ndarray, "sizes outputs"]]:
    """One-step and free-run NRMSE on `validation` of every nested size.

    `train` are the records of the selection: feedback bounds are made of their ranges.
    Outputs that diverge in a record of the free run give `inf`.
    """
    train, _ = match_channels(train, selection.pool.channels)
    validation, _ = match_channels(validation, selection.pool.channels)
    found: dict[str, list[Any]] = {"one_step": [], "free_run": []}
    for size in range(1, selection.index.shape[1] + 1):
        network = network_of(selection, train, size)
        for name, verb in (("one_step", predict), ("free_run", simulate)):
            found[name].append(
                _errors(network, verb(network, validation).value, validation)
            )
    return {name: np.stack(rows) for name, rows in found.items()}


def _errors(network: Network, run: Trajectories, data: Dataset) -> np.ndarray:
    outputs = np.array(network.modelled)
    y = np.concatenate([r.y[:, outputs] for r in data])
    error = nrmse(y, np.concatenate(run.outputs), np.concatenate(run.scored))
    return np.where(np.any(run.diverged, axis=0), np.inf, error)
