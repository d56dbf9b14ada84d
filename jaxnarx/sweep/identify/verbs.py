"""What the fused program does not know: a member by the verbs themselves.

Every selector and partition that `select` and `grow` take, those of one's own
included; rows, statuses and scores are those of the program.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.arrays.programs import program
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.methods import (
    Backward,
    Case,
    ForwardOLS,
    Global,
    Grid,
    Identification,
    Lolimot,
    PredictionError,
    SigmoidTree,
    SimulationError,
    SimulationOLS,
    StepwiseF,
)
from jaxnarx.models import Network
from jaxnarx.partition import grow
from jaxnarx.refinement import freeze, refine
from jaxnarx.regressors import Pool, variable_names
from jaxnarx.selection import select
from jaxnarx.simulation import drive_of
from jaxnarx.solution import NAMES, RESULTS, Solution
from jaxnarx.sweep.fleet import Fleet
from jaxnarx.sweep.identify.choose import Chosen
from jaxnarx.sweep.identify.member import Member, Part, Prepared
from jaxnarx.sweep.identify.program import Outcome
from jaxnarx.sweep.identify.rows import Row, empty_row, row_of
from jaxnarx.sweep.identify.score import Score, score
from jaxnarx.sweep.identify.settings import allowed_variables, within

SELECTORS = {"stepwise": StepwiseF, "backward": Backward}


def selector(method: Identification, case: Case) -> Any:
    """How a case chooses terms."""
    if not isinstance(method.select, str):
        return _told(method.select, case, {"terms": "max_terms", "rho": "rho"})
    terms: Any = within(case, method).terms
    if method.select == "forward":
        return ForwardOLS(max_terms=terms, rho=case.rho)
    if method.select == "simulation":
        return SimulationOLS(start_terms=min(terms, 4), max_terms=terms)
    return SELECTORS[method.select](max_terms=terms)


def partitioner(method: Identification, case: Case) -> Any:
    """How a case divides the operating space."""
    if not isinstance(method.partition, str):
        renamed = {"models": "max_models", "growth_ridge": "ridge"}
        same = {"k_sigma": "k_sigma", "smoothness": "smoothness"}
        return _told(method.partition, case, renamed | same)
    models: Any = within(case, method).models
    if not method.scheduling or models == 1:
        return Global()
    ridge: dict[str, Any] = {"ridge": case.growth_ridge}
    if method.partition == "log-sigmoids":
        return Grid(
            method.scheduling, models=(models,), validity="log-sigmoids", **ridge
        )
    common = ridge | {"max_models": models, "criterion": "none"}
    if method.partition == "tree":
        return SigmoidTree(method.scheduling, smoothness=case.smoothness, **common)
    common |= {"k_sigma": case.k_sigma, "validity": method.validity}
    return Lolimot(method.scheduling, **common)


def refinement(
    method: Identification, case: Case
) -> SimulationError | PredictionError | None:
    """How a case refines; None: not at all."""
    steps: Any = within(case, method).steps
    if case.train == "none" or not steps:
        return None
    common = {"ridge": case.ridge, "width_band": method.width_band}
    if method.objective == "prediction":
        return PredictionError(max_steps=steps, **common)
    return SimulationError(
        horizons=method.horizons,
        window_steps=method.window_steps,
        max_steps=steps,
        train="staged" if case.train == "staged" else "joint",
        **common,
    )


def _told(method: Any, case: Case, fields: dict[str, str]) -> Any:
    """A method with what the case sets, where that is not the usual."""
    known = {f.name for f in dataclasses.fields(method)} if _plain(method) else set()
    usual, changed = Case(), {}
    for name, field in fields.items():
        value = getattr(case, name)
        if value == getattr(usual, name):
            continue
        if field not in known:
            raise SpecError(
                f"a case sets {name}, and {type(method).__name__} has no {field}",
                field=name,
            )
        changed[field] = value
    return dataclasses.replace(method, **changed) if changed else method


def _plain(method: Any) -> bool:
    return dataclasses.is_dataclass(method) and not isinstance(method, type)


def require_verbs(method: Identification, case: Case) -> None:
    """`SpecError` where a case does not go with the methods."""
    for make in (selector, partitioner, refinement):
        make(method, case)
    if case.scatter:
        raise SpecError(
            "scatter moves partitions of the fused program alone; leave it out with "
            "other methods",
            field="scatter",
        )


def run_member(
    fleet: Fleet,
    engine: int,
    method: Identification,
    case: Case,
    pool: Pool,
    member: Member,
) -> Row:
    """The row of one engine under one case, by `select`, `grow` and `refine`."""
    train = fleet.dataset(engine)
    judge = None
    if fleet.validation is not None:
        judge = fleet.dataset(engine, "validation")
    kept = np.flatnonzero(np.all(allowed_variables(case, pool)[pool.factor], axis=1))
    few = dataclasses.replace(pool, factor=pool.factor[kept])
    try:
        chosen = select(few, train, selector(method, case))
        grown = grow(chosen.value, train, partitioner(method, case), validation=judge)
    except DataError as error:
        return empty_row(fleet, Prepared(None, "unidentifiable", str(error)))
    _require_scheduling(grown.value, method)
    fit = _refined(grown.value, train, judge, method, case)
    outcome = _outcome(pool, kept, member, chosen, grown, fit)
    return row_of(pool, outcome, grown.value) | {"detail": fit.detail}


def _require_scheduling(network: Network, method: Identification) -> None:
    """A row is read with the scheduling variables of the identification."""
    model = network.models[0]
    own = tuple(variable_names(network.channels, model.scheduling))
    feedback = model.own is not None
    if (own and own != tuple(method.scheduling)) or feedback:
        raise SpecError(
            f"the partition is scheduled by {', '.join(own)}"
            + (" with local models fed back their own output" if feedback else "")
            + f"; a sweep's rows tell of scheduling={list(method.scheduling)} and of "
            "the network's feedback",
            field="scheduling",
        )


def _refined(
    network: Network,
    train: Dataset,
    judge: Dataset | None,
    method: Identification,
    case: Case,
) -> Solution[Network]:
    way = refinement(method, case)
    if way is None:
        return Solution(network, RESULTS.ok, {"history": []})
    alone = {"coefficients": {"partition": False}, "partition": {"coefficients": False}}
    moving = freeze(network, **alone[case.train]) if case.train in alone else None
    return refine(network, train, way, validation=judge, trainable=moving)


def _outcome(
    pool: Pool,
    kept: np.ndarray,
    member: Member,
    chosen: Solution,
    grown: Solution[Network],
    fit: Solution[Network],
) -> Outcome:
    """The verbs' results in the form of the program's."""
    terms = kept[chosen.value.terms(0)]
    model = fit.value.models[0]
    place = {tuple(row): n for n, row in enumerate(pool.factor[terms].tolist())}
    at = [place[tuple(row)] for row in np.asarray(model.local.factor).tolist()]
    count = int(np.asarray(model.active).sum())
    theta = np.zeros((count, len(terms)))
    theta[:, at] = np.asarray(model.local.dense())[:count]
    parts = {"train": member.train, "validation": member.validation}
    parts |= {"test": member.test}
    scores = {
        name: _scores(grown.value, fit.value, part)
        for name, part in parts.items()
        if part is not None
    }
    history = fit.stats["history"]
    values = {
        "status": NAMES.index(_status(chosen, grown, fit, scores)),
        "models": count,
        "theta": theta,
        "steps": len(history),
        "history": np.array([row["loss"] for row in history], float),
        "guard": np.array([row["validation"] for row in history], float),
        "shrunk": np.array(1.0),
    }
    found = {
        "index": terms,
        "used": np.ones(len(terms), bool),
        "err": chosen.value.err[0][: len(terms)],
        "factor": pool.factor[terms],
        "condition": np.max(chosen.stats["cond"]),
    }
    arrays = jax.tree.map(jnp.asarray, (found, values))
    own = Chosen(**arrays[0])
    return Outcome(chosen=own, validity=model.validity, scores=scores, **arrays[1])


@program
def _both(network: Network, part: Part) -> Score:
    drive = drive_of(network, jnp.asarray(part.signals), jnp.asarray(part.valid))
    modes = [score(network, drive, part, jnp.asarray(free)) for free in (False, True)]
    return jax.tree.map(lambda *a: jnp.stack(a), *modes)


def _scores(start: Network, end: Network, part: Part) -> Score:
    """Of start and end, one step and free run."""
    found = [_both(network, part) for network in (start, end)]
    return jax.tree.map(lambda *a: jnp.stack(a), *found)


def _status(
    chosen: Solution, grown: Solution, fit: Solution, scores: dict[str, Score]
) -> str:
    """As the program tells it."""
    if fit.status_name == "start_diverged":
        return "start_diverged"
    if any(np.asarray(s.diverged)[1, 1] for s in scores.values()):
        return "diverged"
    if "unidentifiable" in (chosen.status_name, grown.status_name, fit.status_name):
        return "unidentifiable"
    judged = np.asarray(scores.get("validation", scores["train"]).nrmse)[:, 1]
    asked = bool(fit.stats["history"]) or "end" in fit.stats
    return "no_improvement" if asked and not judged[1] < judged[0] else "ok"
