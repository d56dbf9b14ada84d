"""One network of several outputs from networks of one output each."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np

from jaxnarx.data import Channel, Channels
from jaxnarx.errors import SpecError
from jaxnarx.models.network import Network, OutputModel
from jaxnarx.regressors import Variables


def combine_outputs(networks: Sequence[Network]) -> Network:
    """Combine networks of the same channels: all their outputs, computed side by side.

    A free run of the result is that of the parts, from the longest of their histories
    and windows. Hidden channels are numbered through; domain and certificate have to be
    found anew. `SpecError` where channels, sample times or holds differ or an output
    comes twice.
    """
    first = networks[0]
    modelled = tuple(o for n in networks for o in n.modelled)
    known = first.channels.measured
    for one in networks[1:]:
        same = one.channels.measured == known and one.sample_time == first.sample_time
        limits = one.hold == first.hold and one.outside == first.outside
        if not same or not limits:
            raise SpecError(
                "networks to be merged must have the same channels, sample time and "
                "limits",
                field="networks",
            )
    if len(set(modelled)) < len(modelled):
        raise SpecError("an output is modelled by two networks", field="networks")
    measured = len(known.all)
    ends = np.cumsum([0, *(n.hidden for n in networks)]).tolist()
    tables = [
        shift_hidden(network.variables, measured, end)
        for network, end in zip(networks, ends, strict=False)
    ]
    entries = list(dict.fromkeys(e for table in tables for e in table.entries))
    parts = [
        tuple(
            move_terms(model, table, entries, measured, end) for model in network.models
        )
        for network, table, end in zip(networks, tables, ends, strict=False)
    ]

    def every(name: str, at: Sequence[int]) -> list[np.ndarray]:
        """A field's values for measured channels, or outputs, and then for hidden
        ones."""
        values = [np.asarray(getattr(n, name)) for n in networks]
        pairs = zip(values, at, strict=True)
        hidden = [value[count:] for value, count in pairs]
        return [
            *(value[:count] for value, count in zip(values, at, strict=True)),
            *hidden,
        ]

    outputs = [len(n.modelled) for n in networks]
    signals = [measured] * len(networks)
    lower, upper = (np.concatenate(every(k, outputs)) for k in ("lower", "upper"))
    gain, low, high = (
        np.concatenate([every(k, signals)[0], *every(k, signals)[len(networks) :]])
        for k in ("gain", "low", "high")
    )
    gain, lower, upper, low, high = jax.device_put((gain, lower, upper, low, high))
    counts = zip(parts, outputs, strict=True)
    models = [model for part, count in counts for model in part[:count]]
    counts = zip(parts, outputs, strict=True)
    models += [model for part, count in counts for model in part[count:]]
    hidden = tuple(Channel(name) for name in hidden_names(known, ends[-1]))
    return Network(
        Channels(known.inputs, known.outputs, hidden),
        modelled,
        Variables.of(entries),
        tuple(models),
        gain,
        lower,
        upper,
        low,
        high,
        first.sample_time,
        first.hold,
        window=max(n.window for n in networks),
        outside=first.outside,
        nan=first.nan,
        invalid_after=first.invalid_after,
    )


def hidden_names(known: Channels, count: int) -> list[str]:
    """`x1`, `x2` ..., with a stem that makes none of them one of the `known`."""
    stem = "x"
    while any(f"{stem}{n + 1}" in known.names for n in range(count)):
        stem += "_"
    return [f"{stem}{n + 1}" for n in range(count)]


def shift_hidden(table: Variables, measured: int, by: int) -> Variables:
    """Move hidden channels so many places."""
    return Variables.of(
        [(s + by if s >= measured else s, d, f) for s, d, f in table.entries]
    )


def move_terms(
    model: OutputModel, table: Variables, entries: list, measured: int, by: int
) -> OutputModel:
    """The model with its terms' variables at their places in another table, and hidden
    channels so many places later."""
    place = np.array([0, *(entries.index(e) + 1 for e in table.entries)], np.int32)
    factor = jax.device_put(place[np.asarray(model.local.factor)])
    model = eqx.tree_at(lambda m: m.local.factor, model, factor)
    scheduling = shift_hidden(model.scheduling, measured, by)
    return dataclasses.replace(model, scheduling=scheduling)
