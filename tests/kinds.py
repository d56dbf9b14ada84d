"""Networks of every kind that a run distinguishes, with one record to run them on."""

import dataclasses
from functools import cache

import common
import hidden_problems
import jax
import numpy as np
from common import KINDS, A, B

from jaxnarx.data import Dataset
from jaxnarx.models import (
    Network,
    SigmoidTree,
    SignedRoot,
    assemble,
    global_model,
    hold_to_range,
    local_models,
    output_model,
    total,
)
from jaxnarx.regressors import Kautz, LowPass, Variables, polynomial_pool

EVERY = (
    *(*KINDS, "own feedback", "root", "sum", "filters"),
    *("filters beyond", "linear", "hold", "nan", "hidden"),
)
TIME = 45

OWN = {
    "by inputs": ((True, False, True),),
    "coupled, by own output": ((True, False, True), None),
    "both": ((False, True, True), (True, False)),
    "shared": (((True, False, True),),),
    "root": (((True, False, True), (False, True, False)),),
}
"""Which local models of every output are fed back their own; "shared": which groups
share one, "root": the first of them computes a root."""
KIND = {"both": "coupled, by own output", "shared": "by inputs", "root": "by inputs"}
FLOOR = -2.0
"""Floor of the root, scaled: measured outputs lie on both sides of it."""


@cache
def own_feedback(name: str, bound: float = 50.0) -> Network:
    net = common.named(KIND.get(name, name), bound=bound)
    models = tuple(
        m if own is None else dataclasses.replace(m, own=groups(own))
        for m, own in zip(net.models, OWN[name], strict=True)
    )
    if name == "root":
        fields = np.array([True, False]), np.array([FLOOR, 0.0])
        root = SignedRoot(*jax.device_put(fields))
        models = (dataclasses.replace(models[0], root=root),)
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


def sum_part(data: Dataset, gain, seed: int, *, leaves: int, order: int) -> Network:
    """A tree of gates for `y`: products of inputs at lags of its own, linear
    feedback of this order."""
    rng = np.random.default_rng(seed)
    pool = polynomial_pool(
        data.channels,
        outputs=["y"],
        input_lags={"a": (0, seed), "b": (1,)},
        output_lags=tuple(range(1, order + 1)),
        degree=2,
        filters={"b": [LowPass(0.5 * seed)]},
    )
    theta = 0.04 * rng.normal(size=(leaves, len(pool)))  # far from the bounds
    if leaves == 1:
        model = global_model(pool.factor, theta[0])
    else:
        # Leaf after leaf is cut off; scheduling of its own, and scales of its own.
        gates = leaves - 1
        path = np.tril(np.ones((leaves, gates), np.int32), -1) - np.eye(
            leaves, gates, dtype=np.int32
        )
        fields = rng.normal(size=(gates, 2)), rng.uniform(size=gates), np.ones(gates)
        table = Variables.of([(0, seed, None), (1, 0, None)])
        local = local_models(pool.factor, theta)
        tree = SigmoidTree(*jax.device_put((*fields, path)))
        scales = rng.uniform(-1, 1, 2), rng.uniform(1, 2, 2)
        model = output_model(local, tree, table, *scales)
    # Reported outputs are not held: a sum within limits is no sum of parts within them.
    return hold_to_range(assemble(pool, data, gain, [model]), None)


def summed(data: Dataset) -> Network:
    """A tree of three regions and one of two, whose gates are 1 to 2 as shares."""
    gain = np.array([1.0, 0.5, 2.0, 1.0])
    parts = [
        sum_part(data, gain, 1, leaves=3, order=2),
        sum_part(data, gain, 3, leaves=2, order=1),
    ]
    return total(parts, (1.0, 2.0))


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
    if name == "root":
        return own_feedback("root"), data
    if name == "sum":
        return summed(data), data
    net = common.named("by inputs")
    if name == "filters":
        return filtered(net), data
    if name == "filters beyond":
        return narrow(filtered(net), "linear"), data
    return narrow(net, name), data
