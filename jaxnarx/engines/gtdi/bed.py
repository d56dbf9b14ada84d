"""A turbocharged 2.0 L direct-injection petrol engine at imposed speed."""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.data import Channel, Channels
from jaxnarx.engines.bench import Noise
from jaxnarx.engines.delays import delay_staircase, event_duration, shift
from jaxnarx.engines.engine import AbstractEngine, Borders, parameter
from jaxnarx.engines.flow import Gas, orifice, petrol_exhaust, tail_flow
from jaxnarx.engines.gtdi.cylinder import Cylinders
from jaxnarx.engines.gtdi.operation import gtdi_demands, schedule_inputs
from jaxnarx.engines.gtdi.state import (
    EVENT,
    SLOWEST,
    GtdiDrive,
    GtdiQuantities,
    gtdi_margins,
    impose_columns,
    value_or_default,
)
from jaxnarx.engines.gtdi.turbo import Compressor, Turbine
from jaxnarx.engines.integration import find_rest, rk4

KRPM = 1e-3 * 60 / (2 * 3.141592653589793)  # krpm per rad/s
SUBSTEP = 1e-3  # s; explicit, so stability asks for it
SUBSTEPS = 30  # most in an event, at the slowest speed
FEWEST = 10  # in an event; at full load the fastest rate grows with speed
THROTTLE_EVENTS = 3  # 16 ms at 5500 rpm, longer than the dead time
TORQUE_EVENTS = 1  # 270 deg, rounded down [O]
MIXTURE_EVENTS = 3  # 540 deg [O]
START = (1.05e5, 0.7e5, 1.1e5, 1.03e5, 6000.0)  # p_b, p_im, p_em, p_t, w


class Gtdi(AbstractEngine):
    """Component model of a 2.0 L turbocharged spark ignition engine.

    States, packed in this order: throttle th [deg], wastegate x_wg [0 to 1], pressures
    before the throttle p_b, in the intake p_im, in the exhaust manifold p_em and after
    the turbine p_t [Pa], turbo speed w [rad/s].

    On the bench (`simulate`) fuel, spark, throttle and speed are inputs; the outputs
    are torque, air-fuel ratio and intake pressure, behind delays and sensors. The
    mixture leaves the flammable range within a few events unless fuel follows the air:
    see `schedule_inputs`, which `excite` uses, and `operate`.

    Tags: [P] published, [D] calibrated on measurements and not validated, [O] our own
    choice. A plausible plant of the right kind and size, not a model of a product.

    References: L. Eriksson, Oil & Gas Science and Technology 62(4), 2007, 523-538;
    L. Eriksson and L. Nielsen, Modeling and Control of Engines and Drivelines, Wiley
    2014; E. Frisk, M. Krysander, D. Jung, IFAC 2017 (parameters, MIT licence).
    """

    cylinders: Cylinders = eqx.field(default_factory=Cylinders)
    compressor: Compressor = eqx.field(default_factory=Compressor)
    turbine: Turbine = eqx.field(default_factory=Turbine)
    fresh: Gas = eqx.field(default_factory=Gas)  # R_a, cp_a, g_a
    burnt: Gas = eqx.field(default_factory=petrol_exhaust)
    ambient_pressure: Float[Array, ""] = parameter(1.013e5)  # p_amb, Pa
    ambient_temperature: Float[Array, ""] = parameter(298.0)  # T_amb, K
    cooler_loss: Float[Array, ""] = parameter(3.47e8)  # H_ic, Pa^2 s^2/(kg^2 K) [P]
    cooler_effect: Float[Array, ""] = parameter(0.8)  # eps_ic [P]
    intake_heating: Float[Array, ""] = parameter(5.0)  # dT_im, K [D]
    throttle_leak: Float[Array, ""] = parameter(1.0e-5)  # a_0, m^2 [D]
    throttle_slope: Float[Array, ""] = parameter(1.7e-4)  # a_1, m^2 [D]
    throttle_square: Float[Array, ""] = parameter(2.63e-3)  # a_2, m^2 [D]
    throttle_shut: Float[Array, ""] = parameter(4.0)  # deg
    throttle_travel: Float[Array, ""] = parameter(86.0)  # deg
    throttle_time: Float[Array, ""] = parameter(0.025)  # tau_th, s [D]
    throttle_dead_time: Float[Array, ""] = parameter(0.015)  # s [D]
    tail_loss: Float[Array, ""] = parameter(1.75e8)  # H_es, Pa^2 s^2/(kg^2 K) [D]
    tail_linear: Float[Array, ""] = parameter(1500.0)  # d_lin, Pa [O]
    wastegate_area: Float[Array, ""] = parameter(4.909e-4)  # A_wg, m^2 [P]
    wastegate_discharge: Float[Array, ""] = parameter(0.9)  # Cd [O]
    wastegate_opens: Float[Array, ""] = parameter(0.85e5)  # b_0, Pa gauge [O]
    wastegate_travel: Float[Array, ""] = parameter(0.50e5)  # b_1, Pa [O]
    wastegate_time: Float[Array, ""] = parameter(0.1)  # tau_wg, s [P]
    boost_volume: Float[Array, ""] = parameter(10.7e-3)  # V_b, m^3 [P]
    intake_volume: Float[Array, ""] = parameter(1.8e-3)  # V_im, m^3 [P]
    exhaust_volume: Float[Array, ""] = parameter(3.0e-3)  # V_em, m^3, listed 1.59 [O]
    tail_volume: Float[Array, ""] = parameter(0.020)  # V_t, m^3 [P]
    inertia: Float[Array, ""] = parameter(2.0e-5)  # J, kg m^2, listed 1.25e-4 [D]
    bearing: Float[Array, ""] = parameter(9.7e-7)  # xi, N m s [P]
    torque_time: Float[Array, ""] = parameter(0.02)  # shaft and sensor, s [O]
    mixture_time: Float[Array, ""] = parameter(0.20)  # lambda sensor, s [D]

    varied: ClassVar[Mapping[str, float]] = {
        "cylinders.displacement": 0.3,
        "cylinders.efficiency": 0.3,
        "turbine.gain": 0.5,
        "cooler_effect": 0.3,
        "throttle_square": 1.0,
        "tail_loss": 1.0,
        "wastegate_opens": 0.5,
        "boost_volume": 1.0,
        "intake_volume": 1.0,
        "inertia": 2.0,
        "throttle_time": 1.0,
        "mixture_time": 1.0,
    }

    channels: ClassVar[Channels] = Channels(
        inputs=(
            Channel("FUL", "mg/stroke"),
            Channel("SA", "deg"),
            Channel("THR", "deg"),
            Channel("speed", "rpm"),
        ),
        outputs=(
            Channel("TRQ", "Nm"),
            Channel("AFR", "-"),
            Channel("MAP", "kPa"),
        ),
    )
    ranges: ClassVar[Borders] = {
        "FUL": (8.0, 75.0),
        "SA": (-10.0, 42.0),
        "THR": (4.0, 90.0),
        "speed": (SLOWEST, 5500.0),
    }
    """Fuel and spark depend on each other and on the rest: see `schedule_inputs`."""
    domain: ClassVar[Borders] = {
        "FUL": (4.0, 90.0),
        "SA": (-36.0, 62.0),
        "THR": (4.0, 90.0),
        "speed": (SLOWEST, 5500.0),
    }
    """Fuel 8 to 75 mg at lambda one, spark -40 to 20 degrees from a best of 4 to
    42; both widened as far as the excitation and a change of engine lead [O]."""
    limits: ClassVar[Borders] = {}
    """None: a run is not ended, `flags` flags the samples."""
    noise: ClassVar[Mapping[str, Noise]] = {
        "TRQ": Noise(0.4),
        "AFR": Noise(0.03),
        "MAP": Noise(0.3),
    }
    """0.4 Nm, 0.03, and 0.3 kPa as for crank-synchronous averages [O]."""
    event: ClassVar[float | None] = EVENT
    """180 degrees crank angle."""

    @property
    def sample_time(self) -> float:
        """0.015 s: 180 deg at 2000 rpm. The true value is 30/N seconds at N rpm."""
        return 0.015

    def derivative(
        self, state: Float[Array, " states"], drive: GtdiDrive
    ) -> Float[Array, " states"]:
        """Rate of change of `[th, x_wg, p_b, p_im, p_em, p_t, w]`, per second."""
        return self.quantities(state, drive).derivative

    def quantities(
        self, state: Float[Array, " states"], drive: GtdiDrive
    ) -> GtdiQuantities:
        """All quantities of the model at one instant.

            d th/dt   = (THR - th)/tau_th
            d x_wg/dt = (clip((p_b - p_amb - b_0)/b_1, 0, 1) - x_wg)/tau_wg
            d p_b/dt  = R_a T_b/V_b (W_c - W_th)      T_b  = T_amb + dT_c (1 - eps_ic)
            d p_im/dt = R_a T_im/V_im (W_th - W_ac)   T_im = T_b + dT_im
            d p_em/dt = R_e T_em/V_em (W_ac + W_f - W_t - W_wg)
            d p_t/dt  = R_e T_t/V_t (W_t + W_wg - W_es)
            d w/dt    = (P_t - P_c)/(J w) - xi w/J

        with W_th through the throttle area a_0 + a_1 x + a_2 x^2, x = (th - 4)/86, from
        p_ic = p_b - H_ic W_c^2 (T_amb + dT_c)/p_b, and the gas behind the turbine at
        T_t = T_em (1 - W_t h eta_t/(W_t + W_wg)). Pressures below 0.02 bar and turbo
        speeds below 100 rad/s count as these, so that every expression stays finite.

        Reference: Eriksson 2007.
        """
        throttle, wastegate = state[0], state[1]
        p_b, p_im, p_em, p_t = jnp.maximum(state[2:6], 2e3)
        turbo = jnp.maximum(state[6], 100.0)
        speed = jnp.asarray(drive.speed, state.dtype)
        p_amb, t_amb = self.ambient_pressure, self.ambient_temperature

        cold = self.compressor(p_b, turbo, p_amb, t_amb, self.fresh)
        t_b = t_amb + cold.rise * (1 - self.cooler_effect)
        t_im = t_b + self.intake_heating
        drop = self.cooler_loss * cold.flow**2 * (t_amb + cold.rise) / p_b
        p_ic = jnp.maximum(p_b - drop, 0.2 * p_b)
        w_th = self._throttle_area(throttle) * orifice(p_im, p_ic, t_b, self.fresh)

        cylinders = self.cylinders
        w_ac = cylinders.air(p_im, speed, p_im / (self.fresh.constant * t_im))
        needed = cylinders.stoichiometric_fuel(w_ac, speed)
        fuel = value_or_default(drive.fuel, needed * drive.richness)
        best = cylinders.best_spark(p_im, speed)
        schedule = cylinders.knock_limited_spark(p_im, speed)
        spark = value_or_default(drive.spark, schedule + drive.offset)
        burn = cylinders.burn(w_ac, fuel, spark - best, speed, t_amb, self.burnt.heat)
        drag = cylinders.drag(p_em - p_im, speed)

        hot = self.turbine(p_em, p_t, burn.temperature, turbo, self.burnt)
        area = wastegate * self.wastegate_discharge * self.wastegate_area
        w_wg = area * orifice(p_t, p_em, burn.temperature, self.burnt)
        w_out = hot.flow + w_wg
        t_t = burn.temperature * (1 - hot.flow * hot.cooling / (w_out + 1e-9))
        w_es = tail_flow(p_t, p_amb, t_t, self.tail_loss, self.tail_linear)

        opening = (p_b - p_amb - self.wastegate_opens) / self.wastegate_travel
        fresh, burnt = self.fresh.constant, self.burnt.constant
        exhaust = w_ac + burn.fuel - w_out
        push = (hot.power - cold.power) / turbo - self.bearing * turbo
        derivative = jnp.stack(
            [
                (drive.throttle - throttle) / self.throttle_time,
                (jnp.clip(opening, 0.0, 1.0) - wastegate) / self.wastegate_time,
                fresh * t_b / self.boost_volume * (cold.flow - w_th),
                fresh * t_im / self.intake_volume * (w_th - w_ac),
                burnt * burn.temperature / self.exhaust_volume * exhaust,
                burnt * t_t / self.tail_volume * (w_out - w_es),
                push / self.inertia,
            ]
        )
        return GtdiQuantities(
            fuel=fuel,
            spark=spark,
            best_spark=best,
            torque=burn.indicated - drag,
            indicated=burn.indicated,
            drag=drag,
            ratio=burn.ratio,
            afr=cylinders.stoichiometric * burn.ratio,
            pressure=p_im / 1e3,
            boost=p_b / 1e3,
            back_pressure=p_em / 1e3,
            turbo=turbo * KRPM,
            temperature=burn.temperature,
            wastegate=wastegate,
            compressor_flow=1e3 * cold.flow,
            throttle_flow=1e3 * w_th,
            air=1e3 * w_ac,
            fuel_flow=1e3 * burn.fuel,
            turbine_flow=1e3 * w_out,
            tail_flow=1e3 * w_es,
            compressor_power=cold.power,
            turbine_power=hot.power,
            surge_margin=cold.margin,
            derivative=derivative,
        )

    def balance(self, drive: GtdiDrive) -> Float[Array, " states"]:
        """The state that does not change under `drive`; NaN where there is none.

        Found by `find_rest` from a fixed start; throttle and wastegate are where the
        other five states put them. First derivatives are exact.
        """
        start = jnp.asarray(START, self.inertia.dtype)
        drive = jax.tree.map(lambda v: jnp.asarray(v, start.dtype), drive)

        def rate(rest: Float[Array, " unknowns"], given) -> Float[Array, " unknowns"]:
            engine, drive = given
            return engine.derivative(engine._settled(rest, drive), drive)[2:]

        return self._settled(find_rest(rate, start, (self, drive)), drive)

    def steady_state(self, inputs: Float[Array, " inputs"]) -> Float[Array, " states"]:
        """The state that does not change under `inputs`; NaN where there is none."""
        return self.balance(impose_columns(inputs))

    def rest(self, inputs: Float[Array, " inputs"]):
        """Steady state under constant inputs, with sensors and delay lines settled."""
        return self.settled_bench(self.steady_state(inputs), inputs)

    def settled_bench(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ):
        """The state that `advance` carries when `state` has been there for long.

        In this order: states, readings of torque and air-fuel ratio, past throttle
        commands, durations of the past events [s], delay lines of the indicated torque
        [Nm] and of the air-fuel ratio.
        """
        now = self.quantities(state, impose_columns(inputs))
        duration = event_duration(EVENT, inputs[3], slowest=SLOWEST)
        return (
            state,
            jnp.stack([now.torque, now.afr]),
            jnp.broadcast_to(inputs[2], (THROTTLE_EVENTS,)),
            jnp.broadcast_to(duration, (THROTTLE_EVENTS - 1,)),
            jnp.broadcast_to(now.indicated, (TORQUE_EVENTS,)),
            jnp.broadcast_to(now.afr, (MIXTURE_EVENTS,)),
        )

    def advance(self, carry, inputs: Float[Array, " inputs"]):
        """One event of 180 degrees at the imposed speed.

        Runge-Kutta steps of fourth order, as many as keep them at 1 ms or below, but at
        least ten. The throttle command arrives 15 ms late [D], inside an event if need
        be; torque one event and mixture three events [O]. The sensors sample at the
        start of the event and hold; torque lags it by 0.02 s [O], the lambda sensor by
        0.20 s [D].
        """
        state, readings, commands, durations, torques, ratios = carry
        now = self.quantities(state, impose_columns(inputs))
        torques, indicated = shift(torques, now.indicated)
        ratios, mixture = shift(ratios, now.afr)
        duration = event_duration(EVENT, inputs[3], slowest=SLOWEST)
        outputs = jnp.append(readings, now.pressure)

        seen = jnp.stack([indicated - now.drag, mixture])
        kept = jnp.exp(-duration / jnp.stack([self.torque_time, self.mixture_time]))
        readings = seen + (readings - seen) * kept

        count = jnp.clip(jnp.ceil(duration / SUBSTEP - 1e-6), FEWEST, SUBSTEPS)
        step = duration / count
        levels = jnp.append(commands, inputs[2])
        late = delay_staircase(
            levels, durations, step, self.throttle_dead_time, steps=SUBSTEPS
        )
        state = rk4(
            lambda x, throttle: self.derivative(x, impose_columns(inputs, throttle[0])),
            state,
            step,
            jnp.broadcast_to(late[:, None, None], (SUBSTEPS, 3, 1)),
            count=count.astype(int),
        )
        durations = shift(durations, duration)[0]
        return (state, readings, levels[1:], durations, torques, ratios), outputs

    def margins(self, carry, inputs: Float[Array, " inputs"]):
        """`mixture`, `heat`, `boost`, `turbo`, `vacuum`, `surge` and `spark`; see
        `gtdi_margins`."""
        return gtdi_margins(self.quantities(carry[0], impose_columns(inputs)))

    def excite(self, key: PRNGKeyArray, length: int) -> Float[Array, "time inputs"]:
        """`gtdi_demands`, with fuel and spark set by `scheduled`."""
        return schedule_inputs(self, gtdi_demands(key, length))[0]

    def _throttle_area(self, angle: Float[Array, ""]) -> Float[Array, ""]:
        x = (angle - self.throttle_shut) / self.throttle_travel
        return (
            self.throttle_leak + self.throttle_slope * x + self.throttle_square * x**2
        )

    def _settled(
        self, rest: Float[Array, " unknowns"], drive: GtdiDrive
    ) -> Float[Array, " states"]:
        """The state with throttle and wastegate where the other five put them."""
        over = rest[0] - self.ambient_pressure - self.wastegate_opens
        opening = jnp.clip(over / self.wastegate_travel, 0.0, 1.0)
        throttle = jnp.asarray(drive.throttle, rest.dtype)
        return jnp.concatenate([jnp.stack([throttle, opening]), rest])
