"""One network of several outputs from networks of one output each."""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np

from jaxnarx.errors import SpecError
from jaxnarx.models.network import Network, OutputModel
from jaxnarx.regressors import Variables


def merged(networks: Sequence[Network]) -> Network:
    """All outputs of several networks of the same channels, computed side by side.

    A free run of the result is that of the parts, from the longest of their histories.
    `SpecError` where channels, sample times or holds differ or an output comes twice.
    """
    first = networks[0]
    modelled = tuple(o for n in networks for o in n.modelled)
    for one in networks[1:]:
        same = one.channels == first.channels and one.sample_time == first.sample_time
        if not same or one.hold != first.hold:
            raise SpecError(
                "networks to be merged must have the same channels, sample time and "
                "limits",
                field="networks",
            )
    if len(set(modelled)) < len(modelled):
        raise SpecError("an output is modelled by two networks", field="networks")
    entries = list(dict.fromkeys(e for n in networks for e in n.variables.entries))
    models = tuple(
        _moved(model, network.variables, entries)
        for network in networks
        for model in network.models
    )
    lower, upper = (
        jax.device_put(np.concatenate([np.asarray(getattr(n, k)) for n in networks]))
        for k in ("lower", "upper")
    )
    return Network(
        first.channels,
        modelled,
        Variables.of(entries),
        models,
        first.gain,
        lower,
        upper,
        first.low,
        first.high,
        first.sample_time,
        first.hold,
    )


def _moved(model: OutputModel, table: Variables, entries: list) -> OutputModel:
    """The model with its terms' variables at their places in another table."""
    place = np.array([0, *(entries.index(e) + 1 for e in table.entries)], np.int32)
    factor = jax.device_put(place[np.asarray(model.local.factor)])
    return eqx.tree_at(lambda m: m.local.factor, model, factor)
