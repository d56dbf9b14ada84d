"""What physics says of a network: signs of gains at rest, and how slow it is.

Time constants are those of what the recursion carries (past outputs, hidden channels,
feedback of local models), linearised at rest, and of the filters that inputs pass.
Delayed inputs have none.
"""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import program
from jaxnarx.data import Dataset
from jaxnarx.evaluation.gain_signs import (
    FLAT_RANGE_SHARE,
    MOST_POINTS,
    outputs_at_rest,
)
from jaxnarx.evaluation.section import Section
from jaxnarx.formatting import count, list_names
from jaxnarx.models import (
    Network,
    StateForm,
    carried,
    driving_signals,
    filter_poles,
    make_pairs,
    ranges,
    split_outputs,
)
from jaxnarx.settings import Physics, require_physics
from jaxnarx.simulation import match_records

TIME_CONSTANT_SLACK = 1.01
"""Share of the longest time constant that physics allows up to which one is not longer:
those of filters are rounded."""


class WrongSigns(NamedTuple):
    """Gains of one output whose sign physics asks."""

    wrong: int
    """Those with the other sign."""
    known: int
    """All, where the network comes to rest."""


@guard_arguments
def count_wrong_signs(
    network: Network,
    data: Dataset,
    physics: Mapping[str, Physics],
    *,
    points: int = MOST_POINTS,
) -> dict[str, WrongSigns]:
    """Count gains at rest that have another sign than physics asks.

    Args:
        network: The model.
        data: Records; operating points are their samples, spread evenly.
        physics: Signs by output; outputs that the network does not model are left out.
        points: Operating points at which every gain is looked at.

    Returns:
        The numbers of wrong and of known gains by output, over inputs that move in
        these records. A gain is wrong where the
        output moves the other way by more than `FLAT_RANGE_SHARE` of its trained range
        for the whole range of the input; it is known where the network comes to rest
        on both sides of the point.

    Example:
        known = {"y": jnx.identification.Physics(increases_with=["a"])}
        print(jnx.evaluation.count_wrong_signs(network, data, known))
    """
    require_physics(physics, data.channels.input_names, data.channels.output_names)
    data = match_records(network, data)
    wide = np.asarray(network.high - network.low, float)
    wide = np.where(wide > 0, wide, 1.0)
    out = {}
    for o, name in enumerate(network.output_names):
        if name not in physics:
            continue
        asked = _asked_here(data, physics[name])
        if asked is None:
            out[name] = WrongSigns(0, 0)
            continue
        pairs = make_pairs(data, asked, output=name, points=points)
        both = np.concatenate([pairs.low, pairs.high])
        ends = outputs_at_rest(network, data, both)[:, o].reshape(2, -1)
        rise = (ends[1] - ends[0]) / wide[network.signals[o]]
        inputs = wide[: both.shape[1]]
        step = np.abs((pairs.high - pairs.low) / inputs).sum(axis=1)
        known = np.isfinite(rise)
        wrong = known & (rise < -FLAT_RANGE_SHARE * step)
        out[name] = WrongSigns(int(wrong.sum()), int(known.sum()))
    return out


@guard_arguments
def longest_time_constants(
    network: Network, data: Dataset, *, points: int = MOST_POINTS
) -> dict[str, float]:
    """The longest time constant of every output's answers [s].

    Args:
        network: The model.
        data: Records; operating points are their samples, spread evenly, at which the
            network is linearised at rest.
        points: Operating points.

    Returns:
        By output: -T / log r for the largest modulus r of the poles of what the
        recursion carries, at any operating point, or that of its slowest filter where
        this is longer. Infinite where it is unstable at rest, zero without a memory but
        delayed inputs, NaN where no point of rest is found. Outputs of which one looks
        at the other have theirs in common.

    Example:
        print(jnx.evaluation.longest_time_constants(network, data))
    """
    data, out = match_records(network, data), {}
    for part in split_outputs(network):
        # Beyond its bounds a run would stand still, and be quick.
        own = _unbounded(part.network)
        slow = [-1 / pole.real for pole in filter_poles(own)]
        if carried(own).any():
            u, y = _operating_points(own, data, points)
            found = _slowest_loop(own, u, y) if len(u) else float("nan")
            slow.append(found * float(own.sample_time))
        longest = float(np.max(slow, initial=0.0))
        out |= dict.fromkeys(own.output_names, longest)
    return {name: out[name] for name in network.output_names}


def _unbounded(network: Network) -> Network:
    """The network without bounds, but of what saturates by its kind."""
    keeps = jnp.asarray(network.saturates)
    lower = jnp.where(keeps, network.lower, -jnp.inf)
    upper = jnp.where(keeps, network.upper, jnp.inf)
    return dataclasses.replace(network, lower=lower, upper=upper, hold=None)


def _operating_points(
    network: Network, data: Dataset, points: int
) -> tuple[Float[np.ndarray, "points driving"], Float[np.ndarray, "points outputs"]]:
    """Measured inputs, evenly spread, and the outputs there; where these were not
    measured the middle of their range."""
    driving = np.array(driving_signals(network), int)
    outputs = np.array(network.signals)[: len(network.modelled)]
    rows, there = (
        np.concatenate([getattr(r, name) for r in data])
        for name in ("signals", "valid")
    )
    good = there[:, driving].all(axis=1)
    rows, there = rows[good].astype(float), there[good]
    at = np.unique(np.linspace(0, len(rows) - 1, min(points, len(rows))).astype(int))
    low, high = (np.asarray(e, float)[outputs] for e in (network.low, network.high))
    known = there[at][:, outputs]
    y = np.where(known, rows[at][:, outputs], (low + high)[None] / 2)
    return rows[at][:, driving], y


def _slowest_loop(
    network: Network,
    u: Float[np.ndarray, "points driving"],
    y: Float[np.ndarray, "points outputs"],
) -> float:
    """The longest time constant of the recursion [samples]."""
    kind = network.gain.dtype
    found = _linearise(network, u.astype(kind), y.astype(kind))
    jacobians, settled = (np.asarray(a) for a in found)
    settled = settled & np.isfinite(jacobians).all(axis=(1, 2))
    if not settled.any():
        return float("nan")
    modulus = float(np.abs(np.linalg.eigvals(jacobians[settled])).max())
    if modulus >= 1:
        return float("inf")
    return -1 / float(np.log(modulus)) if modulus > 0 else 0.0


@program
def _linearise(
    network: Network,
    u: Float[jax.Array, "points driving"],
    y: Float[jax.Array, "points outputs"],
) -> tuple:
    """Jacobians of what the recursion carries, at rest near these outputs, and whether
    that was found."""
    form, at = StateForm(network), np.flatnonzero(carried(network))

    def point(row, outputs):
        x, settled = form.equilibrium(row, outputs)
        return form.jacobians(x, row)[0][np.ix_(at, at)], settled

    return jax.vmap(point)(u, y)


def section_of_physics(
    network: Network, data: Dataset, physics: Mapping[str, Physics]
) -> Section | None:
    """Compare a network with what physics asks of its outputs; None where
    nothing is asked of them."""
    asked = {n: one for n, one in physics.items() if n in network.output_names}
    if not asked:
        return None
    found = count_wrong_signs(network, data, asked)
    slow = {}
    if any(one.longest_time_constant is not None for one in asked.values()):
        slow = longest_time_constants(network, data)
    rows = tuple(
        (n, str(one), *(found[n] if one.signs else (None, None)), slow.get(n))
        for n, one in asked.items()
    )
    told = [
        f"{one.wrong} of {count(one.known, 'gain')} of {name} at rest have another "
        "sign than physics asks."
        for name, one in found.items()
        if one.wrong
    ]
    late = {name: is_slower(slow.get(name), one) for name, one in asked.items()}
    told += [_tell_time_constant(name, slow[name]) for name in asked if late[name]]
    unknown = [n for n, one in found.items() if asked[n].signs and not one.known]
    if unknown:
        told.append(
            f"Of {list_names(unknown)} no gain is known here: nothing that is asked "
            "moves in these records, or the model does not come to rest."
        )
    if not told:
        told = ["Nothing contradicts what physics asks."]
    wrong = tuple((n, 2) for n, row in enumerate(rows) if row[2])
    wrong += tuple((n, 4) for n, name in enumerate(asked) if late[name])
    header = ("output", "asked", "wrong gains", "known gains", "time constant [s]")
    if not slow:
        header, rows = header[:-1], tuple(row[:-1] for row in rows)
    return Section("Physics", tuple(told), header, rows, marked=wrong)


def _tell_time_constant(name: str, slow: float) -> str:
    """Tell what a time constant has against physics."""
    if np.isnan(slow):
        return f"Of {name} no time constant is known: it comes to rest nowhere."
    if np.isinf(slow):
        return f"{name} is unstable at rest at some operating points."
    told = f"The longest time constant of {name} is {slow:.3g} s, longer than"
    return f"{told} physics allows."


def is_slower(found: float | None, physics: Physics) -> bool:
    """Whether a time constant [s] is longer than physics allows; so is one that is not
    known where the network comes to rest nowhere (NaN)."""
    longest = physics.longest_time_constant
    if found is None or longest is None:
        return False
    return not found <= TIME_CONSTANT_SLACK * longest


def _asked_here(data: Dataset, physics: Physics) -> Physics | None:
    """The signs by inputs that move in these records, if there are any."""
    low, high = ranges(data)
    names = data.channels.input_names
    moving = {n for s, n in enumerate(names) if high[s] > low[s]}
    rising, falling = (
        [name for name in names if name in moving]
        for names in (physics.increases_with, physics.decreases_with)
    )
    return Physics(rising, falling) if rising or falling else None
