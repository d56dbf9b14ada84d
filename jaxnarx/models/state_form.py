"""A network as a state-space model, x(t+1) = f(x(t), u(t)), y(t) = h(x(t), u(t)).

The state x(t) is all that a network remembers before sample t, in physical units: the
last values of the inputs and outputs it looks back at, the states of its filters, the
last values of its hidden channels and of local models with feedback of their own, and,
where its outputs are held to their ranges, by how much the inputs have overshot theirs.
`StateForm.names` tells which entry is which.

All functions here are pure: they can be jitted, mapped and differentiated, by the
network's parameters, by the state and by the inputs.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays.programs import program
from jaxnarx.errors import SpecError
from jaxnarx.guard import guarded
from jaxnarx.models.feedback import advance, depth, sources, widened
from jaxnarx.models.limits import beyond_range, fading, overshoot, within_margin
from jaxnarx.models.network import Network
from jaxnarx.models.observer import hidden_start
from jaxnarx.models.outside import HOLD, LINEAR
from jaxnarx.models.record_run import run_record
from jaxnarx.regressors import (
    AbstractFilter,
    FilterSystem,
    filter_table,
    filter_text,
    system_of,
    variable_name,
)

Arrays = Array | np.ndarray

STEADY, ZEROS = "steady", "zeros"
"""Starts by name: at rest under the first inputs, or with outputs that were zero."""
REST_STEPS, REST_TOLERANCE = 50, 1e-10
"""Newton steps towards a state of rest, and the share of the outputs' size that may be
left."""


class Past(NamedTuple):
    """What a network remembers, by kind; physical units.

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
    """How long a network remembers what: `raw` (signal, lags), `filtered` (signal,
    filter, lags); static."""

    raw: tuple[tuple[int, int], ...]
    filtered: tuple[tuple[int, AbstractFilter, int], ...]

    @property
    def place(self) -> dict[int, int]:
        """Where each signal stands among the raw ones."""
        return {s: n for n, (s, _) in enumerate(self.raw)}


def driving(network: Network) -> tuple[int, ...]:
    """Signals that drive a network: its inputs, then outputs it does not compute but
    looks at. The columns of `u`."""
    inputs = range(len(network.channels.inputs))
    return (*inputs, *(s for s in network.used if s not in inputs))


def memory(network: Network) -> LookedBack:
    """What a network looks back at, static."""
    tables = (network.variables, *(m.scheduling for m in network.models))
    raw = dict.fromkeys(driving(network), 0)
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


def filters_of(network: Network) -> list[FilterSystem]:
    """The filters that a network's inputs pass, as discrete systems."""
    every = [filter_table((f,))[0] for _, f, _ in memory(network).filtered]
    return [system_of(row, jnp.asarray(network.sample_time)) for row in every]


def _moves(filter_: AbstractFilter) -> np.ndarray:
    """Places of the states that move: the second one of a real pole rests."""
    places = [
        2 * n + which
        for n, pole in enumerate(filter_.sections)
        for which in range(2 if complex(pole).imag else 1)
    ]
    return np.array(places, int)


def _loop_gain(network: Network) -> Float[Array, " states"]:
    return network.gain[np.array(network.signals)[sources(network)]]


def _held(network: Network, u: Float[Array, " driving"]) -> Float[Array, " driving"]:
    return network.within(u, np.array(driving(network), int))


def at_rest(
    network: Network, u: Float[Array, " driving"], loop: Float[Array, " states"]
) -> Past:
    """What is remembered after these values have been constant for ever."""
    found = memory(network)
    place, held = found.place, _held(network, u)

    def bank(values):
        rows = []
        for (s, f, lags), system in zip(
            found.filtered, filters_of(network), strict=True
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


def overshoots(network: Network) -> bool:
    """Whether a state tells how far inputs have overshot their ranges."""
    return network.hold is not None and network.outside != HOLD


def _overshoot_at(network: Network, u: Float[Array, " driving"]) -> Array:
    """The overshoot of these inputs; one entry, or none where nothing is held."""
    if not overshoots(network):
        return jnp.zeros((0,), u.dtype)
    return beyond_range(network, u[: len(network.channels.inputs)])[None]


class Fixed(NamedTuple):
    """What all samples of a run share: the filters, and what is left of an overshoot a
    sample later."""

    systems: list[FilterSystem]
    rate: Float[Arrays, ""]


def rate_of(network: Network) -> Float[Arrays, ""]:
    """The share of an overshoot that is left a sample later; one without any."""
    value = fading(network) if overshoots(network) else 1.0
    return jnp.asarray(value, network.gain.dtype)


def advanced(
    network: Network,
    past: Past,
    u: Float[Array, " driving"],
    fixed: Fixed,
    measured: Float[Array, " states"] | None = None,
) -> tuple[Past, Float[Array, " outputs"]]:
    """What is remembered after a sample, and the outputs at it.

    With `measured` (physical) these are remembered in place of what is computed.
    """
    found, held, systems = memory(network), _held(network, u), fixed.systems
    filters, values = _filtered(found, systems, past.filters, held)
    far, beyond = past.far, {}
    if network.outside == LINEAR:
        far, beyond = _filtered(found, systems, past.far, u - held)
    for n, (s, _) in enumerate(found.raw):
        line = jnp.concatenate([u[n : n + 1], past.raw[n]])
        kept = network.within(line[:, None], np.array([s]))[:, 0]
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
    size = _loop_gain(network)
    y = advance(network, jnp.concatenate(v), x, past.loop / size[:, None])
    lower, upper = (widened(network, b) for b in (network.lower, network.upper))
    y = jnp.clip(y, lower, upper) * size
    now = y if measured is None else measured
    over = jnp.maximum(_overshoot_at(network, u), fixed.rate * past.overshoot)
    raw = tuple(
        jnp.concatenate([u[n : n + 1], line])[: len(line)]
        for n, line in enumerate(past.raw)
    )
    loop = jnp.concatenate([now[:, None], past.loop[:, :-1]], axis=1)
    outputs = y[: len(network.modelled)]
    if network.hold is not None:
        outputs = within_margin(network, outputs, over[0] if len(over) else zero)
    return Past(raw, filters, far, loop, over), outputs


def _filtered(
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
    over = take(1 if overshoots(network) else 0)
    return Past(raw, filters, far, loop, over)


def joined(past: Past) -> Float[Array, " states"]:
    """A state as one vector."""
    return jnp.concatenate([leaf.reshape(-1) for leaf in jax.tree.leaves(past)])


def state_names(network: Network) -> list[str]:
    """What each entry of a state is, as `speed[t-1]`."""
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
    return names + ["overshoot"] * overshoots(network)


# runs of plain arrays -------------------------------------------------------------


def step(
    network: Network, x: Float[Arrays, " states"], u: Float[Arrays, " driving"]
) -> tuple[Float[Array, " states"], Float[Array, " outputs"]]:
    """The next state and the outputs; see `Network.step`."""
    return _step(network, jnp.asarray(x), _row(network, u), rate_of(network))


@program
def _step(network: Network, x: Array, u: Array, rate: Array) -> tuple[Array, Array]:
    past, y = advanced(network, split(network, x), u, _fixed(network, rate))
    return joined(past), y


def init(network: Network, start: Any, u: Any) -> Float[Array, " states"]:
    """The state before the first sample that is computed; see `Network.init`."""
    if isinstance(start, str):
        row = _middle(network) if u is None else jnp.atleast_2d(u)[0]
        row = _row(network, row)
        if start == ZEROS:
            return _at_zero(network, row)
        if start == STEADY:
            return equilibrium(network, row, None)[0]
        raise SpecError(
            f"start must be measured outputs, a state, {STEADY!r} or {ZEROS!r}, got "
            f"{start!r}",
            field="start",
        )
    start = _measured(network, start)
    if u is None:
        u = jnp.broadcast_to(_middle(network), (len(start), len(driving(network))))
    u = _rows(network, u)
    if len(u) != len(start):
        raise SpecError(
            f"start has {len(start)} samples, u {len(u)}: give the inputs of the same "
            "samples",
            field="u",
        )
    return _behind(network, start, u, rate_of(network))


@program
def _at_zero(network: Network, row: Array) -> Array:
    return joined(at_rest(network, row, jnp.zeros(len(sources(network)), row.dtype)))


@program
def _behind(network: Network, start: Array, u: Array, rate: Array) -> Array:
    """The state behind measured samples; hidden channels are those that fit the window
    behind the history best, and what follows from them through the window."""
    fixed, at, y = _fixed(network, rate), len(u), start
    if network.hidden:
        signals, y, _, known = _record(network, u, start)
        v, x = network.columns(signals)
        size, at = network.gain[np.array(network.signals)], network.history
        lags, count = depth(network), len(network.modelled)
        scaled, begin = y / size[None], jnp.asarray(at)
        found, _ = hidden_start(network, v, x, scaled, known, begin)
        y = y.at[at - lags : at, count:].set(found * size[None, count:])
    loop = y[:, sources(network)]

    def measured(past, row):
        return advanced(network, past, row[0], fixed, row[1])[0], None

    def free(past, row):
        return advanced(network, past, row, fixed)[0], None

    past = at_rest(network, u[0], loop[0])
    past = jax.lax.scan(measured, past, (u[:at], loop[:at]))[0]
    return joined(jax.lax.scan(free, past, u[at:])[0])


def run(
    network: Network, u: Float[Arrays, "time driving"], start: Any
) -> Float[Array, "time outputs"]:
    """The free run of one record of plain arrays; see `Network.__call__`."""
    u, rate = _rows(network, u), rate_of(network)
    if isinstance(start, str):
        return _run_on(network, init(network, start, u), u, rate)
    start = jnp.asarray(start)
    if start.ndim == 1:
        return _run_on(network, start, u, rate)
    return _run_behind(network, u, _measured(network, start), rate)


@program
def _run_on(network: Network, x: Array, u: Array, rate: Array) -> Array:
    fixed = _fixed(network, rate)

    def take(past, row):
        return advanced(network, past, row, fixed)

    return jax.lax.scan(take, split(network, x), u)[1]


@program
def _run_behind(network: Network, u: Array, start: Array, rate: Array) -> Array:
    """A run behind measured outputs, of which the first `network.history` rows count,
    and of a network with hidden channels those of its window."""
    signals, y, anchor, known = _record(network, u, start)
    v, x = network.columns(signals)
    size = network.gain[np.array(network.signals)]
    measured = y / size[None]
    if network.hidden:
        at, lags, count = network.history, depth(network), len(network.modelled)
        begin = jnp.asarray(at)
        found, _ = hidden_start(network, v, x, measured, known, begin)
        measured = measured.at[at - lags : at, count:].set(found)
    scaled = run_record(network, v, x, measured, anchor)
    outputs = (scaled * size[None])[:, : len(network.modelled)]
    if network.hold is not None:
        over = jnp.zeros(len(u), u.dtype)
        if overshoots(network):
            inputs = u[:, : len(network.channels.inputs)]
            over = overshoot(network, inputs, rate)
        outputs = within_margin(network, outputs, over)
    begun = jnp.arange(len(u)) < network.before
    return jnp.where(begun[:, None], y[:, : len(network.modelled)], outputs)


def _fixed(network: Network, rate: Array) -> Fixed:
    return Fixed(filters_of(network), rate)


def _record(network: Network, u: Array, start: Array):
    """Signals (time, measured), outputs (time, computed), anchor and what is known, of
    a record that is measured at its start alone."""
    need, time = network.before, len(u)
    if len(start) < need:
        raise SpecError(
            f"start has {len(start)} samples of the outputs, the network needs {need}",
            field="start",
        )
    rows = start[: min(len(start), time)]
    y = jnp.pad(rows, ((0, time - len(rows)), (0, 0)), mode="edge")
    signals = jnp.zeros((time, len(network.channels.measured.all)), u.dtype)
    signals = signals.at[:, np.array(network.signals)[: len(network.modelled)]].set(y)
    signals = signals.at[:, np.array(driving(network), int)].set(u)
    y = jnp.pad(y, ((0, 0), (0, network.hidden)))
    at = jnp.arange(time)
    known = jnp.broadcast_to((at < need)[:, None], y.shape)
    return signals, y, at == network.history, known


def equilibrium(
    network: Network, u: Float[Arrays, " driving"], start: Any
) -> tuple[Float[Array, " states"], Bool[Array, ""]]:
    """The state of rest under constant inputs; see `StateForm.equilibrium`."""
    middle = 0.5 * (network.low + network.high)
    if start is not None:
        outputs = np.array(network.signals)[: len(network.modelled)]
        middle = middle.at[outputs].set(jnp.asarray(start, middle.dtype))
    begin = middle[np.array(network.signals)[sources(network)]]
    return _rest(network, _row(network, u), begin, rate_of(network))


@program
def _rest(
    network: Network, row: Array, begin: Array, rate: Array
) -> tuple[Array, Array]:
    size, fixed = _loop_gain(network), _fixed(network, rate)

    def moved(z, _):
        past = at_rest(network, row, z * size)
        return advanced(network, past, row, fixed)[0].loop[:, 0] / size - z

    solver = optimistix.Newton(rtol=REST_TOLERANCE, atol=REST_TOLERANCE)
    found = optimistix.root_find(
        moved, solver, begin / size, max_steps=REST_STEPS, throw=False
    )
    good = found.result == optimistix.RESULTS.successful
    return joined(at_rest(network, row, found.value * size)), good


@program
def _jacobians(network: Network, x: Array, u: Array, rate: Array) -> tuple:
    def both(x, u):
        past, y = advanced(network, split(network, x), u, _fixed(network, rate))
        return joined(past), y

    (a, c), (b, d) = jax.jacfwd(both)(x, u), jax.jacfwd(both, argnums=1)(x, u)
    return a, b, c, d


class StateForm(eqx.Module):
    """A network as x(t+1) = f(x(t), u(t)), y(t) = h(x(t), u(t)).

    Inputs and outputs in physical units, `u` with the columns `inputs`, states named by
    `names`. Every method can be jitted, mapped and differentiated. Where an output is
    held by its bound, its slope is zero.

    Example:
        form = jnx.state_space(network)
        x, settled = form.equilibrium(u[0])
        a, b, c, d = form.jacobians(x, u[0])
    """

    network: Network

    @property
    def names(self) -> list[str]:
        """What each entry of the state is: `speed[t-1]`."""
        return state_names(self.network)

    @property
    def inputs(self) -> list[str]:
        """Names of the columns of `u`."""
        names = self.network.channels.names
        return [names[s] for s in driving(self.network)]

    @property
    def outputs(self) -> list[str]:
        """Names of the entries of y."""
        return self.network.output_names

    def f(
        self, x: Float[Arrays, " states"], u: Float[Arrays, " inputs"]
    ) -> Float[Array, " states"]:
        """The next state."""
        return step(self.network, x, u)[0]

    def h(
        self, x: Float[Arrays, " states"], u: Float[Arrays, " inputs"]
    ) -> Float[Array, " outputs"]:
        """The outputs."""
        return step(self.network, x, u)[1]

    def jacobians(
        self, x: Float[Arrays, " states"], u: Float[Arrays, " inputs"]
    ) -> tuple[Array, Array, Array, Array]:
        """A = df/dx, B = df/du, C = dh/dx and D = dh/du there."""
        return _jacobians(
            self.network, jnp.asarray(x), _row(self.network, u), rate_of(self.network)
        )

    def equilibrium(
        self,
        u: Float[Arrays, " inputs"],
        start: Float[Arrays, " outputs"] | None = None,
    ) -> tuple[Float[Array, " states"], Bool[Array, ""]]:
        """A state of rest under constant inputs, x = f(x, u), and whether it was found.

        By Newton's method on the outputs from `start`, by default the middle of their
        trained ranges; where there are several, the one that leads to. Differentiable
        by the implicit function theorem (`optimistix.root_find`).
        """
        return equilibrium(self.network, u, start)


@guarded
def state_space(network: Network) -> StateForm:
    """The network as a state-space model with named states.

    Args:
        network: The model.

    Returns:
        Its `StateForm`: f, h, Jacobians and states of rest, all traceable.

    Example:
        form = jnx.state_space(network)
        print(form.names)
    """
    return StateForm(network)


def _middle(network: Network) -> Float[Array, " driving"]:
    at = np.array(driving(network), int)
    return (0.5 * (network.low + network.high))[at]


def _row(network: Network, u: Any) -> Float[Array, " driving"]:
    u = jnp.asarray(u)
    return _rows(network, u[None])[0]


def _rows(network: Network, u: Any) -> Float[Array, "time driving"]:
    u, columns = jnp.asarray(u), driving(network)
    if u.ndim != 2 or u.shape[1] != len(columns):
        names = [network.channels.names[s] for s in columns]
        raise SpecError(
            f"u must have a column for each of {', '.join(names)}, got the shape "
            f"{u.shape}",
            field="u",
        )
    return u.astype(network.gain.dtype)


def _measured(network: Network, start: Any) -> Float[Array, "time outputs"]:
    start = jnp.asarray(start)
    if start.ndim != 2 or start.shape[1] != len(network.modelled):
        raise SpecError(
            f"start must have a column for each of {', '.join(network.output_names)}, "
            f"got the shape {start.shape}",
            field="start",
        )
    return start.astype(network.gain.dtype)
