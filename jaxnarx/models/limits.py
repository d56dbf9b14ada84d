"""Limits that cost nothing: a network at the edge of the ranges it was trained on.

Outside of them polynomials say anything. The network's `outside` says what inputs do
there:

- `"flag"`: nothing, they are as they are, and the samples are marked;
- `"hold"`: they stay at the edge of their trained range;
- `"linear"`: validity functions and products stay as they are at the edge, and from
  there terms of inputs alone go on to first order, so that gains and poles are those of
  the edge;
- `"nan"`: as `"flag"`, and nothing is reported of such samples: they are not a number.

Inputs are held before anything is computed from them, in runs, training and linearised
networks alike (`Network.hold_inputs`). A reported output stays within its range,
widened by the margin m on either side:

    low - m (high - low)  <=  reported  <=  high + m (high - low) .

Where inputs are beyond their ranges outputs may be, too: unless inputs are held, the
overshoot of the inputs in use adds to m. It is the farthest that one of them is beyond
its own range, as a share of its width, and fades with the network's memory of n samples
(`input_memory`) once the input is back, as what is left of it in the outputs does:

    overshoot(t) = max(beyond(t), exp(-1/n) overshoot(t-1)) .

Outputs are held when all is computed. The feedback is unchanged, so that neither
derivatives nor the judgement of divergence, which rest on the feedback bound, depend on
the margin.

Inputs that take two values stay what they are when they are held to their range. An
input or output that was constant in training is held at that constant.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import not_negative
from jaxnarx.data import Batch
from jaxnarx.models.missing import input_memory
from jaxnarx.models.network import Network
from jaxnarx.models.outside import FLAG, HOLD, LINEAR

OUTPUT_MARGIN_SHARE = 0.02
"""Reported outputs may leave the training range by this share of it on either side."""


@guard_arguments
def hold_to_range(
    network: Network,
    margin: float | int | None = OUTPUT_MARGIN_SHARE,
    *,
    outside: str | None = None,
) -> Network:
    """The network with its inputs and reported outputs held to their trained ranges.

    `margin` is the share of its range by which a reported output may leave it; with
    None outputs are not held. `outside` says what inputs do beyond their ranges, see
    the module. By default they go on to first order with a margin, and are flagged
    without. Held samples are marked in `held` of a run, samples with an input outside
    its range in `extrapolated`, as ever. `SpecError` for a negative margin, or one that
    is not finite, and for an unknown `outside`.

    Example:
        held = jnx.models.hold_to_range(network)
        free = jnx.models.hold_to_range(held, None)
        stays = jnx.models.hold_to_range(network, outside="hold")
    """
    if outside is None:
        outside = FLAG if margin is None else LINEAR
    share = None
    if margin is not None:
        share = np.asarray(not_negative(margin, "margin"), network.gain.dtype)
        share = jax.device_put(share)
    return dataclasses.replace(network, hold=share, outside=outside)


def reported_range(
    network: Network,
) -> tuple[Float[np.ndarray, " outputs"], Float[np.ndarray, " outputs"]]:
    """Least and largest value reported of every modelled output while inputs are in
    their ranges, physical units.

    Infinite where the network is not held; host only.
    """
    own = np.array(network.signals)[: len(network.modelled)]
    low, high = (np.asarray(a)[own] for a in (network.low, network.high))
    if network.hold is None:
        return np.full_like(low, -np.inf), np.full_like(high, np.inf)
    wider = np.asarray(network.hold) * (high - low)
    return low - wider, high + wider


def overshoot_rule(network: Network) -> tuple[tuple[int, ...], float]:
    """The inputs whose overshoot widens what is reported, and the share of it that is
    left a sample later."""
    if network.outside == HOLD:
        return (), 0.0
    low, high = np.asarray(network.low), np.asarray(network.high)
    moved = tuple(s for s in _inputs_used(network) if high[s] > low[s])
    return moved, overshoot_decay(network)


def report_outputs(
    network: Network,
    outputs: Float[np.ndarray, "*rows time outputs"],
    inputs: Float[np.ndarray, "*rows time inputs"] | None = None,
) -> tuple[
    Float[np.ndarray, "*rows time outputs"], Bool[np.ndarray, "*rows time outputs"]
]:
    """Report computed outputs (physical units), and where they were held.

    Without `inputs` they count as inside their ranges; host only.
    """
    if network.hold is None:
        return outputs, np.zeros(outputs.shape, bool)
    low, high = reported_range(network)
    if inputs is not None:
        own = np.array(network.signals)[: len(network.modelled)]
        width = (np.asarray(network.high) - np.asarray(network.low))[own]
        wider = overshoots(network, inputs)[..., None] * width
        low, high = low - wider, high + wider
    return np.clip(outputs, low, high), (outputs < low) | (outputs > high)


def overshoots(
    network: Network, inputs: Float[np.ndarray, "*rows time inputs"]
) -> Float[np.ndarray, "*rows time"]:
    """`overshoot` of records, on the host; zero where inputs are held."""
    if network.outside == HOLD:
        return np.zeros(inputs.shape[:-1], inputs.dtype)
    at = np.array(_inputs_used(network), int)
    low, high = (np.asarray(a)[at] for a in (network.low, network.high))
    width = np.where(high > low, high - low, np.inf)
    inputs, rate = inputs[..., at], overshoot_decay(network)
    beyond = np.maximum(low - inputs, inputs - high) / width
    beyond = beyond.max(axis=-1, initial=0.0)
    if not beyond.any():
        return beyond
    # On the host: a program for every number of records would take longer.
    fade = np.frompyfunc(lambda before, now: max(now, rate * before), 2, 1)
    return fade.accumulate(beyond, axis=-1, dtype=object).astype(inputs.dtype)


def overshoot(
    network: Network, inputs: Float[Array, "time inputs"], rate: Any
) -> Float[Array, " time"]:
    """The distance by which an input in use has been beyond its range, in widths of
    that range, fading at the `rate` of the network's memory (`overshoot_decay`). Can be
    traced.
    """
    beyond = beyond_range(network, inputs)

    def fade(before, now):
        over = later_overshoot(now, before, rate)
        return over, over

    return jax.lax.scan(fade, jnp.zeros((), beyond.dtype), beyond)[1]


def later_overshoot(now: Array, before: Array, rate: Any) -> Array:
    """The overshoot a sample later."""
    return jnp.where(now > rate * before, now, rate * before)


def beyond_range(
    network: Network, inputs: Float[Array, "*rows inputs"]
) -> Float[Array, "*rows"]:
    """The largest distance of an input in use beyond its range, in widths of that
    range; zero within, and of inputs that were constant in training. At the edge, where
    a constant input always is, its slope is zero."""
    at = np.array(_inputs_used(network), int)
    low, high = network.low[at], network.high[at]
    moved = high > low
    width = jnp.where(moved, high - low, jnp.inf)
    values = inputs[..., at]
    lead = (1,) * (values.ndim - 1)
    low, high, width = (a.reshape(*lead, -1) for a in (low, high, width))
    below, above = low - values, values - high
    beyond = jnp.where(below > 0, below, jnp.where(above > 0, above, 0.0)) / width
    return jnp.max(beyond, axis=-1, initial=0.0)


def overshoot_decay(network: Network) -> Any:
    """Share of an overshoot that remains one sample later; can be traced."""
    memory = input_memory(network)
    if isinstance(memory, Tracer):
        return jnp.exp(-1.0 / memory)
    return math.exp(-1.0 / memory)


def _inputs_used(network: Network) -> tuple[int, ...]:
    inputs = range(len(network.channels.inputs))
    return tuple(s for s in network.used if s in inputs)


def within_margin(
    network: Network,
    outputs: Float[Array, "*rows outputs"],
    overshoots: Float[Array, "*rows"],
) -> Float[Array, "*rows outputs"]:
    """Computed outputs (physical units) held to their ranges, at these overshoots of
    the inputs; as `report_outputs`, and can be traced."""
    if network.hold is None:
        return outputs
    own = np.array(network.signals)[: len(network.modelled)]
    low, high = network.low[own], network.high[own]
    lead = (1,) * (outputs.ndim - 1)
    low, high = low.reshape(*lead, -1), high.reshape(*lead, -1)
    wider = (network.hold + overshoots[..., None]) * (high - low)
    return jnp.clip(outputs, low - wider, high + wider)


def held_inputs(network: Network, batch: Batch) -> Batch:
    """The records as the network sees them, on the host: see `Network.hold_inputs`."""
    if network.plain:
        return batch
    signals = hold_signals(network, np.asarray(batch.signals))
    return Batch(jax.device_put(signals), batch.valid)


def hold_signals(
    network: Network, signals: Float[np.ndarray, "*rows signals"]
) -> Float[np.ndarray, "*rows signals"]:
    """Hold inputs to their trained ranges on the host, see `Network.hold_inputs`."""
    if network.plain:
        return signals
    signals, inputs = np.array(signals), len(network.channels.inputs)
    low, high = (np.asarray(a)[:inputs] for a in (network.low, network.high))
    signals[..., :inputs] = np.clip(signals[..., :inputs], low, high)
    return signals
