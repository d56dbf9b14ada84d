"""Which stage of a growth to keep."""

from typing import Any

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

    best, stopped = 0, "capacity"
    smallest = value(0)
    for stage in range(1, distinct):
        now = value(stage)
        if now < smallest:
            best, smallest = stage, now
        elif stage - best >= method.patience:
            stopped = "criterion"
            break
    if stopped == "capacity" and count[distinct - 1] < method.max_models:
        stopped = "data"
    figures = {
        "models": count[:distinct],
        "sse": sse,
        "aicc": known["aicc"],
        "bic": known["bic"],
        "effective": effective,
        "best": best,
        "stopped": stopped,
    }
    if method.criterion == "validation":
        figures["validation"] = validation
    return best, figures


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

    def look(carry, now):
        best, smallest, going = carry
        n, value, here = now
        going = going & here
        better = going & (value < smallest)
        best = jnp.where(better, n, best)
        going = going & (n - best < patience)
        return (best, jnp.where(better, value, smallest), going), None

    begin = jnp.asarray(0), values[0], jnp.asarray(True)
    (best, _, _), _ = jax.lax.scan(look, begin, (at[1:], values[1:], there[1:]))
    return best
