"""Reported outputs from computed ones, as operations: see `jaxnarx.models.limits`."""

from collections.abc import Mapping

import numpy as np

from jaxnarx.exporters.entrance import Entrance
from jaxnarx.exporters.form import Builder, StateValue, Value
from jaxnarx.models import NAN, Network, overshoot_rule

States = dict[str, StateValue]
OVERSHOOT_NAME = "overshoot"


def limited_outputs(
    b: Builder,
    network: Network,
    entrance: Entrance,
    physical: list[Value],
    flags: Mapping[str, Value],
) -> tuple[list[Value], States]:
    """Reported outputs of computed ones, held to their ranges and silent where the
    network's policies say so, and the states that takes."""
    outputs, states = list(physical), States()
    if network.hold is not None:
        outputs, states = _hold_to_range(b, network, entrance, physical)
    silent = None
    if network.outside == NAN:
        silent = flags["extrapolated"]
    elif network.nan == NAN and network.used:
        silent = entrance.missing
    if silent is not None:
        nothing = b.const(float("nan"))
        outputs = [b.op("where", silent, nothing, y) for y in outputs]
    return outputs, states


def _hold_to_range(
    b: Builder, network: Network, entrance: Entrance, physical: list[Value]
) -> tuple[list[Value], States]:
    """Outputs within their ranges, widened by the margin and the inputs' overshoot."""
    low, high = (np.asarray(a, float) for a in (network.low, network.high))
    over, states = _overshoot(b, network, entrance)
    outputs = []
    for y, s in zip(physical, network.signals, strict=False):
        share = b.add(b.const(float(np.asarray(network.hold))), over)
        wider = b.mul(share, b.const(high[s] - low[s]))
        least = b.op("sub", b.const(low[s]), wider)
        outputs.append(b.clip(y, least, b.add(b.const(high[s]), wider)))
    return outputs, states


def _overshoot(
    b: Builder, network: Network, entrance: Entrance
) -> tuple[Value, States]:
    """The distance by which an input has been beyond its range, fading with the
    memory."""
    moved, rate = overshoot_rule(network)
    if not moved:
        return b.const(0.0), {}
    low, high = (np.asarray(a, float) for a in (network.low, network.high))
    before, none = b.op("state", source=OVERSHOOT_NAME), b.const(0.0)
    found = []
    for s in moved:
        raw, scale = entrance.signal(s), b.const(1 / (high[s] - low[s]))
        least, most = b.const(low[s]), b.const(high[s])
        below = b.mul(b.op("sub", least, raw), scale)
        above = b.mul(b.op("sub", raw, most), scale)
        above = b.op("where", b.op("less", most, raw), above, none)
        found.append(b.op("where", b.op("less", raw, least), below, above))
    now, kept = b.largest(found), b.mul(before, b.const(rate))
    value = b.op("where", b.op("less", kept, now), now, kept)
    return value, {OVERSHOOT_NAME: StateValue(OVERSHOOT_NAME, value, b.const(0.0))}
