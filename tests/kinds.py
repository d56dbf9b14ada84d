"""Networks of every kind that a run distinguishes, with one record to run them on."""

import dataclasses
from functools import cache

import common
import hidden_problems
import jax
import numpy as np
from common import KINDS, A, B

from jaxnarx.data import Dataset
from jaxnarx.models import Network, hold_to_range
from jaxnarx.regressors import Kautz, LowPass, Variables

EVERY = (
    *(*KINDS, "own feedback", "filters", "filters beyond", "linear", "hold", "hidden"),
)
TIME = 45

OWN = {
    "by inputs": ((True, False, True),),
    "coupled, by own output": ((True, False, True), None),
    "both": ((False, True, True), (True, False)),
    "shared": (((True, False, True),),),
}
"""Which local models of every output are fed back their own; "shared": which groups
share one."""
KIND = {"both": "coupled, by own output", "shared": "by inputs"}


@cache
def own_feedback(name: str, bound: float = 50.0) -> Network:
    net = common.named(KIND.get(name, name), bound=bound)
    models = tuple(
        m if own is None else dataclasses.replace(m, own=groups(own))
        for m, own in zip(net.models, OWN[name], strict=True)
    )
    return dataclasses.replace(net, models=models)


def groups(own) -> jax.Array:
    """Each of these local models a group of its own, or the rows of a table."""
    table = np.array(own)
    return jax.device_put(np.diag(table) if table.ndim == 1 else table)


def filtered(net: Network) -> Network:
    """Its first inputs pass filters: a real pole, and a pair, looked at three back."""
    (a, *rest), filters = net.variables.entries, (LowPass(0.5), Kautz(3.0, 0.7, 1))
    entries = [(A, 0, filters[0]), (B, 3, filters[1]), *rest[1:]]
    del a
    return dataclasses.replace(net, variables=Variables.of(entries))


def narrow(net: Network, outside: str) -> Network:
    """Its trained ranges are half of what the records hold."""
    low, high = common.device(np.array([-1.5, -0.3, -8.0, -2.0])), None
    high = -low
    net = dataclasses.replace(net, low=low, high=high)
    return hold_to_range(net, 0.02, outside=outside)


@cache
def problem(name: str) -> tuple[Network, Dataset]:
    """A network and one record of its channels."""
    if name == "hidden":
        given = hidden_problems.truth("scheduled")
        return hidden_problems.network("scheduled"), given.data[:1]
    data = common.dataset((TIME,))
    if name in KINDS:
        return common.named(name), data
    if name == "own feedback":
        return own_feedback("both"), data
    net = common.named("by inputs")
    if name == "filters":
        return filtered(net), data
    if name == "filters beyond":
        return narrow(filtered(net), "linear"), data
    return narrow(net, name), data
