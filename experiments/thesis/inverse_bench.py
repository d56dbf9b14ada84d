"""The `gtdi` bed under an inverse and a PI controller, sample by sample.

The bed starts at rest under the recorded inputs and follows them for as long as the
inverse needs a past. From then on, at every sample t,

    y(t)  = what the sensors say, noise included
    u(t)  = feedforward(references, its own last commands, y(t-1) ...) + PI(r(t) - y(t))

spark and throttle are held for a sample; fuel and speed are the recorded ones, the fuel
trimmed where the loop of lambda is closed. The PI acts from torque on throttle and from
lambda on fuel: more air under a mixture that is kept means more torque everywhere,
while the spark's effect ends at the best spark, and fuel moves lambda with no manifold
between. The integrators stand still where they push against a limit.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from inverse_bed import DOWN, STEP, UNIT

import jaxnarx as jnx
from jaxnarx.engines import Gtdi
from jaxnarx.inverse.loop import Loop, connect, inverse_columns

TRIM = 0.25
"""Largest trim of the fuel, as a share."""
THROTTLE_SLOPE, MANIFOLD = 14.0, 0.1  # Nm/deg, s
SENSOR, DELAYS = 0.2, (0.12, 0.16)  # s; of torque and lambda, half a sample among them


class Case(NamedTuple):
    """What drives the bed: the inverse or constant commands, and the PI's gains.

    `forward` is 1 or 0; `gain` and `integral` (a second) of torque, in degrees a Nm,
    and of lambda, in shares of the fuel.
    """

    forward: Any
    constant: Any
    gain: Any
    integral: Any


class Track(NamedTuple):
    """Commands (with the trim behind them), and the bed's outputs without noise."""

    commands: Any
    outputs: Any


def case(
    constant: np.ndarray, forward: bool, closed: float | None = None, share: float = 1.0
) -> Case:
    """A case; `closed` is the time constant of the closed loops [s], None without PI.

    Gains by internal model control, time constant over gain times (`closed` + delay),
    D. E. Rivera, M. Morari, S. Skogestad, Ind. Eng. Chem. Process Des. Dev. 25, 1986.
    """
    gain = np.zeros(2)
    if closed is not None:
        slope, lag = np.array([THROTTLE_SLOPE, 1.0]), np.array([MANIFOLD, SENSOR])
        gain = share * lag / (slope * (closed + np.array(DELAYS)))
        integral = gain / lag
    else:
        integral = np.zeros(2)
    return Case(np.array(float(forward)), np.asarray(constant, float), gain, integral)


@dataclasses.dataclass(frozen=True, eq=False)
class Bench:
    """An inverse in front of the bed, and the record whose outputs are asked for."""

    loop: Loop
    engine: Gtdi
    inputs: np.ndarray
    """Of the bed, per event."""
    references: jnx.Dataset
    """One record, at the controller's rate."""
    noise: np.ndarray
    """Of the sensors (time, outputs)."""

    def run(self, cases: list[Case]) -> list[Track]:
        """All cases, one after the other in one program."""
        stacked = jax.tree.map(lambda *a: jnp.asarray(np.stack(a)), *cases)
        record = self.references.records[0]
        signals = jnp.asarray(np.concatenate([record.u, record.y], axis=1))
        rows = jnp.asarray(self.inputs.reshape(-1, DOWN, 4))
        found = _drive(
            self.loop, self.engine, rows, signals, jnp.asarray(self.noise), stacked
        )
        tracks = jax.tree.map(np.asarray, found)
        return [Track(u, y) for u, y in zip(*tracks, strict=True)]


def bench(
    inverse: jnx.Network,
    forward: jnx.Network,
    limits: jnx.inverse.ActuatorLimits,
    engine: Gtdi,
    inputs: np.ndarray,
    references: jnx.Dataset,
    seed: int,
) -> Bench:
    """A bench whose sensors have the noise of the bed."""
    own = [engine.noise[n].absolute for n in ("TRQ", "AFR", "MAP")]
    rng = np.random.default_rng([seed, 7])
    noise = (
        rng.normal(size=(len(references.records[0]), 3)) * (np.array(own) * UNIT)[None]
    )
    loop = connect(inverse, forward, limits)
    return Bench(loop, engine, inputs, references, noise)


@eqx.filter_jit
def _drive(loop: Loop, engine: Gtdi, rows, signals, noise, cases: Case):
    """Commands and outputs of every case."""
    valid = jnp.ones(signals.shape, bool)
    v, x = loop.inverse.columns(*inverse_columns(loop, signals, valid))
    drive = v.T, tuple(one.T for one in x)
    places = np.array(loop.forward.signals)
    recorded = signals[:, np.array(loop.command_signals)]
    running = jnp.arange(signals.shape[0]) >= loop.history
    start = engine.rest(rows[0, 0])

    def one(case: Case):
        def step(carry, now):
            return _sample(loop, engine, case, carry, now)

        first = jnp.concatenate([recorded[0], signals[0, places]])
        gain = jnp.concatenate([loop.command_gain, loop.output_gain])
        past = jnp.tile((first / gain)[:, None], (1, loop.depth))
        given = drive, rows, signals[:, places[:2]], recorded, noise, running
        return jax.lax.scan(step, (start, past, jnp.zeros(2)), given)[1]

    return jax.lax.map(one, cases)


def _sample(loop: Loop, engine: Gtdi, case: Case, carry, now):
    """One sample: measure, command, and let the bed run on for its events."""
    state, past, integral = carry
    (v, x), events, wanted, recorded, noise, running = now
    # Only outputs are used here: the compiler drops the engine's motion.
    outputs = engine.advance(state, events[0])[1] * UNIT
    measured = outputs + noise
    ahead = loop.command(v, x, past) * loop.command_gain
    ahead = jnp.where(case.forward > 0, ahead, case.constant)
    ahead = jnp.where(running, ahead, recorded)
    error = wanted - measured[:2]
    asked = jnp.where(running, case.gain * error + integral, 0.0)
    throttle = jnp.clip(ahead[1] + asked[0], loop.low[1], loop.high[1])
    trim = jnp.clip(-asked[1], -TRIM, TRIM)
    applied = jnp.stack([throttle - ahead[1], -trim])
    # Where a limit holds the command the integrator stands still.
    free = jnp.abs(applied - asked) < 1e-9
    moved = jnp.where(free & running, case.integral * error * STEP, 0.0)
    commands = jnp.stack([ahead[0], throttle])
    held = jnp.broadcast_to(commands[None], (DOWN, 2))
    fuel = events[:, :1] * (1 + trim)
    rows = jnp.concatenate([fuel, held, events[:, 3:]], axis=1)
    state = jax.lax.scan(lambda s, r: (engine.advance(s, r)[0], None), state, rows)[0]
    gains = loop.command_gain, loop.output_gain
    entry = jnp.concatenate([ahead / gains[0], measured / gains[1]])
    past = jnp.concatenate([entry[:, None], past[:, :-1]], axis=1)
    shown = jnp.append(commands, trim), outputs
    return (state, past, integral + moved), shown
