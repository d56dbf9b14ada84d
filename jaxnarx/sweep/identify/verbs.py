"""A member by the verbs themselves, for settings that the program does not know.

Every selector and partition that `select` and `grow` take, those of one's own
included; rows, statuses and scores are those of the program.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.arrays import program
from jaxnarx.data import Fleet
from jaxnarx.errors import DataError, SpecError
from jaxnarx.identification import identify, terms_of
from jaxnarx.models import Network
from jaxnarx.regressors import Pool
from jaxnarx.settings import Identification
from jaxnarx.simulation import drive_from_signals
from jaxnarx.solution import STATUS_NAMES, Solution
from jaxnarx.sweep.identify.engine_data import Member, Part, PreparedMember
from jaxnarx.sweep.identify.program import Outcome
from jaxnarx.sweep.identify.rows import Row, empty_row, make_row
from jaxnarx.sweep.identify.score import Score, score
from jaxnarx.sweep.identify.select_step import Chosen


def run_member(
    fleet: Fleet, engine: int, method: Identification, pool: Pool, member: Member
) -> Row:
    """The row of one engine under one case, with candidates out of `pool`."""
    judge = None
    if fleet.validation is not None:
        judge = fleet.dataset(engine, "validation")
    kept = np.flatnonzero(terms_of(method.pool, pool))
    few = dataclasses.replace(pool, factor=pool.factor[kept])
    own = dataclasses.replace(method, pool=few)
    try:
        fit = identify(fleet.dataset(engine), own, validation=judge)
    except DataError as error:
        return empty_row(fleet, PreparedMember(None, "unidentifiable", str(error)))
    if fit.value.models[0].own is not None:
        raise SpecError(
            "a sweep's rows tell of networks that are fed back their own output, not "
            "of local models with feedback of their own",
            field="feedback",
        )
    outcome = _outcome(pool, kept, member, fit)
    return make_row(pool, outcome, fit.value) | {"detail": fit.detail}


def _outcome(
    pool: Pool, kept: np.ndarray, member: Member, fit: Solution[Network]
) -> Outcome:
    """The verbs' results in the form of the program's."""
    chosen, grown = fit.stats["selection"], fit.stats["grown"]
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
    refined = fit.stats["refined"]
    history = [] if refined is None else refined.stats["history"]
    values = {
        "status": STATUS_NAMES.index(_status(fit, scores)),
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
    arrays = jax.device_put((found, values))
    own = Chosen(**arrays[0])
    return Outcome(chosen=own, validity=model.validity, scores=scores, **arrays[1])


@program
def _both(network: Network, part: Part) -> Score:
    drive = drive_from_signals(
        network, jnp.asarray(part.signals), jnp.asarray(part.valid)
    )
    modes = [score(network, drive, part, jnp.asarray(free)) for free in (False, True)]
    return jax.tree.map(lambda *a: jnp.stack(a), *modes)


def _scores(start: Network, end: Network, part: Part) -> Score:
    """Scores of start and end, one step and free run."""
    found = [_both(network, part) for network in (start, end)]
    return jax.tree.map(lambda *a: jnp.stack(a), *found)


def _status(fit: Solution[Network], scores: dict[str, Score]) -> str:
    """The status as the program tells it."""
    refined, *others = (fit.stats[k] for k in ("refined", "selection", "grown"))
    told = [s.status_name for s in (refined, *others) if s is not None]
    if "start_diverged" in told:
        return "start_diverged"
    if any(np.asarray(s.diverged)[1, 1] for s in scores.values()):
        return "diverged"
    if "unidentifiable" in told:
        return "unidentifiable"
    judged = np.asarray(scores.get("validation", scores["train"]).nrmse)[:, 1]
    asked = refined is not None and (
        bool(refined.stats["history"]) or "end" in refined.stats
    )
    return "no_improvement" if asked and not judged[1] < judged[0] else "ok"
