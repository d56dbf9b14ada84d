"""Outcomes as rows of a table."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import FLEET_PARTS, Fleet
from jaxnarx.models import (
    AbstractValidity,
    Gaussians,
    LogSigmoids,
    Network,
    SigmoidTree,
)
from jaxnarx.regressors import Pool, variable_names
from jaxnarx.solution import STATUS_NAMES
from jaxnarx.sweep.identify.engine_data import PreparedMember
from jaxnarx.sweep.identify.program import Outcome

Row = dict[str, Any]

SCORE_SUFFIXES = ("_start", "")
SCORE_MODES = ("one_step", "free_run")
LIST_COLUMNS = (
    "term_names",
    "term_index",
    "term_err",
    "coefficient",
    "centre",
    "width",
    "partition",
    "scheduling",
    "offset",
    "span",
    "loss_history",
    "guard_history",
)


@guard_arguments
def score_names(parts: tuple[str, ...] = FLEET_PARTS) -> list[str]:
    """`train_one_step_start`, ..., `test_free_run`: before and after the refinement."""
    return [
        f"{p}_{mode}{when}"
        for p in parts
        for when in SCORE_SUFFIXES
        for mode in SCORE_MODES
    ]


def empty_row(fleet: Fleet, prepared: PreparedMember) -> Row:
    """The row of a member whose data cannot be used."""
    scores = score_names(tuple(fleet.parts))
    return (
        {"status": prepared.status, "detail": prepared.detail}
        | dict.fromkeys(scores)
        | {f"{name}_diverged": None for name in scores}
        | {"term_count": 0, "model_count": 0, "steps_taken": 0, "condition": None}
        | {"validity": ""}
        | {name: [] for name in LIST_COLUMNS}
    )


def make_row(pool: Pool, outcome: Outcome, network: Network) -> Row:
    """Plain Python from the arrays of one lane.

    A score is the pooled NRMSE, infinite where a record has diverged. `coefficient`
    lists the terms of the first model, then of the second; `centre` and `width` the
    dimensions, scaled to the training range (empty where the validity functions are not
    Gaussian); `partition` all that the validity functions of class `validity` hold,
    and `scheduling`, `offset` and `span` the variables and ranges that `network` is
    scheduled over, for `network_of`.
    """
    count, used = int(outcome.models), np.asarray(outcome.chosen.used)
    index = np.asarray(outcome.chosen.index)[used].tolist()
    shape = trim_validity(outcome.validity, count)
    scheduling = variable_names(pool.channels, network.models[0].scheduling)
    scores: Row = {}
    lost: Row = {}
    for part in (p for p in FLEET_PARTS if p in outcome.scores):
        score = outcome.scores[part]
        for w, when in enumerate(SCORE_SUFFIXES):
            for m, mode in enumerate(SCORE_MODES):
                name = f"{part}_{mode}{when}"
                scores[name] = float(score.nrmse[w, m])
                lost[f"{name}_diverged"] = bool(score.diverged[w, m])
    gaussian = isinstance(shape, Gaussians)
    row: Row = {"status": STATUS_NAMES[int(outcome.status)], "detail": _detail(outcome)}
    row |= scores | lost
    row |= {
        "term_count": len(index),
        "model_count": count,
        "steps_taken": int(outcome.steps),
        "condition": float(outcome.chosen.condition),
        "validity": type(shape).__name__,
        "term_names": [pool.name(t) for t in index],
        "term_index": index,
        "term_err": _flat(outcome.chosen.err[used]),
        "coefficient": _flat(outcome.theta[:count][:, used]),
        "centre": _flat(shape.centre) if gaussian else [],
        "width": _flat(np.exp(shape.log_width)) if gaussian else [],
        "partition": [x for leaf in jax.tree.leaves(shape) for x in _flat(leaf)],
        "scheduling": scheduling,
        "offset": _flat(network.models[0].offset),
        "span": _flat(network.models[0].span),
        "loss_history": _flat(outcome.history),
        "guard_history": _flat(outcome.guard),
    }
    return row


def _detail(outcome: Outcome) -> str:
    """The sentence on a start that diverged."""
    if STATUS_NAMES[int(outcome.status)] == "start_diverged":
        return (
            "the free run of the start diverges, and no network was found that does "
            "not; refine that of `network_of` from several starts, or choose fewer "
            "terms or a lower degree"
        )
    factor = float(outcome.shrunk)
    if factor == 1.0:
        return ""
    return f"the start diverged; feedback shrunk to {factor:g} led to one that does not"


def _flat(values: Any) -> list[float]:
    return np.asarray(values, float).reshape(-1).tolist()


def trim_validity(validity: AbstractValidity, count: int) -> AbstractValidity:
    """The validity functions of the first `count` models alone."""
    if isinstance(validity, LogSigmoids):
        return validity
    if isinstance(validity, SigmoidTree):
        gates = max(count - 1, 0)
        cut = (
            *(getattr(validity, name)[:gates] for name in validity.trained),
            validity.path[:count, :gates],
        )
        return eqx.tree_at(lambda v: (*v.parameters, v.path), validity, cut)
    return jax.tree.map(lambda a: a[:count], validity)
