"""The state of a network: all that it remembers before a sample, and how it moves on.

In physical units: the last values of the inputs and outputs a network looks back at,
the states of its filters, the last values of its hidden channels and of local models
with feedback of their own, and, where its outputs are held to their ranges, by how much
the inputs have overshot theirs. `state_names` tells which entry is which. Pure
functions; `jaxnarx.models.state_form` runs and linearises networks by them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.errors import SpecError
from jaxnarx.models.feedback import advance, depth, sources, widen
from jaxnarx.models.limits import (
    beyond_range,
    later_overshoot,
    overshoot_decay,
    within_margin,
)
from jaxnarx.models.network import Network
from jaxnarx.models.outside import HOLD, LINEAR
from jaxnarx.regressors import (
    AbstractFilter,
    FilterSystem,
    filter_table,
    filter_text,
    system_of,
    variable_name,
)

Arrays = Array | np.ndarray


class Past(NamedTuple):
    """All that a network remembers, by kind; physical units.

    `raw` has the last values of each signal it is driven by, newest first; `filters`
    the state of each filter and the earlier values of its output; of a network that
    goes on to first order beyond its ranges, `far` the same for how far the inputs have
    been beyond them. `loop` has the last values of all that the recursion carries.
    """

    raw: tuple[Float[Array, " lags"], ...]
    filters: tuple[tuple[Float[Array, " states"], Float[Array, " lags"]], ...]
    far: tuple[tuple[Float[Array, " states"], Float[Array, " lags"]], ...]
    loop: Float[Array, "states depth"]
    overshoot: Float[Array, " one"]


class LookedBack(NamedTuple):
    """The memory of a network: `raw` (signal, lags), `filtered` (signal, filter, lags);
    static."""

    raw: tuple[tuple[int, int], ...]
    filtered: tuple[tuple[int, AbstractFilter, int], ...]

    @property
    def place(self) -> dict[int, int]:
        """The place of each signal among the raw ones."""
        return {s: n for n, (s, _) in enumerate(self.raw)}


def driving_signals(network: Network) -> tuple[int, ...]:
    """Signals that drive a network: its inputs, then outputs it does not compute but
    looks at. The columns of `u`."""
    inputs = range(len(network.channels.inputs))
    return (*inputs, *(s for s in network.used if s not in inputs))


def require_computed(network: Network, field: str) -> None:
    """SpecError where the network looks at outputs that it does not compute."""
    inputs = len(network.channels.inputs)
    foreign = [s for s in driving_signals(network) if s >= inputs]
    if foreign:
        names = ", ".join(network.channels.names[s] for s in foreign)
        raise SpecError(
            f"the network looks at {names}, which it does not compute: nobody knows "
            "what they are under other inputs",
            field=field,
        )


def memory(network: Network) -> LookedBack:
    """The memory that a network needs of each signal, static."""
    tables = (network.variables, *(m.scheduling for m in network.models))
    raw = dict.fromkeys(driving_signals(network), 0)
    filtered: dict[tuple[int, AbstractFilter], int] = {}
    for table in tables:
        for s, lag, filter_ in table.entries:
            if s in network.signals:
                continue
            if filter_ is None:
                raw[s] = max(raw[s], lag)
            else:
                filtered[s, filter_] = max(filtered.get((s, filter_), 0), lag)
    return LookedBack(
        tuple(raw.items()), tuple((s, f, lag) for (s, f), lag in filtered.items())
    )


def discrete_filters(network: Network) -> list[FilterSystem]:
    """The filters that a network's inputs pass, as discrete systems."""
    every = [filter_table((f,))[0] for _, f, _ in memory(network).filtered]
    return [system_of(row, jnp.asarray(network.sample_time)) for row in every]


def filter_poles(network: Network) -> list[complex]:
    """Poles [1/s] of the filters that a network's inputs pass."""
    return [pole for _, f, _ in memory(network).filtered for pole in f.sections]


def _moves(filter_: AbstractFilter) -> np.ndarray:
    """Places of the states that move: the second one of a real pole rests."""
    places = [
        2 * n + which
        for n, pole in enumerate(filter_.sections)
        for which in range(2 if complex(pole).imag else 1)
    ]
    return np.array(places, int)


def loop_gain(network: Network) -> Float[Array, " states"]:
    """The gain of each entry of the loop's state."""
    return network.gain[np.array(network.signals)[sources(network)]]


def _hold_inputs(
    network: Network, u: Float[Array, " driving_signals"]
) -> Float[Array, " driving_signals"]:
    return network.hold_inputs(u, np.array(driving_signals(network), int))


def rest_memory(
    network: Network, u: Float[Array, " driving_signals"], loop: Float[Array, " states"]
) -> Past:
    """The memory after these values have been constant for ever."""
    found = memory(network)
    place, held = found.place, _hold_inputs(network, u)

    def bank(values):
        rows = []
        for (s, f, lags), system in zip(
            found.filtered, discrete_filters(network), strict=True
        ):
            state = system.rest * values[place[s]]
            rows.append(
                (
                    state[_moves(f)],
                    jnp.broadcast_to(jnp.sum(system.c * state), (max(lags - 1, 0),)),
                )
            )
        return tuple(rows)

    raw = tuple(jnp.broadcast_to(u[place[s]], (lags,)) for s, lags in found.raw)
    past = jnp.broadcast_to(loop[:, None], (len(loop), depth(network)))
    far = bank(u - held) if network.outside == LINEAR else ()
    return Past(raw, bank(held), far, past, _overshoot_at(network, u))


def has_overshoot(network: Network) -> bool:
    """Whether a state tells how far inputs have overshot their ranges."""
    return network.hold is not None and network.outside != HOLD


def _overshoot_at(network: Network, u: Float[Array, " driving_signals"]) -> Array:
    """The overshoot of these inputs; one entry, or none where nothing is held."""
    if not has_overshoot(network):
        return jnp.zeros((0,), u.dtype)
    return beyond_range(network, u[: len(network.channels.inputs)])[None]


class Fixed(NamedTuple):
    """The filters, and the share of an overshoot that is left a sample later: all
    samples of a run have them in common."""

    systems: list[FilterSystem]
    rate: Float[Arrays, ""]


def decay_rate(network: Network) -> Float[Arrays, ""]:
    """The share of an overshoot that is left a sample later; one without any."""
    value = overshoot_decay(network) if has_overshoot(network) else 1.0
    return jnp.asarray(value, network.gain.dtype)


def advance_memory(
    network: Network,
    past: Past,
    u: Float[Array, " driving_signals"],
    fixed: Fixed,
    measured: Float[Array, " states"] | None = None,
) -> tuple[Past, Float[Array, " outputs"]]:
    """The memory after a sample, and the outputs at it.

    With `measured` (physical) these are remembered in place of what is computed.
    """
    found, held, systems = memory(network), _hold_inputs(network, u), fixed.systems
    filters, values = _advance_filters(found, systems, past.filters, held)
    far, beyond = past.far, {}
    if network.outside == LINEAR:
        far, beyond = _advance_filters(found, systems, past.far, u - held)
    for n, (s, _) in enumerate(found.raw):
        line = jnp.concatenate([u[n : n + 1], past.raw[n]])
        kept = network.hold_inputs(line[:, None], np.array([s]))[:, 0]
        for lag in range(len(line)):
            values[s, lag, None] = kept[lag]
            beyond[s, lag, None] = line[lag] - kept[lag]
    zero = jnp.zeros((), u.dtype)

    def table(variables, source):
        rows = [source.get(entry, zero) for entry in variables.entries]
        return jnp.stack(rows) if rows else jnp.zeros((0,), u.dtype)

    gain = network.gain[network.variables.signal] if len(network.variables) else 1.0
    v = [jnp.ones((1,), u.dtype), table(network.variables, values) / gain]
    if network.outside == LINEAR:
        v.append(table(network.variables, beyond) / gain)
    x = tuple(table(m.scheduling, values) for m in network.models)
    size = loop_gain(network)
    y = advance(network, jnp.concatenate(v), x, past.loop / size[:, None])
    lower, upper = (widen(network, b) for b in (network.lower, network.upper))
    y = jnp.clip(y, lower, upper) * size
    now = y if measured is None else measured
    over = later_overshoot(_overshoot_at(network, u), past.overshoot, fixed.rate)
    raw = tuple(
        jnp.concatenate([u[n : n + 1], line])[: len(line)]
        for n, line in enumerate(past.raw)
    )
    loop = jnp.concatenate([now[:, None], past.loop[:, :-1]], axis=1)
    outputs = y[: len(network.modelled)]
    if network.hold is not None:
        outputs = within_margin(network, outputs, over[0] if len(over) else zero)
    return Past(raw, filters, far, loop, over), outputs


def _advance_filters(
    found: LookedBack, systems: list[FilterSystem], bank: tuple, values: Array
) -> tuple[tuple, dict]:
    """Filters with these values taken in; their outputs by (signal, lag, filter)."""
    rows, seen, place = [], {}, found.place
    for (s, f, lags), system, (state, line) in zip(
        found.filtered, systems, bank, strict=True
    ):
        at = _moves(f)
        whole = jnp.zeros(system.b.shape, state.dtype).at[at].set(state)
        new, y = system.step(whole, values[place[s]])
        outputs = jnp.concatenate([y[None], jnp.sum(system.c * whole)[None], line])
        seen |= {(s, lag, f): outputs[lag] for lag in range(lags + 1)}
        rows.append((new[at], outputs[1 : 1 + len(line)]))
    return tuple(rows), seen


def split(network: Network, x: Float[Array, " states"]) -> Past:
    """The entries of a state by kind."""
    found, size = memory(network), len(state_names(network))
    if x.shape != (size,):
        raise SpecError(
            f"the state has the shape {x.shape}, that of this network {size} entries; "
            "make it with network.init",
            field="state",
        )
    ends = [0]

    def take(size: int) -> Array:
        ends.append(ends[-1] + size)
        return x[ends[-2] : ends[-1]]

    def bank():
        return tuple(
            (take(len(_moves(f))), take(max(lags - 1, 0)))
            for _, f, lags in found.filtered
        )

    raw = tuple(take(lags) for _, lags in found.raw)
    filters = bank()
    far = bank() if network.outside == LINEAR else ()
    shape = len(sources(network)), depth(network)
    loop = take(shape[0] * shape[1]).reshape(shape)
    over = take(1 if has_overshoot(network) else 0)
    return Past(raw, filters, far, loop, over)


def state_sizes(network: Network) -> Float[Array, " states"]:
    """Half of what every entry of the state has ranged over in training; one where it
    has not moved."""
    own = np.array(network.signals)[sources(network)]
    at = np.array(driving_signals(network), int)
    ends = [
        join_state(rest_memory(network, side[at], side[own]))
        for side in (network.low, network.high)
    ]
    wide = jnp.abs(ends[1] - ends[0]) / 2
    return jnp.where(wide > 0, wide, 1.0)


def carried(network: Network) -> Bool[np.ndarray, " states"]:
    """Which entries of the state the recursion carries: past outputs, hidden channels
    and feedback of local models. All others follow from the inputs."""
    size, over = len(state_names(network)), int(has_overshoot(network))
    own = len(sources(network)) * depth(network)
    at = np.arange(size)
    return (at >= size - over - own) & (at < size - over)


def remember_outputs(
    network: Network, x: Float[Array, " states"], y: Float[Array, " outputs"]
) -> Float[Array, " states"]:
    """The state after outputs that have been constant, under inputs as they were; of a
    network that carries nothing else."""
    return x.at[np.flatnonzero(carried(network))].set(jnp.repeat(y, depth(network)))


def join_state(past: Past) -> Float[Array, " states"]:
    """A state as one vector."""
    return jnp.concatenate([leaf.reshape(-1) for leaf in jax.tree.leaves(past)])


def state_names(network: Network) -> list[str]:
    """A name for each entry of a state, as `speed[t-1]`."""
    found, channels = memory(network), network.channels
    rows = [(s, d + 1) for s, lags in found.raw for d in range(lags)]
    names = [variable_name(channels, *row) for row in rows]
    banks = [""] + [" beyond the range"] * (network.outside == LINEAR)
    for suffix in banks:
        for s, f, lags in found.filtered:
            text = filter_text(f, channels.names[s])
            own = [f"{text} state {n + 1}" for n in range(len(_moves(f)))]
            own += [variable_name(channels, s, d, f) for d in range(2, lags + 1)]
            names += [name + suffix for name in own]
    groups: dict[int, int] = {}
    for n, o in enumerate(sources(network).tolist()):
        name = network.computed_names[o]
        if n >= len(network.models):
            groups[o] = groups.get(o, 0) + 1
            name = f"{name}_{groups[o]}"
        names += [f"{name}[t-{d + 1}]" for d in range(depth(network))]
    return names + ["overshoot"] * has_overshoot(network)


def make_fixed(network: Network, rate: Array) -> Fixed:
    """All that the samples of a run share, see `Fixed`."""
    return Fixed(discrete_filters(network), rate)
