"""Choice of the local models that are fed back their own outputs, region by region.

Z. Li 2012, section 8.3, leaves open how to choose between an output-error model and a
polynomial NARX model in a region. One step ahead they are the same, so the free run
decides.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from jaxnarx.data import Dataset
from jaxnarx.models import Network, fed_back_variables
from jaxnarx.partition.stages import free_run_nrmse

CHOICE_PASSES = 2
"""How often every local model is looked at."""

Own = Bool[np.ndarray, " models"]


def with_feedback(
    network: Network, data: Dataset, feedback: str
) -> tuple[Network, dict[str, list[Any]]]:
    """The network with what its method says of the feedback, and the figures.

    With `"choose"` each output is judged alone, on the measured values of the others:
    from the better of all and none, one local model after the other is turned over and
    stays so where the free-run NRMSE on `data` falls. Figures, by output: `own` (which
    local models have feedback of their own) and, where it was chosen,
    `feedback_nrmse` of `"network"`, `"own"` and the choice, infinite where a record
    diverges.
    """
    if feedback == "network":
        return network, {}
    models, flags, figures = [], [], []
    for o, model in enumerate(network.models):
        own = np.asarray(model.active).copy()
        if not _has_own_feedback(network, o):
            own[:] = False
        elif feedback == "choose":
            own, figure = _choose(_part(network, o), data, own)
            figures.append(figure)
        flags.append(own)
        models.append(_set_flags(model, own))
    found: dict[str, list[Any]] = {"own": flags}
    if figures:
        found["feedback_nrmse"] = figures
    return dataclasses.replace(network, models=tuple(models)), found


def _has_own_feedback(network: Network, output: int) -> bool:
    """Whether several local models have lags of the output to choose between."""
    rows = fed_back_variables(network.variables, network.signals)
    several = int(np.sum(np.asarray(network.models[output].active))) > 1
    return several and any(o == output for _, o, _ in rows)


def _set_flags(model, own: Own):
    """The model with these flags; without any it keeps its quicker loop."""
    return dataclasses.replace(model, own=_separate_groups(own) if own.any() else None)


def _separate_groups(own: Own):
    """Every one of these a group of its own."""
    return jnp.asarray(np.diag(own))


def _part(network: Network, output: int) -> Network:
    """The network of one output alone."""
    at = np.array([output])
    return dataclasses.replace(
        network,
        modelled=(network.modelled[output],),
        models=(network.models[output],),
        lower=network.lower[at],
        upper=network.upper[at],
    )


def _choose(network: Network, data: Dataset, every: Own) -> tuple[Own, dict]:
    def error(own: Own) -> float:
        model = dataclasses.replace(network.models[0], own=_separate_groups(own))
        return free_run_nrmse(dataclasses.replace(network, models=(model,)), data)

    nobody = np.zeros_like(every)
    figures = {"network": error(nobody), "own": error(every)}
    own, least = nobody, figures["network"]
    if figures["own"] < least:
        own, least = every, figures["own"]
    for m in np.flatnonzero(every).tolist() * CHOICE_PASSES:
        turned = own.copy()
        turned[m] = ~turned[m]
        if (now := error(turned)) < least:
            own, least = turned, now
    return own, figures | {"chosen": least}
