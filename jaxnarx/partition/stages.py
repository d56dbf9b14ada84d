"""The stages of a growth, and which of them to keep."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx import metrics
from jaxnarx.arrays import information
from jaxnarx.data import Dataset
from jaxnarx.models import Network
from jaxnarx.settings import Lolimot, SigmoidTree
from jaxnarx.simulation import simulate

Numbers = Float[np.ndarray, " stages"]


def grow_stages(
    begin: Any,
    attempt: Callable[[Any], Any],
    keep: Callable[[Any], Any],
    stages: int,
) -> Any:
    """Grow so many stages inside a program; what `keep` makes of `begin` and of each of
    them is stacked.

    A state has `count`, its number of local models, and `going`, whether any may still
    be divided. `attempt` divides one local model, or finds that it cannot be; a stage
    attempts until there is one more. Once none is going, stages repeat the last.
    """

    def grow_stage(state, _):
        target = state.count + 1
        state = jax.lax.while_loop(
            lambda s: s.going & (s.count < target), attempt, state
        )
        return state, keep(state)

    first = jax.tree.map(lambda a: a[None], keep(begin))
    if not stages:
        return first
    _, later = jax.lax.scan(grow_stage, begin, None, length=stages)
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), first, later)


class BestStage(NamedTuple):
    """The best stage so far and its figure; `going` until `patience` stages in a row
    are no better. On the host and, with `xp` jax.numpy, inside a program."""

    stage: Any
    value: Any
    going: Any = True

    def update(
        self, stage: Any, value: Any, patience: int, xp: Any = np
    ) -> "BestStage":
        """The best stage when there is one more."""
        better = self.going & (value < self.value)
        best = xp.where(better, stage, self.stage)
        value = xp.where(better, value, self.value)
        return BestStage(best, value, self.going & (stage - best < patience))


def free_run_nrmse(network: Network, data: Dataset) -> float:
    """Pooled NRMSE of the free run of a network's one output; inf where it diverges."""
    run = simulate(network, data).value
    if any(d.any() for d in run.diverged):
        return float("inf")
    (o,) = network.modelled
    y = np.concatenate([r.y[:, o : o + 1] for r in data])
    yhat, scored = np.concatenate(run.outputs), np.concatenate(run.scored)
    y = np.where(scored, y, 0.0)
    return float(metrics.nrmse(jnp.asarray(y), jnp.asarray(yhat), scored)[0])


def choose_stage(
    count: Int[np.ndarray, " stages"],
    sse: Numbers,
    effective: Numbers,
    samples: float,
    method: Lolimot | SigmoidTree,
    score: Any = None,
) -> tuple[int, dict[str, Any]]:
    """The best stage before `patience` successive deteriorations, and the figures.

    `score(stage)` is the free-run error of a stage on validation records; it is asked
    only where the criterion is that, and only for stages that are looked at.
    """
    distinct = int(np.sum(np.diff(count) > 0)) + 1
    sse, effective = sse[:distinct], effective[:distinct]
    known = information(sse, effective, samples)
    known["none"] = -np.arange(float(distinct))
    validation = np.full(distinct, np.inf)

    def value(stage: int) -> float:
        if method.criterion != "validation":
            return float(known[method.criterion][stage])
        validation[stage] = score(stage)
        return float(validation[stage])

    best = BestStage(0, value(0))
    for stage in range(1, distinct):
        best = best.update(stage, value(stage), method.patience)
        if not best.going:
            break
    grew_to_capacity = count[distinct - 1] >= method.max_models
    stopped = "capacity" if grew_to_capacity else "data"
    figures = {
        "models": count[:distinct],
        "sse": sse,
        "aicc": known["aicc"],
        "bic": known["bic"],
        "effective": effective,
        "best": int(best.stage),
        "stopped": stopped if best.going else "criterion",
    }
    if method.criterion == "validation":
        figures["validation"] = validation
    return int(best.stage), figures


def best_stage(
    sse: Float[Array, " stages"],
    effective: Float[Array, " stages"],
    count: Int[Array, " stages"],
    samples: Float[Array, ""],
    models: Int[Array, ""],
    *,
    criterion: str,
    patience: int,
) -> Int[Array, ""]:
    """The choice of `choose_stage` inside a program, by figures of the training data.

    Stages beyond `models` local models do not take part.
    """
    at = jnp.arange(sse.size)
    there = (at < models) & ((at == 0) | (jnp.diff(count, prepend=count[:1]) > 0))
    last = jnp.sum(there) - 1
    if criterion == "none":
        return last
    values = information(sse, effective, samples)[criterion]

    def update(best: BestStage, now):
        stage, value, here = now
        best = best._replace(going=best.going & here)
        return best.update(stage, value, patience, jnp), None

    begin = BestStage(jnp.asarray(0), values[0], jnp.asarray(True))
    best, _ = jax.lax.scan(update, begin, (at[1:], values[1:], there[1:]))
    return best.stage
