"""Which stage of a growth to keep."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxnarx.arrays.criteria import information
from jaxnarx.data import Dataset
from jaxnarx.evaluation import metrics
from jaxnarx.methods import Lolimot, SigmoidTree
from jaxnarx.models import Network
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
