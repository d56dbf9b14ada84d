"""A spark ignition engine with dual-equal variable cam timing; figures our own."""

import math
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from jaxnarx.data import Channel, Channels
from jaxnarx.engines.bench import Noise
from jaxnarx.engines.delays import event_duration, lagging_speed, shift
from jaxnarx.engines.engine import AbstractEngine, Borders, parameter
from jaxnarx.engines.flow import root
from jaxnarx.engines.integration import find_rest, hold_inputs
from jaxnarx.excitation import aprbs

EVENT = 180.0  # degrees crank angle
SLOWEST = 500.0  # rpm, for the duration of an event
SUBSTEPS = 3  # 20 ms each at the slowest speed, where an event is longest
SENSOR_EVENTS = 6
LINEAR = 0.97  # of ambient pressure; above, flow through the throttle is linear


class VctDrive(NamedTuple):
    """Inputs that are imposed on the engine.

    `throttle` [deg]; `cam` retard command [deg]; `speed` [rpm]; `ratio`, the A/F that a
    feed-forward from the present air flow injects for; `fuel` flow [g/s], which
    overrides it unless `None`; `measured`, the A/F that reaches the sensor out of the
    delay line, that of the present charge if `None`.
    """

    throttle: ScalarLike
    cam: ScalarLike
    speed: ScalarLike
    ratio: ScalarLike = 14.64
    fuel: ScalarLike | None = None
    measured: ScalarLike | None = None


class VctQuantities(NamedTuple):
    """Everything the model knows at one instant; derivatives are per second."""

    pressure: Float[Array, ""]  # bar, intake manifold
    air_in: Float[Array, ""]  # g/s, through the throttle
    air: Float[Array, ""]  # g/s, m_cyl
    charge: Float[Array, ""]  # g per cylinder and cycle, CAC
    fuel: Float[Array, ""]  # g/s, into the cylinders
    ratio: Float[Array, ""]  # A/F of the charge
    torque: Float[Array, ""]  # Nm
    nox: Float[Array, ""]  # g/kWh
    hc: Float[Array, ""]  # g/kWh
    derivative: Float[Array, " states"]


class Vct(AbstractEngine):
    """Polynomial model of a 4.6 L, eight-cylinder engine with dual-equal cam retard.

    **Results must not be presented as results on the Stefanopoulou engine.** Only the
    structure, the manifold constant and the flow function are published [P]; the
    throttle cubic is borrowed from Crossley and Cook, 1991; every other coefficient is
    our own choice [O], made for plausible effects, and describes no real engine.

    States, packed in this order: manifold pressure P [bar], cam retard [deg], fuel film
    [g], A/F sensor. Below, n is speed in krpm and x = A/F - 14.64.

    On the bench (`simulate`) the inputs are throttle, cam command, A/F command and
    speed; fuel follows by feed-forward from the present air flow.

    References: A. G. Stefanopoulou et al., ASME J. Dyn. Sys. Meas. Control 120(2),
    257-266, 1998 (structure); P. R. Crossley and J. A. Cook, IEE Control 91, 1991.
    """

    manifold_constant: Float[Array, ""] = parameter(0.118)  # K_m, bar/g [P]
    ambient_pressure: Float[Array, ""] = parameter(1.013)  # P_0, bar
    stoichiometric: Float[Array, ""] = parameter(14.64)
    cylinders: Float[Array, ""] = parameter(8.0)  # [O]
    throttle_0: Float[Array, ""] = parameter(2.821)  # g/s, borrowed, as the next three
    throttle_1: Float[Array, ""] = parameter(-0.05231)
    throttle_2: Float[Array, ""] = parameter(0.10299)
    throttle_3: Float[Array, ""] = parameter(-0.00063)
    air_gain: Float[Array, ""] = parameter(44.0)  # g/s per krpm and bar [O], as all
    air_speed_0: Float[Array, ""] = parameter(0.86)  # below
    air_speed_1: Float[Array, ""] = parameter(0.14)
    air_speed_2: Float[Array, ""] = parameter(-0.035)
    slope_0: Float[Array, ""] = parameter(0.90)  # alpha
    slope_1: Float[Array, ""] = parameter(-1.1e-3)
    slope_2: Float[Array, ""] = parameter(-1.1e-4)
    offset_0: Float[Array, ""] = parameter(0.075)  # beta, bar
    offset_1: Float[Array, ""] = parameter(6e-4)
    offset_2: Float[Array, ""] = parameter(3e-5)
    torque_1: Float[Array, ""] = parameter(690.0)  # Nm/g
    torque_2: Float[Array, ""] = parameter(-30.0)
    torque_mix_1: Float[Array, ""] = parameter(-0.030)
    torque_mix_2: Float[Array, ""] = parameter(-0.016)
    torque_mix_3: Float[Array, ""] = parameter(0.0008)
    friction_0: Float[Array, ""] = parameter(40.0)  # Nm
    friction_1: Float[Array, ""] = parameter(4.0)
    friction_2: Float[Array, ""] = parameter(2.0)
    nox_gain: Float[Array, ""] = parameter(14.0)  # g/kWh
    nox_speed_0: Float[Array, ""] = parameter(0.90)
    nox_speed_1: Float[Array, ""] = parameter(0.12)
    nox_speed_2: Float[Array, ""] = parameter(-0.02)
    nox_cam: Float[Array, ""] = parameter(-0.0235)  # per deg
    nox_mix_1: Float[Array, ""] = parameter(0.32)
    nox_mix_2: Float[Array, ""] = parameter(-0.08)
    nox_mix_3: Float[Array, ""] = parameter(-0.03)
    nox_mix_floor: Float[Array, ""] = parameter(0.02)
    nox_pressure_0: Float[Array, ""] = parameter(0.20)
    nox_pressure_1: Float[Array, ""] = parameter(1.9)
    nox_pressure_2: Float[Array, ""] = parameter(-0.70)
    hc_gain: Float[Array, ""] = parameter(6.5)  # g/kWh
    hc_speed_0: Float[Array, ""] = parameter(1.25)
    hc_speed_1: Float[Array, ""] = parameter(-0.22)
    hc_speed_2: Float[Array, ""] = parameter(0.03)
    hc_mix_1: Float[Array, ""] = parameter(-0.12)
    hc_mix_2: Float[Array, ""] = parameter(0.05)
    hc_mix_3: Float[Array, ""] = parameter(0.006)
    hc_constant: Float[Array, ""] = parameter(0.70)
    hc_inverse: Float[Array, ""] = parameter(0.12)  # bar
    hc_cam: Float[Array, ""] = parameter(-0.008)  # per deg
    hc_steep: Float[Array, ""] = parameter(4e-11)
    hc_steep_floor: Float[Array, ""] = parameter(0.22)  # bar
    hc_steep_power: Float[Array, ""] = parameter(16.0)
    cam_time: Float[Array, ""] = parameter(0.12)  # s
    film_share: Float[Array, ""] = parameter(0.3)
    film_time: Float[Array, ""] = parameter(0.35)  # s
    sensor_time: Float[Array, ""] = parameter(0.07)  # s
    leanest: Float[Array, ""] = parameter(20.0)  # A/F
    richest: Float[Array, ""] = parameter(10.0)  # A/F

    varied: ClassVar[Mapping[str, float]] = {
        "manifold_constant": 1.0,
        "throttle_2": 0.5,
        "air_gain": 0.5,
        "offset_0": 1.0,
        "torque_1": 0.3,
        "friction_0": 1.0,
        "nox_gain": 1.0,
        "nox_cam": 0.5,
        "hc_gain": 1.0,
        "hc_cam": 1.0,
        "cam_time": 2.0,
        "film_share": 2.0,
        "film_time": 1.0,
        "sensor_time": 2.0,
    }

    channels: ClassVar[Channels] = Channels(
        inputs=(
            Channel("throttle", "deg"),
            Channel("cam command", "deg"),
            Channel("AFR command", "-"),
            Channel("speed", "rpm"),
        ),
        outputs=(
            Channel("torque", "Nm"),
            Channel("AFR", "-"),
            Channel("NOx", "g/kWh"),
            Channel("HC", "g/kWh"),
            Channel("P", "bar"),
            Channel("cam", "deg"),
        ),
    )
    ranges: ClassVar[Borders] = {
        "throttle": (9.5, 18.0),
        "cam command": (0.0, 30.0),
        "AFR command": (14.64 / 1.08, 14.64 / 0.92),
        "speed": (900.0, 2000.0),
    }
    """Ranges of `excite`: stoichiometric fuel times 0.92 to 1.08 [O]."""
    domain: ClassVar[Borders] = {
        "throttle": (7.0, 22.0),
        "cam command": (0.0, 35.0),
        "AFR command": (12.0, 18.0),
        "speed": (750.0, 2000.0),
    }
    """As specified; throttle from 7 deg, where the reference figures begin."""
    limits: ClassVar[Borders] = {}
    """None: `flags` says where the model is not meant to be used."""
    noise: ClassVar[Mapping[str, Noise]] = {
        "torque": Noise(0.4),
        "AFR": Noise(0.03),
        "NOx": Noise(relative=0.004),
        "HC": Noise(relative=0.004),
        "P": Noise(0.003),
        "cam": Noise(0.1),
    }
    """Torque 0.4 Nm, A/F 0.03, P 0.3 kPa, cam 0.1 deg; NOx and HC 0.4 % of the
    reading [O]."""
    event: ClassVar[float | None] = EVENT
    """180 degrees crank angle."""

    @property
    def sample_time(self) -> float:
        """0.02 s: 180 deg at 1500 rpm. The true value is 30/N seconds at N rpm."""
        return 0.02

    def derivative(
        self, state: Float[Array, " states"], drive: VctDrive
    ) -> Float[Array, " states"]:
        """Rate of change of `[P, cam, film, sensor]`, per second."""
        return self.quantities(state, drive).derivative

    def quantities(self, state: Float[Array, " states"], drive: VctDrive):
        """All quantities of the model at one instant, as `VctQuantities`.

            dP/dt = K_m (g_1(P) g_2(th) - m_cyl)
            g_2   = 2.821 - 0.05231 th + 0.10299 th^2 - 0.00063 th^3
            m_cyl = 44 n (0.86 + 0.14 n - 0.035 n^2) max(0, alpha P - beta)
            alpha = 0.90 - 1.1e-3 cam - 1.1e-4 cam^2
            beta  = 0.075 + 6e-4 cam + 3e-5 cam^2
            CAC   = 120 m_cyl/(8 N)
            T   = (690 CAC - 30 CAC^2) (1 - 0.030 x - 0.016 x^2 + 0.0008 x^3)
                  - (40 + 4 n + 2 n^2)
            NOx = 14 (0.90 + 0.12 n - 0.02 n^2) (1 - 0.0235 cam)
                  max(0.02, 1 + 0.32 x - 0.08 x^2 - 0.03 x^3) (0.20 + 1.9 P - 0.70 P^2)
            HC  = 6.5 (1.25 - 0.22 n + 0.03 n^2) (1 - 0.12 x + 0.05 x^2 + 0.006 x^3)
                  (0.70 + 0.12/P - 0.008 cam + 4e-11 cam/max(P, 0.22)^16)
            d cam/dt = (c - cam)/0.12;   d m/dt = 0.3 m_fi - m/0.35
            m_f = 0.7 m_fi + m/0.35,     A/F = m_cyl/m_f within 10 to 20

        and the sensor a lag of 0.07 s. P below 0.05 bar counts as 0.05 bar in 1/P, and
        speed below 100 rpm as 100 rpm.
        """
        p, cam, film, sensor = state
        one = jnp.ones_like(p)
        speed = jnp.maximum(drive.speed * one, 100.0)
        n = speed / 1000
        air_in = self._throttle(p, drive.throttle * one)
        air = self._air(p, cam, n)
        injected = air / drive.ratio if drive.fuel is None else drive.fuel * one
        evaporated = film / self.film_time
        fuel = (1 - self.film_share) * injected + evaporated
        ratio = air / jnp.maximum(fuel, 1e-6)
        ratio = jnp.clip(ratio, self.richest, self.leanest)
        charge = 120 * air / (self.cylinders * speed)
        x = ratio - self.stoichiometric
        sensed = ratio if drive.measured is None else drive.measured * one
        derivative = jnp.stack(
            [
                self.manifold_constant * (air_in - air),
                (drive.cam - cam) / self.cam_time,
                self.film_share * injected - evaporated,
                (sensed - sensor) / self.sensor_time,
            ]
        )
        return VctQuantities(
            pressure=p,
            air_in=air_in,
            air=air,
            charge=charge,
            fuel=fuel,
            ratio=ratio,
            torque=self._torque(charge, n, x),
            nox=self._nox(p, cam, n, x),
            hc=self._hc(p, cam, n, x),
            derivative=derivative,
        )

    def balance(self, drive: VctDrive) -> Float[Array, " states"]:
        """The state that does not change under `drive`; NaN where there is none.

        Found by `find_rest` from P = 0.6 bar. First derivatives are exact.
        """
        one = jnp.ones_like(self.air_gain)
        start = jnp.stack([0.6 * one, 10 * one, one, 14.64 * one])

        def rate(state, given):
            engine, drive = given
            return engine.derivative(state, drive)

        drive = jax.tree.map(lambda x: x * one, drive)
        return find_rest(rate, start, (self, drive))

    def steady_state(self, inputs: Float[Array, " inputs"]) -> Float[Array, " states"]:
        """The state that does not change under `inputs`; NaN where there is none."""
        return self.balance(_drive(inputs))

    def rest(self, inputs: Float[Array, " inputs"]):
        """Steady state, the line of A/F to the sensor, and the inputs."""
        drive = _drive(inputs)
        state = self.balance(drive)
        ratio = self.quantities(state, drive).ratio
        return state, jnp.broadcast_to(ratio, (SENSOR_EVENTS,)), inputs

    def advance(self, carry, inputs: Float[Array, " inputs"]):
        """One event of 180 degrees; what depends on the inputs without delay, such as
        torque, is measured before the new ones act. Six events to the A/F sensor."""
        state, ratios, before = carry
        now = self.quantities(state, _drive(before))
        ratios, measured = shift(ratios, now.ratio)
        drive = _drive(inputs)._replace(measured=measured)
        duration = event_duration(EVENT, inputs[3], slowest=SLOWEST)
        outputs = [now.torque, state[3], now.nox, now.hc, now.pressure, state[1]]
        state = hold_inputs(
            lambda y: self.derivative(y, drive), state, duration, steps=SUBSTEPS
        )
        return (state, ratios, inputs), jnp.stack(outputs)

    def margins(self, carry, inputs: Float[Array, " inputs"]):
        """`mixture`, `vacuum` and `cam`; see `vct_margins`."""
        pressure, cam, _, measured = carry[0]
        return vct_margins(pressure, cam, measured)

    def excite(self, key: PRNGKeyArray, length: int) -> Float[Array, "time inputs"]:
        """APRBS on all inputs; see `vct_excitation`."""
        return vct_excitation(key, length)

    def _throttle(self, p, angle):
        """Air flow [g/s]; g_1 = 1 below P_0/2, then 2/P_0 sqrt(P P_0 - P^2), linear
        from 0.97 P_0 to zero at P_0 and on."""
        r = p / self.ambient_pressure
        inner = jnp.clip(r, 0.5, LINEAR)
        line = 2 * math.sqrt(LINEAR - LINEAR**2) / (1 - LINEAR) * (1 - r)
        share = jnp.where(r > LINEAR, line, 2 * root(inner - inner**2))
        cubic = (self.throttle_3 * angle + self.throttle_2) * angle + self.throttle_1
        return share * (cubic * angle + self.throttle_0)

    def _air(self, p, cam, n):
        slope = self.slope_0 + (self.slope_1 + self.slope_2 * cam) * cam
        offset = self.offset_0 + (self.offset_1 + self.offset_2 * cam) * cam
        by_speed = self.air_speed_0 + (self.air_speed_1 + self.air_speed_2 * n) * n
        return self.air_gain * n * by_speed * jnp.maximum(slope * p - offset, 0.0)

    def _torque(self, charge, n, x):
        best = (self.torque_1 + self.torque_2 * charge) * charge
        mix = self.torque_mix_1 + (self.torque_mix_2 + self.torque_mix_3 * x) * x
        friction = self.friction_0 + (self.friction_1 + self.friction_2 * n) * n
        return best * (1 + mix * x) - friction

    def _nox(self, p, cam, n, x):
        by_speed = self.nox_speed_0 + (self.nox_speed_1 + self.nox_speed_2 * n) * n
        mix = self.nox_mix_1 + (self.nox_mix_2 + self.nox_mix_3 * x) * x
        mix = jnp.maximum(1 + mix * x, self.nox_mix_floor)
        load = (self.nox_pressure_1 + self.nox_pressure_2 * p) * p
        load = load + self.nox_pressure_0
        return self.nox_gain * by_speed * (1 + self.nox_cam * cam) * mix * load

    def _hc(self, p, cam, n, x):
        by_speed = self.hc_speed_0 + (self.hc_speed_1 + self.hc_speed_2 * n) * n
        mix = 1 + (self.hc_mix_1 + (self.hc_mix_2 + self.hc_mix_3 * x) * x) * x
        steep = self.hc_steep * jnp.maximum(p, self.hc_steep_floor) ** (
            -self.hc_steep_power
        )
        load = self.hc_constant + self.hc_inverse / jnp.maximum(p, 0.05)
        return self.hc_gain * by_speed * mix * (load + (self.hc_cam + steep) * cam)


def _drive(inputs: Float[Array, " inputs"]) -> VctDrive:
    throttle, cam, ratio, speed = inputs
    return VctDrive(throttle, cam, speed, ratio=ratio)


def vct_excitation(key: PRNGKeyArray, length: int) -> Float[Array, "time inputs"]:
    """Rows of throttle [deg], cam command [deg], A/F command and speed [rpm].

    APRBS in events of 180 degrees: throttle 9.5 to 18, cam 0 to 30, stoichiometric fuel
    times 0.92 to 1.08, each held 30 to 150; speed 900 to 2000, held 80 to 300, through
    a first-order lag of 0.4 s. Section 4.6 of the bed's specification [O].
    """
    keys = jax.random.split(key, 4)
    hold = (30, 150)
    throttle = aprbs(keys[0], length, hold=hold, amplitude=(9.5, 18.0))
    cam = aprbs(keys[1], length, hold=hold, amplitude=(0.0, 30.0))
    fuel = aprbs(keys[2], length, hold=hold, amplitude=(0.92, 1.08))
    target = aprbs(keys[3], length, hold=(80, 300), amplitude=(900.0, 2000.0))

    speed = lagging_speed(target, degrees=EVENT, slowest=SLOWEST, lag=0.4)
    return jnp.stack([throttle, cam, 14.64 / fuel, speed], axis=-1)


def vct_margins(
    pressure: Float[Array, ""], cam: Float[Array, ""], ratio: Float[Array, ""]
) -> dict[str, Float[Array, ""]]:
    """Margins of the model to the end of its validity [O].

    `mixture`: the measured A/F `ratio` inside 11.7 to 17.8. `vacuum`: `pressure` at
    least 0.25 bar. `cam`: at most 20 deg below 0.30 bar.
    """
    return {
        "mixture": jnp.minimum(ratio - 11.7, 17.8 - ratio),
        "vacuum": pressure - 0.25,
        "cam": jnp.maximum(pressure - 0.30, 20.0 - cam),
    }
