"""Drop outputs of a network that are neither modelled nor scheduled on."""

import dataclasses

import jax
import numpy as np

from jaxnarx.data import Channels
from jaxnarx.models.network import Network
from jaxnarx.regressors import Variables


def drop_outputs(network: Network) -> Network:
    """The same model for data that need not bring such outputs along."""
    inputs = len(network.channels.inputs)
    tables = (network.variables, *(m.scheduling for m in network.models))
    used = {*network.signals, *(s for table in tables for s, _ in table)}
    outputs = network.channels.outputs
    kept = [o for o in range(len(outputs)) if inputs + o in used]
    hidden = range(inputs + len(outputs), len(network.channels.all))
    if len(kept) == len(outputs):
        return network
    signals = [*range(inputs), *(inputs + o for o in kept), *hidden]
    place = {signal: n for n, signal in enumerate(signals)}

    def move_variables(table: Variables) -> Variables:
        return Variables.of([(place[s], lag, f) for s, lag, f in table.entries])

    def take_signals(name: str) -> jax.Array:
        return jax.device_put(np.asarray(getattr(network, name))[signals])

    models = tuple(
        dataclasses.replace(m, scheduling=move_variables(m.scheduling))
        for m in network.models
    )
    left, own = tuple(outputs[o] for o in kept), network.channels
    return Network(
        channels=Channels(own.inputs, left, own.hidden),
        modelled=tuple(kept.index(o) for o in network.modelled),
        variables=move_variables(network.variables),
        models=models,
        gain=take_signals("gain"),
        lower=network.lower,
        upper=network.upper,
        low=take_signals("low"),
        high=take_signals("high"),
        sample_time=network.sample_time,
        hold=network.hold,
        window=network.window,
        outside=network.outside,
        nan=network.nan,
        invalid_after=network.invalid_after,
        domain=network.domain,
        certificate=network.certificate,
        errors=network.errors,
    )
