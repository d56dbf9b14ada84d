"""Parts of a network that are computed without one another."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Int

from jaxnarx.data import Channels
from jaxnarx.models.network import Network, OutputModel
from jaxnarx.regressors import Variables


class NetworkPart(NamedTuple):
    """A part, and where it stands in the whole."""

    network: Network
    computed: Int[np.ndarray, " _"]
    """Positions of what it computes among `Network.computed`."""
    rows: Int[np.ndarray, " _"]
    """Positions of its lagged variables in the whole's table."""


def split_outputs(network: Network) -> list[NetworkPart]:
    """Networks of outputs that do not look at one another, each with the hidden
    channels that it needs; the whole where there is one part. Host only.

    Hidden channels that no output needs go with the first. `combine_outputs` undoes it.
    """
    count, rows = len(network.modelled), np.arange(len(network.variables))
    whole = [NetworkPart(network, np.arange(len(network.models)), rows)]
    if count < 2:
        return whole
    place = {s: n for n, s in enumerate(network.signals)}
    seen = [_variables_of(model) for model in network.models]
    looked = [
        {place[s] for s, _ in [network.variables.rows[r] for r in rows] if s in place}
        | {place[s] for s, _ in model.scheduling if s in place}
        for rows, model in zip(seen, network.models, strict=True)
    ]
    groups = _connected(looked)
    alone = [n for g in groups if g[0] >= count for n in g]
    groups = [g for g in groups if g[0] < count]
    if len(groups) < 2:
        return whole
    groups[0] = sorted(groups[0] + alone)
    return [_part(network, np.array(g), [seen[n] for n in g]) for g in groups]


def _variables_of(model: OutputModel) -> set[int]:
    """Rows of the variables in terms that are used."""
    local, active = model.local, np.asarray(model.active)
    index, used = np.asarray(local.index)[active], np.asarray(local.used)[active]
    rows = np.unique(np.asarray(local.factor)[np.unique(index[used])])
    return {int(r) - 1 for r in rows if r}


def _connected(looked: list[set[int]]) -> list[list[int]]:
    """Groups of positions that look at one another, directly or not."""
    group = list(range(len(looked)))
    for n, others in enumerate(looked):
        for other in others:
            old, new = group[other], group[n]
            group = [new if g == old else g for g in group]
    return [
        [n for n, g in enumerate(group) if g == own] for own in dict.fromkeys(group)
    ]


def _part(network: Network, at: np.ndarray, seen: list[set[int]]) -> NetworkPart:
    """The models at these positions, outputs first, as a network of their own."""
    measured, count = len(network.channels.measured.all), len(network.modelled)
    outputs, hidden = at[at < count], at[at >= count] - count
    moved = {measured + int(h): measured + n for n, h in enumerate(hidden)}
    rows = np.array(sorted(set().union(*seen)), int)
    entries = network.variables.entries
    table = Variables.of([_renumber(entries[r], moved) for r in rows.tolist()])
    place = np.zeros(len(entries) + 1, np.int32)
    place[rows + 1] = np.arange(1, len(rows) + 1)
    signals = np.concatenate([np.arange(measured), measured + hidden]).astype(int)
    models = tuple(_move_model(network.models[n], place, moved) for n in at.tolist())
    names = network.channels
    channels = Channels(
        names.inputs, names.outputs, tuple(names.hidden[h] for h in hidden.tolist())
    )
    leaves = [np.asarray(a) for a in (network.lower, network.upper)]
    bounds = [a[at] for a in leaves]
    scales = [np.asarray(a)[signals] for a in (network.gain, network.low, network.high)]
    lower, upper, gain, low, high = jax.device_put((*bounds, *scales))
    part = dataclasses.replace(
        network,
        channels=channels,
        modelled=tuple(network.modelled[o] for o in outputs.tolist()),
        variables=table,
        models=models,
        gain=gain,
        lower=lower,
        upper=upper,
        low=low,
        high=high,
        window=network.window if len(hidden) else 0,
        domain=None,
        certificate=None,
        errors=None,
    )
    return NetworkPart(part, at, rows)


def _renumber(entry: Any, moved: dict[int, int]) -> Any:
    """A row of a table of variables, with another number of its hidden channel."""
    signal, lag, filter_ = entry
    return moved.get(signal, signal), lag, filter_


def _move_model(
    model: OutputModel, place: np.ndarray, moved: dict[int, int]
) -> OutputModel:
    """The model with its variables at their places in a smaller table."""
    factor = jax.device_put(place[np.asarray(model.local.factor)])
    model = eqx.tree_at(lambda m: m.local.factor, model, factor)
    rows = [_renumber(entry, moved) for entry in model.scheduling.entries]
    return dataclasses.replace(model, scheduling=Variables.of(rows))
