"""A network as a state-space model, x(t+1) = f(x(t), u(t)), y(t) = h(x(t), u(t)).

The state is that of `jaxnarx.models.state`; `StateForm.names` tells what is in it.
All functions here are pure: they can be jitted, mapped and differentiated, by the
network's parameters, by the state and by the inputs.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import program
from jaxnarx.errors import SpecError
from jaxnarx.models.feedback import sources
from jaxnarx.models.limits import overshoot, within_margin
from jaxnarx.models.network import Network
from jaxnarx.models.observer import with_hidden_start
from jaxnarx.models.record_run import run_record
from jaxnarx.models.state import (
    advance_memory,
    decay_rate,
    driving_signals,
    has_overshoot,
    join_state,
    loop_gain,
    make_fixed,
    rest_memory,
    split,
    state_names,
)

Arrays = Array | np.ndarray

STEADY, ZEROS = "steady", "zeros"
"""Starts by name: at rest under the first inputs, or with outputs that were zero."""
REST_STEPS, REST_TOLERANCE = 50, 1e-10
"""Newton steps towards a state of rest, and the share of the outputs' size that may be
left."""


# runs of plain arrays -------------------------------------------------------------


def step(
    network: Network, x: Float[Arrays, " states"], u: Float[Arrays, " driving_signals"]
) -> tuple[Float[Array, " states"], Float[Array, " outputs"]]:
    """The next state and the outputs; see `Network.step`."""
    return _step(network, jnp.asarray(x), _row(network, u), decay_rate(network))


@program
def _step(network: Network, x: Array, u: Array, rate: Array) -> tuple[Array, Array]:
    past, y = advance_memory(network, split(network, x), u, make_fixed(network, rate))
    return join_state(past), y


def init(network: Network, start: Any, u: Any) -> Float[Array, " states"]:
    """The state before the first sample that is computed; see `Network.init`."""
    if isinstance(start, str):
        row = middle_inputs(network) if u is None else jnp.atleast_2d(u)[0]
        row = _row(network, row)
        if start == ZEROS:
            return _zero_memory(network, row)
        if start == STEADY:
            return equilibrium(network, row, None)[0]
        raise SpecError(
            f"start must be measured outputs, a state, {STEADY!r} or {ZEROS!r}, got "
            f"{start!r}",
            field="start",
        )
    start = _check_start(network, start)
    if u is None:
        u = jnp.broadcast_to(
            middle_inputs(network), (len(start), len(driving_signals(network)))
        )
    u = _rows(network, u)
    if len(u) != len(start):
        raise SpecError(
            f"start has {len(start)} samples, u {len(u)}: give the inputs of the same "
            "samples",
            field="u",
        )
    return _behind(network, start, u, decay_rate(network))


@program
def _zero_memory(network: Network, row: Array) -> Array:
    return join_state(
        rest_memory(network, row, jnp.zeros(len(sources(network)), row.dtype))
    )


@program
def _behind(network: Network, start: Array, u: Array, rate: Array) -> Array:
    """The state behind measured samples; hidden channels are those that fit the window
    behind the history best, and what follows from them through the window."""
    fixed, at, y = make_fixed(network, rate), len(u), start
    if network.hidden:
        signals, y, _, known = _record(network, u, start)
        v, x = network.columns(signals)
        size, at = network.gain[np.array(network.signals)][None], network.history
        scaled = (y / size, known, jnp.asarray(at))
        y = with_hidden_start(network, v, x, *scaled) * size
    loop = y[:, sources(network)]

    def advance_measured(past, row):
        return advance_memory(network, past, row[0], fixed, row[1])[0], None

    def free(past, row):
        return advance_memory(network, past, row, fixed)[0], None

    past = rest_memory(network, u[0], loop[0])
    past = jax.lax.scan(advance_measured, past, (u[:at], loop[:at]))[0]
    return join_state(jax.lax.scan(free, past, u[at:])[0])


def run(
    network: Network, u: Float[Arrays, "time driving"], start: Any
) -> Float[Array, "time outputs"]:
    """The free run of one record of plain arrays; see `Network.__call__`."""
    u, rate = _rows(network, u), decay_rate(network)
    if isinstance(start, str):
        return _run_on(network, init(network, start, u), u, rate)
    start = jnp.asarray(start)
    if start.ndim == 1:
        return _run_on(network, start, u, rate)
    return _run_behind(network, u, _check_start(network, start), rate)


@program
def _run_on(network: Network, x: Array, u: Array, rate: Array) -> Array:
    fixed = make_fixed(network, rate)

    def take(past, row):
        return advance_memory(network, past, row, fixed)

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
        begin = jnp.asarray(network.history)
        measured = with_hidden_start(network, v, x, measured, known, begin)
    scaled = run_record(network, v, x, measured, anchor)
    outputs = (scaled * size[None])[:, : len(network.modelled)]
    if network.hold is not None:
        over = jnp.zeros(len(u), u.dtype)
        if has_overshoot(network):
            inputs = u[:, : len(network.channels.inputs)]
            over = overshoot(network, inputs, rate)
        outputs = within_margin(network, outputs, over)
    begun = jnp.arange(len(u)) < network.before
    return jnp.where(begun[:, None], y[:, : len(network.modelled)], outputs)


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
    signals = signals.at[:, np.array(driving_signals(network), int)].set(u)
    y = jnp.pad(y, ((0, 0), (0, network.hidden)))
    at = jnp.arange(time)
    known = jnp.broadcast_to((at < need)[:, None], y.shape)
    return signals, y, at == network.history, known


def equilibrium(
    network: Network, u: Float[Arrays, " driving_signals"], start: Any
) -> tuple[Float[Array, " states"], Bool[Array, ""]]:
    """The state of rest under constant inputs; see `StateForm.equilibrium`."""
    middle = 0.5 * (network.low + network.high)
    if start is not None:
        outputs = np.array(network.signals)[: len(network.modelled)]
        middle = middle.at[outputs].set(jnp.asarray(start, middle.dtype))
    begin = middle[np.array(network.signals)[sources(network)]]
    return _rest(network, _row(network, u), begin, decay_rate(network))


@program
def _rest(
    network: Network, row: Array, begin: Array, rate: Array
) -> tuple[Array, Array]:
    import optimistix  # it takes longer to load than the rest of this room

    size, fixed = loop_gain(network), make_fixed(network, rate)

    def find_motion(z, _):
        past = rest_memory(network, row, z * size)
        return advance_memory(network, past, row, fixed)[0].loop[:, 0] / size - z

    near = max(REST_TOLERANCE, 100 * float(jnp.finfo(begin.dtype).eps))
    solver = optimistix.Newton(rtol=near, atol=near)
    found = optimistix.root_find(
        find_motion, solver, begin / size, max_steps=REST_STEPS, throw=False
    )
    good = found.result == optimistix.RESULTS.successful
    z = jnp.where(good, found.value * size, begin)
    return join_state(rest_memory(network, row, z)), good


@program
def _jacobians(network: Network, x: Array, u: Array, rate: Array) -> tuple:
    def both(x, u):
        return _step(network, x, u, rate)

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
        """A name for each entry of the state, `speed[t-1]`."""
        return state_names(self.network)

    @property
    def inputs(self) -> list[str]:
        """Names of the columns of `u`."""
        names = self.network.channels.names
        return [names[s] for s in driving_signals(self.network)]

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
            self.network,
            jnp.asarray(x),
            _row(self.network, u),
            decay_rate(self.network),
        )

    def equilibrium(
        self,
        u: Float[Arrays, " inputs"],
        start: Float[Arrays, " outputs"] | None = None,
    ) -> tuple[Float[Array, " states"], Bool[Array, ""]]:
        """A state of rest under constant inputs, x = f(x, u), and whether it was found.

        It uses Newton's method on the outputs from `start`, by default the middle of
        their trained ranges. Of several states of rest it is the one to which that
        leads; where it leads to none, the outputs of the state have been at `start`.
        Differentiable by the implicit function theorem (`optimistix.root_find`).
        """
        return equilibrium(self.network, u, start)


@guard_arguments
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


def middle_inputs(network: Network) -> Float[Array, " driving_signals"]:
    """The middle of every input's trained range."""
    at = np.array(driving_signals(network), int)
    return (0.5 * (network.low + network.high))[at]


def _row(network: Network, u: Any) -> Float[Array, " driving_signals"]:
    u = jnp.asarray(u)
    return _rows(network, u[None])[0]


def _rows(network: Network, u: Any) -> Float[Array, "time driving"]:
    u, columns = jnp.asarray(u), driving_signals(network)
    if u.ndim != 2 or u.shape[1] != len(columns):
        names = [network.channels.names[s] for s in columns]
        raise SpecError(
            f"u must have a column for each of {', '.join(names)}, got the shape "
            f"{u.shape}",
            field="u",
        )
    return u.astype(network.gain.dtype)


def _check_start(network: Network, start: Any) -> Float[Array, "time outputs"]:
    start = jnp.asarray(start)
    if start.ndim != 2 or start.shape[1] != len(network.modelled):
        raise SpecError(
            f"start must have a column for each of {', '.join(network.output_names)}, "
            f"got the shape {start.shape}",
            field="start",
        )
    return start.astype(network.gain.dtype)
