"""The port-injected engine on a dynamometer that holds its speed."""

import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.data import Channel, Channels
from jaxnarx.engines.bench import Noise
from jaxnarx.engines.delays import event_duration, lagging_speed, shift
from jaxnarx.engines.engine import AbstractEngine, Borders, parameter
from jaxnarx.engines.integration import hold_inputs
from jaxnarx.engines.pfi import STALL, Drive, Pfi, pfi_margins
from jaxnarx.excitation import aprbs

RPM = math.pi / 30  # rad/s per rpm
EVENT = 360.0  # degrees crank angle
SUBSTEPS = 8  # 16.7 ms each at the slowest speed, where an event is longest
VALVE_EVENTS = 1
TORQUE_EVENTS = 1
MIXTURE_EVENTS = 2
SPEED_LAG = 0.4  # s


class PfiDyno(AbstractEngine):
    """A `Pfi` at imposed speed: three inputs, three outputs, events of 360 degrees.

    Inputs: valve duty, injector pulse width FPW [ms], speed [rpm]; spark stays on its
    schedule. Outputs: shaft torque, air-fuel ratio, manifold pressure. The states are
    those of `Pfi`, the speed among them held.

    A dynamometer measures the torque at the shaft, less what accelerates the engine,

        T_shaft = T_ind(one event late) - T_fr - J_e d omega/dt,

    with d omega/dt the change of the imposed speed since the last event over that
    event's duration. Dead times [O]: duty one event, torque one, mixture two; then the
    lambda sensor, a lag of 0.07 s.

    References: those of `Pfi`; the bench is our own choice [O].
    """

    engine: Pfi = eqx.field(default_factory=Pfi)
    engine_inertia: Float[Array, ""] = parameter(0.13)  # J_e, kg m^2 [O]
    sensor_time: Float[Array, ""] = parameter(0.07)  # s [O]

    varied: ClassVar[Mapping[str, float]] = {
        "engine.displacement": 0.5,
        "engine.manifold_volume": 1.0,
        "engine.pumping_slope": 0.3,
        "engine.valve_flow": 1.0,
        "engine.valve_centre": 0.1,
        "engine.valve_width": 0.5,
        "engine.valve_time": 2.0,
        "engine.leak_flow": 2.0,
        "engine.injector_gain": 0.5,
        "engine.friction_scale": 1.0,
        "engine_inertia": 1.0,
        "sensor_time": 2.0,
    }

    channels: ClassVar[Channels] = Channels(
        inputs=(
            Channel("duty", "-"),
            Channel("FPW", "ms"),
            Channel("speed", "rpm"),
        ),
        outputs=(
            Channel("torque", "Nm"),
            Channel("AFR", "-"),
            Channel("MAP", "kPa"),
        ),
    )
    ranges: ClassVar[Borders] = {
        "duty": (0.38, 0.44),
        "FPW": (2.0, 9.0),
        "speed": (1100.0, 1800.0),
    }
    """Pulse width depends on the air: `excite` sets it."""
    domain: ClassVar[Borders] = {
        "duty": (0.0, 1.0),
        "FPW": (0.0, 20.0),
        "speed": (STALL, 1900.0),
    }
    """Any duty and pulse width; speeds from the stall to 1900 rpm."""
    limits: ClassVar[Borders] = {}
    """None: the dynamometer keeps the engine turning."""
    noise: ClassVar[Mapping[str, Noise]] = {
        "torque": Noise(0.4),
        "AFR": Noise(0.03),
        "MAP": Noise(0.3),
    }
    """0.4 Nm, 0.03, and 0.3 kPa as for crank-synchronous averages [O]."""
    event: ClassVar[float | None] = EVENT
    """360 degrees crank angle."""

    @property
    def sample_time(self) -> float:
        """0.04 s: 360 deg at 1500 rpm. The true value is 60/N seconds at N rpm."""
        return 0.04

    def steady_state(self, inputs: Float[Array, " inputs"]) -> Float[Array, " states"]:
        """`[p_m, m_ff, W_v, omega]` that do not change at the imposed speed."""
        return self.engine.balance(_drive(inputs))

    def rest(self, inputs: Float[Array, " inputs"]):
        """The state that `advance` carries at rest: see `settled_bench`."""
        return self.settled_bench(self.steady_state(inputs), inputs)

    def settled_bench(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ):
        """The state that `advance` carries when `state` has been there for long.

        In this order: states, reading of the air-fuel ratio, speed of the last event
        [rpm], delay lines of duty, indicated torque [Nm] and air-fuel ratio.
        """
        now = self.engine.quantities(state, _drive(inputs))
        ratio = now.ratio * self.engine.stoichiometric
        return (
            state,
            ratio,
            inputs[2],
            jnp.broadcast_to(inputs[0], (VALVE_EVENTS,)),
            jnp.broadcast_to(now.indicated, (TORQUE_EVENTS,)),
            jnp.broadcast_to(ratio, (MIXTURE_EVENTS,)),
        )

    def advance(self, carry, inputs: Float[Array, " inputs"]):
        """One event of 360 degrees at the imposed speed.

        The delay lines sample at the start of the event, with the new pulse width: of a
        change of it, the share that does not wet the wall is burnt at once.
        """
        state, reading, before, duties, torques, ratios = carry
        duties, duty = shift(duties, inputs[0])
        drive = _drive(inputs)._replace(duty=duty)
        now = self.engine.quantities(state, drive)
        torques, indicated = shift(torques, now.indicated)
        drag = now.indicated - now.torque
        past = event_duration(EVENT, before, slowest=STALL)
        swing = self.engine_inertia * (inputs[2] - before) * RPM / past
        outputs = jnp.stack([indicated - drag - swing, reading, now.pressure])

        ratios, seen = shift(ratios, now.ratio * self.engine.stoichiometric)
        duration = event_duration(EVENT, inputs[2], slowest=STALL)
        reading = seen + (reading - seen) * jnp.exp(-duration / self.sensor_time)
        state = hold_inputs(
            lambda x: self.engine.derivative(x, drive), state, duration, steps=SUBSTEPS
        )
        return (state, reading, inputs[2], duties, torques, ratios), outputs

    def margins(self, carry, inputs: Float[Array, " inputs"]):
        """`stall` and `mixture`, as for `Pfi`."""
        state, *_, duties, _, _ = carry
        drive = _drive(inputs)._replace(duty=duties[0])
        return pfi_margins(self.engine.quantities(state, drive))

    def excite(self, key: PRNGKeyArray, length: int) -> Float[Array, "time inputs"]:
        """APRBS around the stoichiometric feed-forward, section 2.9 of the
        specification [O].

        Duty 0.38 to 0.44 and pulse width 0.88 to 1.14 times what lambda one asks for at
        the present pressure, each held for 12 to 60 events; speed 1100 to 1800 rpm,
        hold 40 to 150, through a lag of 0.4 s.
        """
        keys = jax.random.split(key, 3)
        hold = (12, 60)
        duty = aprbs(keys[0], length, hold=hold, amplitude=self.ranges["duty"])
        factor = aprbs(keys[1], length, hold=hold, amplitude=(0.88, 1.14))
        span = self.ranges["speed"]
        target = aprbs(keys[2], length, hold=(40, 150), amplitude=span)
        speed = lagging_speed(target, degrees=EVENT, slowest=STALL, lag=SPEED_LAG)
        return _fuelled(self, jnp.stack([duty, factor, speed], axis=-1))


@eqx.filter_jit
def _fuelled(
    bed: PfiDyno, demands: Float[Array, "time inputs"]
) -> Float[Array, "time inputs"]:
    """Rows of duty, factor on the stoichiometric pulse width, and speed, with the
    factor replaced by the pulse width [ms] it means in the run."""

    def row_for(state, demand):
        duty, factor, speed = demand
        needed = bed.engine.quantities(state, Drive(duty, speed=speed)).pulse
        return jnp.stack([duty, factor * needed, speed])

    def event(carry, demand):
        row = row_for(carry[0], demand)
        return bed.advance(carry, row)[0], row

    duty, factor, speed = demands[0]
    needed = bed.engine.balance(Drive(duty, speed=speed))
    state = bed.steady_state(row_for(needed, demands[0]))
    carry = bed.settled_bench(state, row_for(needed, demands[0]))
    return jax.lax.scan(event, carry, demands)[1]


def _drive(inputs: Float[Array, " inputs"]) -> Drive:
    duty, pulse, speed = inputs
    return Drive(duty, pulse=pulse, speed=speed)
