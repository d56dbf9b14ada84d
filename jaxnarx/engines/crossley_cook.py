"""A compact petrol engine model for drivetrain studies: throttle and load to speed."""

import math
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.data import Channel, Channels
from jaxnarx.engines.bench import Noise
from jaxnarx.engines.delays import event_duration, shift
from jaxnarx.engines.engine import AbstractEngine, Borders, parameter
from jaxnarx.engines.flow import root
from jaxnarx.engines.integration import find_rest, hold_inputs
from jaxnarx.excitation import aprbs

RPM = math.pi / 30  # rad/s per rpm
EVENT = 180.0  # degrees crank angle
STALL = 450.0  # rpm [O]
SUBSTEPS = 4  # 16.7 ms each at the stall speed, where an event is longest
TORQUE_EVENTS = 1
FULL = 0.98  # of ambient pressure; above, flow through the throttle is linear [O]


class CrossleyCookQuantities(NamedTuple):
    """Everything the model knows at one instant; derivatives are per second."""

    pressure: Float[Array, ""]  # bar, intake manifold
    speed: Float[Array, ""]  # rpm
    air_in: Float[Array, ""]  # g/s, through the throttle
    air: Float[Array, ""]  # g/s, into the cylinders
    charge: Float[Array, ""]  # g per event of 180 degrees
    torque: Float[Array, ""]  # Nm, of the charge that burns
    derivative: Float[Array, " states"]


class CrossleyCook(AbstractEngine):
    """Two-state model of a petrol engine with free speed.

    States, packed in this order: manifold pressure P_m [bar], speed N [rad/s]. Inputs:
    throttle angle th [deg] and load torque [Nm]; mixture and spark are constants.
    Outputs: speed and manifold pressure. All coefficients are published [P]; bench,
    ranges and limits are our own choice [O]. About 1.2 to 1.3 L, smaller than `Pfi`.

    Reference: P. R. Crossley and J. A. Cook, A nonlinear engine model for drivetrain
    system development, IEE Control 91, 1991.
    """

    throttle_0: Float[Array, ""] = parameter(2.821)  # g/s
    throttle_1: Float[Array, ""] = parameter(-0.05231)
    throttle_2: Float[Array, ""] = parameter(0.10299)
    throttle_3: Float[Array, ""] = parameter(-0.00063)
    ambient_pressure: Float[Array, ""] = parameter(1.0)  # P_a, bar
    manifold_constant: Float[Array, ""] = parameter(0.41328)  # bar/g
    pump_0: Float[Array, ""] = parameter(-0.366)  # g/s
    pump_1: Float[Array, ""] = parameter(0.08979)  # of N P
    pump_2: Float[Array, ""] = parameter(-0.0337)  # of N P^2
    pump_3: Float[Array, ""] = parameter(0.0001)  # of N^2 P
    torque_0: Float[Array, ""] = parameter(-181.3)  # Nm
    torque_air: Float[Array, ""] = parameter(379.36)  # Nm/g
    torque_mix_1: Float[Array, ""] = parameter(21.91)
    torque_mix_2: Float[Array, ""] = parameter(-0.85)
    torque_spark_1: Float[Array, ""] = parameter(0.26)
    torque_spark_2: Float[Array, ""] = parameter(-0.0028)
    torque_speed_1: Float[Array, ""] = parameter(0.027)
    torque_speed_2: Float[Array, ""] = parameter(-0.000107)
    torque_speed_spark: Float[Array, ""] = parameter(0.00048)
    torque_spark_air: Float[Array, ""] = parameter(2.55)
    torque_square_air: Float[Array, ""] = parameter(-0.05)  # of s^2 m_a
    ratio: Float[Array, ""] = parameter(14.6)  # A/F
    spark: Float[Array, ""] = parameter(15.0)  # s, deg BTDC
    inertia: Float[Array, ""] = parameter(0.14)  # J, kg m^2

    varied: ClassVar[Mapping[str, float]] = {
        "throttle_2": 0.5,
        "manifold_constant": 1.0,
        "pump_1": 0.3,
        "torque_air": 0.2,
        "inertia": 1.0,
    }

    channels: ClassVar[Channels] = Channels(
        inputs=(Channel("throttle", "deg"), Channel("load", "Nm")),
        outputs=(Channel("speed", "rpm"), Channel("P", "bar")),
    )
    ranges: ClassVar[Borders] = {"throttle": (8.0, 12.0), "load": (18.0, 27.0)}
    domain: ClassVar[Borders] = {"throttle": (5.0, 15.0), "load": (10.0, 40.0)}
    limits: ClassVar[Borders] = {"speed": (STALL, float("inf"))}
    """Below 450 rpm the engine counts as stalled."""
    noise: ClassVar[Mapping[str, Noise]] = {"speed": Noise(2.5), "P": Noise(0.003)}
    """2.5 rpm, and 0.3 kPa as for crank-synchronous averages."""
    event: ClassVar[float | None] = EVENT
    """180 degrees crank angle."""

    @property
    def sample_time(self) -> float:
        """0.015 s: 180 deg at 2000 rpm. The true value is 30/N seconds at N rpm."""
        return 0.015

    def quantities(
        self,
        state: Float[Array, " states"],
        inputs: Float[Array, " inputs"],
        burning: Float[Array, ""] | None = None,
    ) -> CrossleyCookQuantities:
        """All quantities of the model at one instant.

            m_ai = (2.821 - 0.05231 th + 0.10299 th^2 - 0.00063 th^3) g(P_m)
            g    = 1 up to P_a/2, then 2/P_a sqrt(P_m P_a - P_m^2); linear from 0.98 P_a
            m_ao = -0.366 + 0.08979 N P_m - 0.0337 N P_m^2 + 0.0001 N^2 P_m
            d P_m/dt = 0.41328 (m_ai - m_ao),   m_a = m_ao pi/N
            T = -181.3 + 379.36 m_a + 21.91 AF - 0.85 AF^2 + 0.26 s - 0.0028 s^2
                + 0.027 N - 0.000107 N^2 + 0.00048 N s + 2.55 s m_a - 0.05 s^2 m_a
            J d N/dt = T - load

        `burning` is the charge m_a [g] that comes out of the delay line, else that of
        the present state. Speeds below 100 rpm count as 100 rpm.
        """
        p = state[0]
        omega = jnp.maximum(state[1], 100.0 * RPM)
        throttle, load = inputs
        air_in = self._throttle(throttle) * self._share(p / self.ambient_pressure)
        pumped = self.pump_1 + self.pump_2 * p + self.pump_3 * omega
        air = self.pump_0 + omega * p * pumped
        charge = air * math.pi / omega
        torque = self._torque(charge if burning is None else burning, omega)
        return CrossleyCookQuantities(
            pressure=p,
            speed=omega / RPM,
            air_in=air_in,
            air=air,
            charge=charge,
            torque=torque,
            derivative=jnp.stack(
                [
                    self.manifold_constant * (air_in - air),
                    (torque - load) / self.inertia,
                ]
            ),
        )

    def steady_state(self, inputs: Float[Array, " inputs"]) -> Float[Array, " states"]:
        """The state that does not change under `inputs`; NaN where there is none.

        Found by `find_rest` from 0.543 bar and 209 rad/s, where the published example
        starts.
        """

        def rate(state, given):
            engine, inputs = given
            return engine.quantities(state, inputs).derivative

        start = jnp.asarray([0.543, 209.0], self.inertia.dtype)
        return find_rest(rate, start, (self, inputs))

    def rest(self, inputs: Float[Array, " inputs"]):
        """Steady state, and the charge on its way to the power stroke."""
        state = self.steady_state(inputs)
        charge = self.quantities(state, inputs).charge
        return state, jnp.broadcast_to(charge, (TORQUE_EVENTS,))

    def advance(self, carry, inputs: Float[Array, " inputs"]):
        """One event of 180 degrees; the charge burns one event later."""
        state, charges = carry
        now = self.quantities(state, inputs)
        charges, burning = shift(charges, now.charge)
        duration = event_duration(EVENT, now.speed, slowest=STALL)
        state = hold_inputs(
            lambda y: self.quantities(y, inputs, burning).derivative,
            *(state, duration),
            steps=SUBSTEPS,
        )
        return (state, charges), jnp.stack([now.speed, now.pressure])

    def margins(self, carry, inputs: Float[Array, " inputs"]):
        """`stall` below 450 rpm; `manifold` above 0.98 of ambient pressure, where the
        law of the throttle is our own."""
        state = carry[0]
        share = state[0] / self.ambient_pressure
        return {"stall": state[1] / RPM - STALL, "manifold": FULL - share}

    def excite(self, key: PRNGKeyArray, length: int) -> Float[Array, "time inputs"]:
        """APRBS, hold 60 to 240 events: throttle 8 to 12 deg, load 18 to 27 Nm."""
        signals = [
            aprbs(k, length, hold=(60, 240), amplitude=span)
            for k, span in zip(
                jax.random.split(key, 2), self.ranges.values(), strict=True
            )
        ]
        return jnp.stack(signals, axis=-1)

    def _throttle(self, angle: Float[Array, ""]) -> Float[Array, ""]:
        cubic = (self.throttle_3 * angle + self.throttle_2) * angle + self.throttle_1
        return cubic * angle + self.throttle_0

    def _share(self, r: Float[Array, ""]) -> Float[Array, ""]:
        inner = jnp.clip(r, 0.5, FULL)
        line = 2 * math.sqrt(FULL - FULL**2) / (1 - FULL) * (1 - r)
        return jnp.where(r > FULL, line, 2 * root(inner - inner**2))

    def _torque(
        self, charge: Float[Array, ""], omega: Float[Array, ""]
    ) -> Float[Array, ""]:
        s, ratio = self.spark, self.ratio
        air = self.torque_air + (self.torque_spark_air + self.torque_square_air * s) * s
        mixture = (self.torque_mix_1 + self.torque_mix_2 * ratio) * ratio
        spark = (self.torque_spark_1 + self.torque_spark_2 * s) * s
        speed = self.torque_speed_1 + self.torque_speed_2 * omega
        speed = speed + self.torque_speed_spark * s
        return self.torque_0 + air * charge + mixture + spark + speed * omega
