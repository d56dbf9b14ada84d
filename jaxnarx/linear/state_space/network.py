"""A network with hidden states from a linear state-space model.

With the state's value after a sample, z(t) = x(t+1), the model

    x(t+1) = A x(t) + B u(t) + b ,   y(t) = C x(t) + D u(t) + d

is a network of the terms of z(t-1) and u(t); products of them, up to a degree, come
with coefficients of zero.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require
from jaxnarx.data import Channel, Channels, Dataset, gains, stack_records
from jaxnarx.errors import SpecError
from jaxnarx.linear.state_space.model import StateSpace
from jaxnarx.models import (
    OUTPUT_MARGIN,
    AdditiveGates,
    Network,
    global_model,
    hidden_names,
    ranges,
)
from jaxnarx.regressors import Variables
from jaxnarx.simulation import make_masks, match_records, simulate

FREE_DEVIATIONS = 8.0
"""Standard deviations a hidden state may reach while it is trained, and beyond what it
has reached with gates."""


def products(count: int, degree: int) -> Int[np.ndarray, "terms degree"]:
    """All terms of so many variables up to a degree; 0 is the constant."""
    rows = itertools.combinations_with_replacement(range(count + 1), degree)
    return np.array(list(rows), np.int32)


@guard_arguments
def state_network(
    model: StateSpace,
    data: Dataset,
    outputs: tuple[int, ...],
    *,
    degree: int = 1,
    window: int = 50,
    saturation: float = 0.0,
    delayed: Sequence[tuple[int, int]] | None = None,
) -> Network:
    """The network with the free run of `model`, whose states have unit size.

    `outputs` are the positions of its outputs among those of the data. Products of
    states and inputs up to `degree` are terms of all that is computed. With a
    `saturation` states stay within so many of their sizes. `delayed` tells
    which input, so many samples ago, each input of the model is; by default those of
    the data, as they come.
    """
    known = data.channels
    inputs, states = len(known.inputs), len(model.a)
    driven = [(j, 0) for j in range(inputs)] if delayed is None else list(delayed)
    if degree < 1 or window < 1:
        raise SpecError("degree and window must be at least 1", field="degree")
    require(
        len(driven) == model.b.shape[1]
        and all(0 <= j < inputs and lag >= 0 for j, lag in driven),
        "delayed",
        f"delayed must name one of {inputs} inputs and a lag from 0 on for each of the "
        f"{model.b.shape[1]} inputs of the model, got {driven}",
    )
    hidden = tuple(Channel(name) for name in hidden_names(known, states))
    channels = Channels(known.inputs, known.outputs, hidden)
    first = len(known.all)
    rows = [(first + k, 1) for k in range(states)] + driven
    own = np.append(inputs + np.array(outputs), first + np.arange(states))
    low, high = ranges(data)
    gain = np.append(gains(data), np.ones(states))
    size = saturation or 2.0
    low, high = (
        np.append(a, np.full(states, b)) for a, b in ((low, -size), (high, size))
    )
    wider = OUTPUT_MARGIN * (high - low)[own]
    wider[len(outputs) :] = 0.0 if saturation else FREE_DEVIATIONS - size
    table = products(len(rows), degree)
    theta = _coefficients(model, gain[[j for j, _ in driven]], gain[own], table)
    return Network(
        channels,
        outputs,
        Variables(tuple(rows)),
        tuple(global_model(table, row) for row in theta),
        *jax.device_put(
            (
                gain,
                (low[own] - wider) / gain[own],
                (high[own] + wider) / gain[own],
                low,
                high,
                np.asarray(data.sample_time),
            )
        ),
        window=window,
    )


def _coefficients(
    model: StateSpace,
    inputs: Float[np.ndarray, " inputs"],
    own: Float[np.ndarray, " computed"],
    table: Int[np.ndarray, "terms degree"],
) -> Float[np.ndarray, "computed terms"]:
    """Coefficients of every term for all that is computed, in scaled signals: by the
    gains of the inputs and of what is computed."""
    linear = np.block(
        [
            [model.output_offset[:, None], model.c, model.d * inputs[None]],
            [model.state_offset[:, None], model.a, model.b * inputs[None]],
        ]
    )
    theta = np.zeros((len(own), len(table)))
    alone = np.count_nonzero(table, axis=1) <= 1
    theta[:, alone] = linear[:, table[alone].max(axis=1)]
    return theta / own[:, None]


@guard_arguments
def increase_degree(network: Network, degree: int) -> Network:
    """The same network with the products up to a higher degree, coefficients zero.

    SpecError where the network has products of a higher degree already.
    """
    factors = [np.asarray(model.local.factor) for model in network.models]
    reached = max(int(np.count_nonzero(f, axis=1).max(initial=0)) for f in factors)
    require(
        degree >= reached,
        "degree",
        f"the network has products of degree {reached}; degree {degree} is lower",
    )
    table = products(len(network.variables), degree)
    place = {tuple(sorted(row)): n for n, row in enumerate(table.tolist())}
    models = []
    for model in network.models:
        local = model.local
        theta = np.zeros(len(table))
        dense = np.asarray(local.dense())[0]
        for row, value in zip(np.asarray(local.factor).tolist(), dense, strict=True):
            own = sorted(filter(None, row))
            theta[place[(*[0] * (degree - len(own)), *own)]] += value
        models.append(global_model(table, theta))
    return dataclasses.replace(network, models=tuple(models))


@guard_arguments
def set_state_ranges(network: Network, data: Dataset) -> Network:
    """The network whose hidden channels are held to the ranges these data drive them
    through, widened as outputs are.

    One that saturates keeps its own. With sigmoid gates, beyond which it is linear,
    they are held only so far away that nothing else is left to do: a slow state wanders
    farther than a stretch tells.
    """
    data = match_records(network, data)
    run = simulate(network, data).value
    # Before a run begins, and behind its last valid sample, nothing is computed.
    masks = make_masks(network, stack_records(data), network.window)
    each = zip(run.hidden, run.limited, masks.start, masks.end, strict=True)
    found = np.concatenate([h[s:e][~m[s:e].any(axis=1)] for h, m, s, e in each])
    if not len(found):
        return network
    count, first = len(network.modelled), len(network.channels.measured.all)
    low, high = found.min(axis=0), found.max(axis=0)
    wider, gain = OUTPUT_MARGIN * (high - low), np.asarray(network.gain)[first:]
    if isinstance(network.models[0].validity, AdditiveGates):
        wider = np.maximum(wider, FREE_DEVIATIONS * found.std(axis=0))
    values, saturates = {}, np.asarray(network.saturates)[count:]
    for name, value, at in (
        ("low", low, first),
        ("high", high, first),
        ("lower", (low - wider) / gain, count),
        ("upper", (high + wider) / gain, count),
    ):
        old = np.asarray(getattr(network, name))
        kept = np.where(saturates, old[at:], value)
        values[name] = jax.device_put(np.append(old[:at], kept))
    return dataclasses.replace(network, **values)
