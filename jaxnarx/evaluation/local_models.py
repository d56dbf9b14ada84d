"""Gains and poles of the local models over the operating range."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import program
from jaxnarx.checks import require_known
from jaxnarx.data import Dataset, stack_records
from jaxnarx.errors import SpecError
from jaxnarx.models import Network, fed_back_variables, held_inputs, scheduling_values
from jaxnarx.regressors import (
    Variables,
    evaluate,
    even_places,
    parse_variable,
    realise,
    row_columns,
    variable_names,
)
from jaxnarx.simulation import match_records, tables

EXAMINED_SAMPLES = 600
"""Samples looked at, evenly spaced."""


@dataclasses.dataclass(frozen=True, eq=False)
class LocalBehaviour:
    """One local model, linearised at the samples where it leads.

    `model` counts from 1. `place` holds the variables `over` which it is shown, in
    their units. `gain` is what a step of a signal by one unit changes the output by
    once it has settled, in the output's unit; NaN where the model alone would not
    settle. `modulus` is that of its slowest pole, `time_constant` [s] the time in which
    that decays to 1/e, infinite from modulus 1 on and zero without feedback.
    """

    output: str
    model: int
    over: tuple[str, ...]
    place: Float[np.ndarray, "points dims"]
    gain: dict[str, Float[np.ndarray, " points"]]
    modulus: Float[np.ndarray, " points"]
    time_constant: Float[np.ndarray, " points"]


@guard_arguments
def local_behaviour(
    network: Network,
    data: Dataset,
    *,
    output: str | None = None,
    over: Sequence[str] = (),
    points: int = EXAMINED_SAMPLES,
) -> tuple[LocalBehaviour, ...]:
    """Static gains and slowest poles of every local model of one output.

    Each is taken alone (its validity one) at measured samples where its validity is the
    largest; `points` of `data` in all, evenly spaced. `output` defaults to the first,
    `over` to the scheduling variables; a model without any needs it, such as
    `over=["speed[t]"]`. A model that leads nowhere has no points. Other outputs that
    feed into a local model count as inputs.
    """
    network.require_measured("The behaviour of local models")
    network.require_no_roots("The behaviour of local models")
    o = _position(network, output)
    model = network.models[o]
    data = match_records(network, data)
    batch = held_inputs(network, stack_records(data))
    at = even_places(
        batch, tables(network), network.history, points, "local models need"
    )

    def columns(table: Variables, **scaled) -> np.ndarray:
        return row_columns(batch, at, table, data.sample_time, **scaled)

    gain = np.asarray(network.gain)
    v = columns(network.variables, gain=gain, ones=1)
    slope, phi = _slopes(
        network, *jax.device_put((v, columns(model.scheduling))), output=o
    )
    lead, shown = np.asarray(phi).argmax(axis=0), _shown_variables(network, o, over)
    place, names = columns(shown).T, variable_names(network.channels, shown)
    return tuple(
        _behaviour(
            network, o, m, np.asarray(slope[m], float)[:, own], names, place[own]
        )
        for m in np.flatnonzero(np.asarray(model.active)).tolist()
        for own in [np.flatnonzero(lead == m)]
    )


def _position(network: Network, output: str | None) -> int:
    names = network.output_names
    if output is None:
        return 0
    require_known(output, names, "output", f"no model of output {output!r}")
    return names.index(output)


def _shown_variables(network: Network, o: int, over: Sequence[str]) -> Variables:
    if over:
        return Variables.of([parse_variable(network.channels, name) for name in over])
    if not len(network.models[o].scheduling):
        raise SpecError(
            f"the model of {network.output_names[o]} has no scheduling variable; say "
            "what to show it over, such as over=['speed[t]']",
            field="over",
        )
    return network.models[o].scheduling


@program
def _slopes(
    network: Network,
    v: Float[Array, "vars points"],
    x: Float[Array, "dims points"],
    *,
    output: int,
):
    """Slope of every local model by every lagged variable (scaled), and the weights.

    Product rule: the other factors of the terms whose k-th is that variable.
    """
    model, factor = network.models[output], network.models[output].local.factor
    variable = jnp.arange(1, v.shape[0], dtype=factor.dtype)
    theta = model.local.dense()
    slope = jnp.zeros((theta.shape[0], *v[1:].shape), v.dtype)
    for k in range(factor.shape[1]):
        others = evaluate(factor.at[:, k].set(0), v)
        hit = (factor[:, k][:, None] == variable[None]).astype(v.dtype)
        slope = slope + jnp.einsum("mt,tv,tp->mvp", theta, hit, others)
    return slope, model.validity(scheduling_values(model, x), model.active)


def _behaviour(
    network: Network,
    o: int,
    m: int,
    slope: Float[np.ndarray, "vars points"],
    names: list[str],
    place: Float[np.ndarray, "points dims"],
) -> LocalBehaviour:
    """The behaviour of one local model, from its slopes at its own points."""
    own = [
        (row, lag)
        for row, output, lag in fed_back_variables(network.variables, network.signals)
        if output == o
    ]
    past = np.zeros((slope.shape[1], max((lag for _, lag in own), default=0) + 1))
    for row, lag in own:
        past[:, lag] += slope[row]
    modulus = _slowest(past)
    left = np.where(modulus < 1, 1 - past.sum(axis=1), np.nan)
    scale = np.asarray(network.gain, float)
    effect: dict[str, np.ndarray] = {}
    for row, (signal, _, filter_) in enumerate(network.variables.entries):
        if row in dict(own) or not np.any(slope[row]):
            continue
        settled = 1.0
        if filter_ is not None:
            system = realise(filter_, float(network.sample_time))
            settled = float(jnp.sum(system.c * system.rest))
        name = network.channels.names[signal]
        per_unit = settled * scale[network.signals[o]] / scale[signal]
        effect[name] = effect.get(name, 0.0) + slope[row] * per_unit
    gain = {name: value / left for name, value in effect.items()}
    seconds = _decay(modulus) * float(network.sample_time)
    output = network.output_names[o]
    return LocalBehaviour(
        output, m + 1, tuple(names), place.astype(float), gain, modulus, seconds
    )


def _slowest(past: Float[np.ndarray, "points lags"]) -> Float[np.ndarray, " points"]:
    """Largest modulus of the roots of z^n - past_1 z^(n-1) - ... - past_n."""
    points, lags = past.shape
    companion = np.zeros((points, lags, lags))
    companion[:, 0] = past
    companion[:, np.arange(1, lags), np.arange(lags - 1)] = 1.0
    return np.abs(np.linalg.eigvals(companion)).max(axis=1, initial=0.0)


def _decay(modulus: Float[np.ndarray, " points"]) -> Float[np.ndarray, " points"]:
    """Samples in which a pole decays to 1/e; see `LocalBehaviour`."""
    inside = np.clip(modulus, np.finfo(float).tiny, 1 - 1e-15)
    samples = np.where(modulus > 0, -1 / np.log(inside), 0.0)
    return np.where(modulus < 1, samples, np.inf)
