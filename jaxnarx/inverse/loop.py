"""The cascade as one recursion: reference, inverse, actuator limits, forward network.

Its state holds the commands and the simulated outputs, z_t = [u_t, y_t]:

    u_t = limit(inverse(r, u_(t-1) ..., y_(t-1) ...), u_(t-1))
    y_t = forward(u_t, u_(t-1) ..., y_(t-1) ...)

The inverse is given back the *limited* commands. It holds no other memory, so nothing
winds up: a command leaves its limit at the first sample at which the inverse asks for
less. A range limit acts first, then the rate limit.

Being a recursion on its own outputs, it runs and is differentiated by
`jaxnarx.arrays.recurrence.free_run`.
"""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import free_run, program, twin
from jaxnarx.checks import require_known
from jaxnarx.errors import SpecError
from jaxnarx.inverse.wiring import Place, Wiring, wire
from jaxnarx.models import FLAG, Network, advance, depth, widen
from jaxnarx.settings import ActuatorLimits


class Loop(eqx.Module):
    """An inverse in front of a forward network.

    `low` and `high` bound the commands, `move` is their largest change per sample
    (`inf`: none); physical units.
    """

    inverse: Network
    forward: Network
    wiring: Wiring = eqx.field(static=True)
    low: Float[Array, " commands"]
    high: Float[Array, " commands"]
    move: Float[Array, " commands"]

    @property
    def nameless(self) -> "Loop":
        """Copy with networks without names, so that names are no part of a program."""
        plain = self.inverse.nameless, self.forward.nameless
        return twin(self, inverse=plain[0], forward=plain[1])

    @property
    def command_gain(self) -> Float[Array, " commands"]:
        """Gain of the commands in the inverse."""
        return self.inverse.gain[np.array(self.inverse.signals)]

    @property
    def output_gain(self) -> Float[Array, " outputs"]:
        """Gain of the modelled outputs in the forward network."""
        return self.forward.gain[np.array(self.forward.signals)]

    @property
    def command_signals(self) -> list[int]:
        """Signal of every command in the forward network."""
        return [s for s, _ in self.wiring.source[len(self.inverse.channels.inputs) :]]

    @property
    def depth(self) -> int:
        """Past states the loop must carry; at least one."""
        lags = self.wiring.deepest_command, self.wiring.deepest_state
        return max(depth(self.inverse), depth(self.forward), *lags)

    @property
    def history(self) -> int:
        """Measured samples a run starts from."""
        return max(self.inverse.history, self.forward.history, self.depth)

    def command(
        self,
        v: Float[Array, " vars"],
        x: tuple[Float[Array, " _"], ...],
        past: Float[Array, "states depth"],
    ) -> Float[Array, " commands"]:
        """The limited commands, scaled."""
        count = self.low.shape[0]
        own = past[:count]
        shown = self.output_gain.shape[0]
        outputs = past[count : count + shown] * self.output_gain[:, None]
        v, x = _fill_variables(self.inverse, v, x, self.wiring.states, outputs, 1)
        raw = advance(self.inverse, v, x, own) * self.command_gain
        before = own[:, 0] * self.command_gain
        held = jnp.clip(raw, self.low, self.high)
        held = jnp.clip(held, before - self.move, before + self.move)
        return held / self.command_gain

    def respond(
        self,
        v: Float[Array, " vars"],
        x: tuple[Float[Array, " _"], ...],
        past: Float[Array, "states depth"],
        now: Float[Array, " commands"],
    ) -> Float[Array, " _"]:
        """The forward network's outputs (and inner states) under commands, scaled."""
        count = now.shape[0]
        moved = jnp.concatenate([now[:, None], past[:count]], axis=1)
        moved = moved * self.command_gain[:, None]
        v, x = _fill_variables(self.forward, v, x, self.wiring.commands, moved, 0)
        return advance(self.forward, v, x, past[count:])


def _fill_variables(
    network: Network,
    v: Float[Array, " vars"],
    x: tuple[Float[Array, " _"], ...],
    places: tuple[tuple[Place, ...], ...],
    values: Float[Array, "entries lags"],
    first: int,
):
    """Both kinds of variables with `values` in physical units put in their places.

    Column k of `values` is lag `first` + k. A network with limits holds them to
    their ranges where they are inputs.
    """
    rows, sources, lags = _columns(places[0])
    if len(rows):
        signal = network.variables.signal[rows]
        given = values[sources, lags - first]
        fresh = network.hold_inputs(given, signal)
        v = v.at[rows + 1].set(fresh / network.gain[signal])
        beyond = len(network.variables) + 1
        if v.shape[0] > beyond:
            v = v.at[rows + beyond].set((given - fresh) / network.gain[signal])
    out = []
    for x_o, model, own in zip(x, network.models, places[1:], strict=True):
        rows, sources, lags = _columns(own)
        if len(rows):
            fresh = values[sources, lags - first]
            fresh = network.hold_inputs(fresh, model.scheduling.signal[rows])
            x_o = x_o.at[rows].set(fresh)
        out.append(x_o)
    return v, tuple(out)


def _columns(places: tuple[Place, ...]):
    return np.array(places, dtype=np.int64).reshape(-1, 3).T


def connect(
    inverse: Network, forward: Network, limits: ActuatorLimits | None = None
) -> Loop:
    """The cascade of two networks; channels are matched by name.

    Commands are bounded by `limits` and, in any case, by the bounds that the inverse's
    feedback has had in training; by the forward network's trained range too, if
    it has limits (`jaxnarx.models.limits`): commands do not go where it only guesses.
    `SpecError` where the two do not fit, see `wire`, or where a limit leaves no room.
    """
    limits = ActuatorLimits() if limits is None else limits
    wiring, names = wire(inverse, forward), inverse.output_names
    for field in ("range", "rate"):
        _require_named(getattr(limits, field), names, field)
    gain = np.asarray(inverse.gain)[np.array(inverse.signals)]
    low, high = np.asarray(inverse.lower) * gain, np.asarray(inverse.upper) * gain
    if forward.hold is not None or forward.outside != FLAG:
        at = [forward.channels.signal(name) for name in names]
        low = np.maximum(low, np.asarray(forward.low)[at])
        high = np.minimum(high, np.asarray(forward.high)[at])
    pairs = [limits.range.get(n, (-np.inf, np.inf)) for n in names]
    low = np.maximum(low, [a for a, _ in pairs])
    high = np.minimum(high, [b for _, b in pairs])
    for name, a, b in zip(names, low, high, strict=True):
        if not a < b:
            raise SpecError(
                f"the range of {name} has nothing in common with that of the "
                f"networks' training; it leaves {a:g} to {b:g}",
                field="range",
            )
    move = [limits.rate.get(n, np.inf) * float(inverse.sample_time) for n in names]
    parts = (jnp.asarray(np.asarray(p, gain.dtype)) for p in (low, high, move))
    return Loop(inverse, forward, wiring, *parts)


def _require_named(given: Mapping[str, object], names: list[str], field: str) -> None:
    for name in given:
        require_known(
            name, names, field, f"{field} names {name!r}, which is no command"
        )


def inverse_columns(
    loop: Loop,
    signals: Float[Array, "time signals"],
    valid: Bool[Array, "time signals"] | Bool[np.ndarray, "time signals"],
) -> tuple[Float[Array, "time own"], Bool[Array, "time own"]]:
    """The columns of a record as the inverse sees them: shifted ahead, the last value
    held."""
    at = jnp.arange(signals.shape[0])

    def shift_signals(x):
        picked = [
            x[jnp.minimum(at + k, x.shape[0] - 1), s] for s, k in loop.wiring.source
        ]
        return jnp.stack(picked, axis=1)

    return shift_signals(signals), shift_signals(jnp.asarray(valid))


def run_record(
    loop: Loop,
    signals: Float[Array, "time signals"],
    valid: Bool[Array, "time signals"] | Bool[np.ndarray, "time signals"],
    anchor: Bool[Array, " time"],
) -> Float[Array, "time states"]:
    """Commands, then the forward network's outputs, of one record; scaled.

    `signals` are those of the forward network in physical units: references in the
    columns of the targets, commands only for the start. The run takes its past from
    them at anchors. Pure and differentiable in the networks and in `signals`.
    """
    inverse, forward = loop.inverse, loop.forward
    f_v, f_x = forward.columns(signals, jnp.asarray(valid))
    i_v, i_x = inverse.columns(*inverse_columns(loop, signals, valid))
    drive = f_v.T, tuple(x.T for x in f_x), i_v.T, tuple(x.T for x in i_x)
    commands = signals[:, np.array(loop.command_signals)] / loop.command_gain[None]
    outputs = signals[:, np.array(forward.signals)] / loop.output_gain[None]
    measured = jnp.concatenate([commands, widen(forward, outputs)], axis=1)
    free = jnp.full_like(loop.low, jnp.inf)
    lower = jnp.concatenate([-free, widen(forward, forward.lower)])
    upper = jnp.concatenate([free, widen(forward, forward.upper)])
    moving, still = eqx.partition(loop, eqx.is_array)

    def step(params, drive, past):
        whole = eqx.combine(params, still)
        f_v, f_x, i_v, i_x = drive
        now = whole.command(i_v, i_x, past)
        return jnp.concatenate([now, whole.respond(f_v, f_x, past, now)])

    return free_run(
        step, moving, drive, measured, anchor, lower, upper, depth=loop.depth
    )


@program
def run(
    loop: Loop,
    signals: Float[Array, "records time signals"],
    valid: Bool[Array, "records time signals"],
    anchor: Bool[Array, "records time"],
) -> Float[Array, "records time states"]:
    """`run_record` of every record."""
    return jax.vmap(lambda *record: run_record(loop, *record))(signals, valid, anchor)
