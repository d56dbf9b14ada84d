"""A naturally aspirated 1.6 L port-injected petrol engine on a dynamometer."""

import math
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from jaxnarx.data import Channel, Channels
from jaxnarx.engines.bench import Noise
from jaxnarx.engines.delays import event_duration, shift
from jaxnarx.engines.engine import AbstractEngine, Borders, parameter
from jaxnarx.engines.flow import throttle_share
from jaxnarx.engines.integration import find_rest, hold_inputs
from jaxnarx.excitation import aprbs


def film_share(bar: Float[Array, ""], n: Float[Array, ""]) -> Float[Array, ""]:
    """Share X of the injected fuel that wets the wall; Aquino 1981 form [P]."""
    return jnp.clip(0.68 - 0.277 * bar - 0.055 * n, 0.05, 0.95)


def film_time(bar: Float[Array, ""], n: Float[Array, ""]) -> Float[Array, ""]:
    """Evaporation time of the film [s]; Hendricks and Sorenson [P], n <= 2.4 [O].

    tau_f = 1.35 (1.68 - 0.672 n)(p_bar - 0.825)^2 + (0.15 - 0.06 n) + 0.56
    """
    n = jnp.minimum(n, 2.4)
    return 1.35 * (1.68 - 0.672 * n) * (bar - 0.825) ** 2 + (0.15 - 0.06 * n) + 0.56


def best_spark(bar: Float[Array, ""], n: Float[Array, ""]) -> Float[Array, ""]:
    """Spark advance th_mbt for best torque [deg BTDC]; Hendricks and Sorenson [P].

    The second branch is used at all speeds, published only above 4800 rpm [O].
    """
    low, high = 47.31 * bar + 2.6214 + 4.7 * n, 79.9 - 56.55 * bar
    return jnp.minimum(jnp.minimum(low, high), 45.0)


def indicated_efficiency(
    bar: Float[Array, ""],
    n: Float[Array, ""],
    ratio: Float[Array, ""],
    advance: Float[Array, ""],
) -> Float[Array, ""]:
    """Indicated efficiency; `ratio` is lambda, `advance` in degrees from th_mbt.

        eta_n  = 0.558 (1 - 0.392 n^-0.36)
        eta_p  = 0.9301 + 0.2154 p_bar - 0.1657 p_bar^2
        eta_l  = min(-1.299 + 3.599 l - 1.332 l^2, -0.0205 + 1.741 l - 0.745 l^2) >= 0,
                 l = clip(lambda, 0.55, 1.6)
        eta_th = max(0, 1 - 0.00048 advance^2)

    Hendricks and Sorenson 1990 [P]. The two branches of eta_l are published as a switch
    at lambda = 1, where they differ by 0.0075; the minimum joins them at 1.011 [O]. The
    sources print eta_th with an offset of 25 degrees; read this way it peaks at th_mbt.
    """
    by_speed = 0.558 * (1 - 0.392 * n**-0.36)
    by_pressure = 0.9301 + 0.2154 * bar - 0.1657 * bar**2
    mix = jnp.clip(ratio, 0.55, 1.6)
    rich = -1.299 + 3.599 * mix - 1.332 * mix**2
    lean = -0.0205 + 1.741 * mix - 0.745 * mix**2
    by_mixture = jnp.maximum(jnp.minimum(rich, lean), 0.0)
    by_spark = jnp.maximum(1 - 0.00048 * advance**2, 0.0)
    return by_speed * by_pressure * by_mixture * by_spark


RPM = math.pi / 30  # rad/s per rpm
STALL = 450.0  # rpm
EVENT = 180.0  # degrees crank angle
SUBSTEPS = 4  # 16.7 ms each at the stall speed, where an event is longest
VALVE_EVENTS = 2
TORQUE_EVENTS = 2


class Drive(NamedTuple):
    """Inputs that are imposed on the engine; an entry that is `None` takes care of
    itself.

    `duty` of the air bleed valve [-]. `pulse` width of the injector [ms], else the
    stoichiometric feed-forward. `spark` advance [deg BTDC], else the default schedule.
    `load` torque [Nm], else the load curve. `speed` [rpm] if the dynamometer holds it,
    else the engine is free. `indicated` torque [Nm] if it comes out of a delay line,
    else that of the present state.
    """

    duty: ScalarLike
    pulse: ScalarLike | None = None
    spark: ScalarLike | None = None
    load: ScalarLike | None = None
    speed: ScalarLike | None = None
    indicated: ScalarLike | None = None


class Quantities(NamedTuple):
    """Everything the model knows at one instant; derivatives are per second."""

    speed: Float[Array, ""]  # rpm
    pressure: Float[Array, ""]  # kPa, intake manifold
    air_in: Float[Array, ""]  # g/s, through valve and leak
    air: Float[Array, ""]  # g/s, into the cylinders
    pulse: Float[Array, ""]  # ms
    fuel: Float[Array, ""]  # g/s, into the cylinders
    ratio: Float[Array, ""]  # lambda, dimensionless
    spark: Float[Array, ""]  # deg BTDC
    efficiency: Float[Array, ""]  # indicated, dimensionless
    film_share: Float[Array, ""]  # share of injected fuel that wets the wall
    film_time: Float[Array, ""]  # s
    indicated: Float[Array, ""]  # Nm, before the delay
    torque: Float[Array, ""]  # Nm, brake
    load: Float[Array, ""]  # Nm
    derivative: Float[Array, " states"]


class Pfi(AbstractEngine):
    """Mean value model of a 1.6 L port fuel injected engine, driven by its air bleed.

    States, packed in this order: manifold pressure p_m [Pa], fuel film m_ff [kg], valve
    flow W_v [kg/s], crank speed omega [rad/s]. Below, n is speed in krpm and p_bar the
    manifold pressure in bar.

    On the bench (`simulate`) the speed is free, the input is the valve duty, the
    outputs are speed and manifold pressure, fuel and spark follow their schedules.

    Tags: [P] published, [O] our own choice. The published coefficients describe a
    1.275 L engine; only friction and pumping are scaled here.

    References: E. Hendricks and S. C. Sorenson, SAE 900616, 1990, and SAE 910258, 1991;
    E. Hendricks et al., SAE 960037, 1996; C. F. Aquino, SAE 810494, 1981.
    """

    displacement: Float[Array, ""] = parameter(1.597e-3)  # V_d, m^3 [O]
    cylinders: Float[Array, ""] = parameter(4.0)
    manifold_volume: Float[Array, ""] = parameter(2.6e-3)  # V_m, m^3 [O]
    manifold_temperature: Float[Array, ""] = parameter(308.0)  # T_m, K [O]
    gas_constant: Float[Array, ""] = parameter(287.0)  # R, J/(kg K)
    ambient_pressure: Float[Array, ""] = parameter(1.013e5)  # p_a, Pa
    pumping_slope: Float[Array, ""] = parameter(0.952)  # s [P]
    pumping_offset: Float[Array, ""] = parameter(0.075e5)  # y, Pa [P]
    valve_flow: Float[Array, ""] = parameter(14.0e-3)  # W_max, kg/s [O]
    valve_centre: Float[Array, ""] = parameter(0.42)  # d_c [O]
    valve_width: Float[Array, ""] = parameter(0.02)  # s_d [O]
    valve_time: Float[Array, ""] = parameter(0.08)  # tau_v, s [O]
    leak_flow: Float[Array, ""] = parameter(0.8e-3)  # W_leak, kg/s [O]
    injector_gain: Float[Array, ""] = parameter(2.2)  # K_inj, mg/ms [O]
    injector_offset: Float[Array, ""] = parameter(0.70)  # t_0, ms [O]
    stoichiometric: Float[Array, ""] = parameter(14.67)  # AF_s [P]
    heating_value: Float[Array, ""] = parameter(43.0e6)  # H_u, J/kg [P]
    friction_scale: Float[Array, ""] = parameter(1.597 / 1.275)  # k_fr [O]
    inertia: Float[Array, ""] = parameter(0.40)  # J, engine and dyno, kg m^2 [O]
    load_constant: Float[Array, ""] = parameter(4.0)  # Nm [O]
    load_quadratic: Float[Array, ""] = parameter(4.0)  # Nm per krpm^2 [O]

    varied: ClassVar[Mapping[str, float]] = {
        "displacement": 0.5,
        "manifold_volume": 1.0,
        "pumping_slope": 0.3,
        "valve_flow": 1.0,
        "valve_centre": 0.1,  # 1 % here shifts the map by a seventh of its range
        "valve_width": 0.5,
        "valve_time": 2.0,
        "leak_flow": 2.0,
        "injector_gain": 0.5,
        "friction_scale": 1.0,
        "inertia": 1.0,
        "load_constant": 1.0,
        "load_quadratic": 1.0,
    }

    channels: ClassVar[Channels] = Channels(
        inputs=(Channel("duty", "-"),),
        outputs=(Channel("speed", "rpm"), Channel("MAP", "kPa")),
    )
    ranges: ClassVar[Borders] = {"duty": (0.38, 0.41)}
    domain: ClassVar[Borders] = {"duty": (0.0, 1.0)}
    """Any duty: the valve's law is a sigmoid. Below 0.36 the engine stalls."""
    limits: ClassVar[Borders] = {"speed": (STALL, float("inf"))}
    """Below 450 rpm the engine counts as stalled [O]."""
    noise: ClassVar[Mapping[str, Noise]] = {"speed": Noise(2.5), "MAP": Noise(0.3)}
    """2.5 rpm, and 0.3 kPa as for crank-synchronous averages [O]."""
    event: ClassVar[float | None] = EVENT
    """180 degrees crank angle."""

    @property
    def sample_time(self) -> float:
        """0.03 s: 180 deg at 1000 rpm. The true value is 30/N seconds at N rpm."""
        return 0.03

    def derivative(
        self, state: Float[Array, " states"], drive: Drive
    ) -> Float[Array, " states"]:
        """Rate of change of `[p_m, m_ff, W_v, omega]`, per second.

        A held speed is a state that does not change: its rate is zero.
        """
        return self.quantities(state, drive).derivative

    def quantities(self, state: Float[Array, " states"], drive: Drive) -> Quantities:
        """All quantities of the model at one instant.

            d p_m/dt  = R T_m/V_m (W_in - W_ap)       W_in = (W_v + W_leak) beta2
            W_ap      = V_d N/(120 R T_m) max(0, s p_m - y)              [P form]
            W_fi      = n_cyl K_inj max(0, FPW - t_0) N/120
            d m_ff/dt = X W_fi - m_ff/tau_f       W_f = (1 - X) W_fi + m_ff/tau_f
            d W_v/dt  = (W_max/(1 + exp(-(d - d_c)/s_d)) - W_v)/tau_v         [O]
            J d omega/dt = T_ind - T_fr - T_L      T_ind = H_u eta_i W_f/omega

        with the stoichiometric feed-forward FPW = t_0 + 120 W_ap/(AF_s N n_cyl K_inj)
        and the default spark clip(th_mbt - 3, 8, 40) [O]. Speeds below 100 rpm count as
        100 rpm, far below stall, so that every expression stays finite.

        Reference: Hendricks and Sorenson, SAE 900616; fuel film Aquino, SAE 810494.
        """
        p, film, valve, omega = state
        if drive.speed is not None:
            omega = jnp.asarray(drive.speed, state.dtype) * RPM
        omega = jnp.maximum(omega, 100.0 * RPM)
        speed = omega / RPM
        n, bar = speed / 1000, p / 1e5
        gas = self.gas_constant * self.manifold_temperature

        air_in = (valve + self.leak_flow) * throttle_share(p / self.ambient_pressure)
        charge = jnp.maximum(self.pumping_slope * p - self.pumping_offset, 0.0)
        air = self.displacement * speed / (120 * gas) * charge

        injection = self.cylinders * self.injector_gain * 1e-6 * speed / 120  # kg/s/ms
        pulse = self.injector_offset + air / (self.stoichiometric * injection)
        pulse = _value_or_default(drive.pulse, pulse)
        injected = injection * jnp.maximum(pulse - self.injector_offset, 0.0)
        share, time = film_share(bar, n), film_time(bar, n)
        evaporated = film / time
        fuel = (1 - share) * injected + evaporated
        ratio = air / (self.stoichiometric * jnp.maximum(fuel, 1e-9))

        best = best_spark(bar, n)
        spark = _value_or_default(drive.spark, jnp.clip(best - 3, 8.0, 40.0))
        efficiency = indicated_efficiency(bar, n, ratio, spark - best)
        indicated = self.heating_value * efficiency * fuel / omega
        torque = _value_or_default(drive.indicated, indicated) - self._friction(bar, n)
        load = self.load_constant + self.load_quadratic * n**2
        load = _value_or_default(drive.load, load)

        rate = (torque - load) / self.inertia
        derivative = jnp.stack(
            [
                gas / self.manifold_volume * (air_in - air),
                share * injected - evaporated,
                (self._valve_target(drive.duty) - valve) / self.valve_time,
                rate if drive.speed is None else jnp.zeros_like(rate),
            ]
        )
        return Quantities(
            speed=speed,
            pressure=p / 1e3,
            air_in=1e3 * air_in,
            air=1e3 * air,
            pulse=pulse,
            fuel=1e3 * fuel,
            ratio=ratio,
            spark=spark,
            efficiency=efficiency,
            film_share=share,
            film_time=time,
            indicated=indicated,
            torque=torque,
            load=load,
            derivative=derivative,
        )

    def balance(self, drive: Drive) -> Float[Array, " states"]:
        """The state that does not change under `drive`, at free or held speed.

        Found by `find_rest` from p_m = 0.35e5 Pa, m_ff = 1.2e-4 kg, W_v = 2e-3 kg/s,
        omega = 100 rad/s. NaN where it finds no steady state.
        """
        start = jnp.asarray([0.35e5, 1.2e-4, 2e-3, 100.0], self.displacement.dtype)
        drive = jax.tree.map(lambda value: jnp.asarray(value, start.dtype), drive)
        if drive.speed is None:
            return find_rest(_rate, start, (self, drive))

        def rate(part: Float[Array, " unknowns"], given) -> Float[Array, " unknowns"]:
            return _rate(jnp.append(part, start[3]), given)[:3]

        found = find_rest(rate, start[:3], (self, drive))
        return jnp.append(found, drive.speed * RPM)

    def steady_state(self, inputs: Float[Array, " inputs"]) -> Float[Array, " states"]:
        """The state that does not change under `inputs`, at free speed."""
        return self.balance(Drive(inputs[0]))

    def rest(self, inputs: Float[Array, " inputs"]):
        """Free-running steady state, and the delay lines of duty and torque."""
        state = self.steady_state(inputs)
        indicated = self.quantities(state, Drive(inputs[0])).indicated
        duties = jnp.broadcast_to(inputs[0], (VALVE_EVENTS,))
        return state, duties, jnp.broadcast_to(indicated, (TORQUE_EVENTS,))

    def advance(self, carry, inputs: Float[Array, " inputs"]):
        """One event of 180 degrees at free speed.

        Dead times [O]: two events from duty to valve, two from induction to torque.
        """
        state, duties, torques = carry
        duties, duty = shift(duties, inputs[0])
        now = self.quantities(state, Drive(duty))
        torques, indicated = shift(torques, now.indicated)
        drive = Drive(duty, indicated=indicated)
        duration = event_duration(EVENT, now.speed, slowest=STALL)
        state = hold_inputs(
            lambda x: self.derivative(x, drive), state, duration, steps=SUBSTEPS
        )
        return (state, duties, torques), jnp.stack([now.speed, now.pressure])

    def margins(self, carry, inputs: Float[Array, " inputs"]):
        """`stall` below 450 rpm; `mixture` outside lambda 0.7 to 1.35, where rapid
        opening brings it for moments [O]."""
        state, duties, _ = carry
        now = self.quantities(state, Drive(duties[0]))
        return pfi_margins(now)

    def excite(self, key: PRNGKeyArray, length: int) -> Float[Array, "time inputs"]:
        """APRBS on the valve, 0.38 to 0.41, hold 20 to 120 events [O]."""
        span = self.ranges["duty"]
        return aprbs(key, length, hold=(20, 120), amplitude=span)[:, None]

    def _valve_target(self, duty: ScalarLike) -> Float[Array, ""]:
        position = (duty - self.valve_centre) / self.valve_width
        return self.valve_flow / (1 + jnp.exp(-position))

    def _friction(self, bar: Float[Array, ""], n: Float[Array, ""]) -> Float[Array, ""]:
        """Friction and pumping torque [Nm], Hendricks and Sorenson 1990 [P], scaled.

        P_fp = 1000 k_fr [n (1.673 + 0.272 n + 0.0135 n^2) + n p_bar (-0.969 + 0.206 n)]
        in watts; divided by omega = 1000 n pi/30.
        """
        per_speed = 1.673 + 0.272 * n + 0.0135 * n**2 + bar * (-0.969 + 0.206 * n)
        return self.friction_scale * per_speed / RPM


def _value_or_default(
    value: ScalarLike | None, otherwise: Float[Array, ""]
) -> Float[Array, ""]:
    if value is None:
        return otherwise
    return jnp.asarray(value, otherwise.dtype)


def pfi_margins(now: Quantities) -> dict[str, Float[Array, ""]]:
    """Speed above the stall [rpm], and lambda inside 0.7 to 1.35 [O]."""
    return {
        "stall": now.speed - STALL,
        "mixture": jnp.minimum(now.ratio - 0.7, 1.35 - now.ratio),
    }


def _rate(state: Float[Array, " states"], given) -> Float[Array, " states"]:
    engine, drive = given
    return engine.derivative(state, drive)
