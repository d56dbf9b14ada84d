"""A six-cylinder turbocharged diesel engine with VGT and EGR, sampled in time."""

import math
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.data import Channel, Channels
from jaxnarx.engines.bench import Noise
from jaxnarx.engines.delays import lag_and_delay
from jaxnarx.engines.diesel_parts import (
    brake_torque,
    compressor_side,
    diesel_excitation,
    diesel_margins,
    egr_flow,
    exhaust_temperature,
    turbine_side,
)
from jaxnarx.engines.engine import AbstractEngine, Borders, parameter
from jaxnarx.engines.flow import root
from jaxnarx.engines.integration import find_rest, rk4

RPM = math.pi / 30  # rad/s per rpm
SUBSTEP = 0.01  # s; 20 ms is unstable near idle, where the fastest rate is -154 1/s
LONGEST_DELAY = 0.2  # s, that the lines of past inputs can hold


class DieselQuantities(NamedTuple):
    """Everything the model knows at one instant; derivatives are in SI, per second."""

    pressure: Float[Array, ""]  # bar, intake manifold
    exhaust_pressure: Float[Array, ""]  # bar
    oxygen: Float[Array, ""]  # mass fraction, intake manifold
    exhaust_oxygen: Float[Array, ""]  # mass fraction
    turbo: Float[Array, ""]  # rpm
    torque: Float[Array, ""]  # Nm, brake
    oxygen_ratio: Float[Array, ""]  # lambda_O, dimensionless
    egr_share: Float[Array, ""]  # x_egr, dimensionless
    compressor: Float[Array, ""]  # W_c, kg/s
    temperature: Float[Array, ""]  # K, exhaust manifold
    egr: Float[Array, ""]  # W_egr, kg/s
    air: Float[Array, ""]  # W_ei, kg/s, into the cylinders
    exhaust: Float[Array, ""]  # W_eo, kg/s, out of the cylinders
    turbine: Float[Array, ""]  # W_t, kg/s
    turbine_power: Float[Array, ""]  # W, less the bearings' friction
    compressor_power: Float[Array, ""]  # W
    derivative: Float[Array, " states"]


class Diesel(AbstractEngine):
    """Mean value model of a 12.7 L diesel engine with VGT and EGR, at imposed speed.

    States, packed in this order: intake and exhaust manifold pressure p_im, p_em [Pa],
    their oxygen mass fractions X_im, X_em, turbo speed w_t [rad/s], two positions of
    the EGR actuator e1, e2 [%], position v of the VGT actuator [%].

    Inputs: fuel u_d [mg per cylinder and cycle], EGR valve u_e [%, 0 shut], VGT u_v
    [%, 100 open], engine speed N [rpm].

    The bed samples plain time, every `interval` seconds. Quantities that depend on fuel
    and speed without delay, such as torque, are measured before the new inputs act.

    Air flow answers the VGT with either sign: closing from 75 % raises W_c, closing
    from 30 % lowers it. All values are published [P] unless tagged [O], our own choice.

    Reference: J. Wahlström and L. Eriksson, Proc. IMechE Part D 225(7), 960-986, 2011,
    and the parameters its authors distribute.
    """

    displacement: Float[Array, ""] = parameter(0.01274)  # V_d, m^3, all cylinders
    cylinders: Float[Array, ""] = parameter(6.0)
    intake_volume: Float[Array, ""] = parameter(0.022)  # V_im, m^3
    exhaust_volume: Float[Array, ""] = parameter(0.020)  # V_em, m^3
    compression: Float[Array, ""] = parameter(17.0)  # r_c
    gamma_c: Float[Array, ""] = parameter(1.35)  # in the cylinder
    gas_constant: Float[Array, ""] = parameter(287.0)  # R_a, J/(kg K)
    exhaust_gas_constant: Float[Array, ""] = parameter(286.0)  # R_e, J/(kg K)
    heat_capacity: Float[Array, ""] = parameter(1011.0)  # c_pa, J/(kg K)
    exhaust_heat_capacity: Float[Array, ""] = parameter(1332.0)  # c_pe, J/(kg K)
    gamma_a: Float[Array, ""] = parameter(1.3964088397790055)
    gamma_e: Float[Array, ""] = parameter(1.2734225621414914)
    ambient_pressure: Float[Array, ""] = parameter(101111.34146341463)  # Pa
    ambient_temperature: Float[Array, ""] = parameter(298.4636219512196)  # T_amb, K
    wall_temperature: Float[Array, ""] = parameter(298.4636219512196)  # T_w, K
    intake_temperature: Float[Array, ""] = parameter(300.6185731707316)  # T_im, K
    fresh_oxygen: Float[Array, ""] = parameter(0.2314)  # X_Oc
    stoichiometric: Float[Array, ""] = parameter(14.57)  # AF_s
    heating_value: Float[Array, ""] = parameter(42.9e6)  # q_HV, J/kg
    filling_pressure: Float[Array, ""] = parameter(-2.08166198432e-4)  # c_vol1
    filling_speed: Float[Array, ""] = parameter(-3.44651580527e-3)  # c_vol2
    filling_constant: Float[Array, ""] = parameter(1.14970210211)  # c_vol3
    combustion: Float[Array, ""] = parameter(0.6893563004149508)  # eta_igch
    friction_quadratic: Float[Array, ""] = parameter(0.972722756898)  # c_fr1, bar
    friction_linear: Float[Array, ""] = parameter(-0.676883030257)  # c_fr2, bar
    friction_constant: Float[Array, ""] = parameter(0.598189125972)  # c_fr3, bar
    cycle_factor: Float[Array, ""] = parameter(1.1015294624801442)  # eta_sc
    heat_transfer: Float[Array, ""] = parameter(96.27545984019156)  # h_tot, W/(m^2 K)
    pipe_diameter: Float[Array, ""] = parameter(0.1)  # m
    pipe_length: Float[Array, ""] = parameter(1.0)  # m
    pipes: Float[Array, ""] = parameter(2.0)
    egr_area: Float[Array, ""] = parameter(4.0e-4)  # A_egrmax, m^2
    egr_ratio: Float[Array, ""] = parameter(0.6500040483261396)  # Pi_egropt
    egr_quadratic: Float[Array, ""] = parameter(-1.11042379923e-4)  # c_e1
    egr_linear: Float[Array, ""] = parameter(1.77806122861e-2)  # c_e2
    egr_constant: Float[Array, ""] = parameter(0.0)  # c_e3
    egr_overshoot: Float[Array, ""] = parameter(1.8)  # K_egr
    vgt_area: Float[Array, ""] = parameter(8.455767262642882e-4)  # A_vgtmax, m^2
    vgt_exponent: Float[Array, ""] = parameter(2.89019266110711)  # K_t
    vgt_gain: Float[Array, ""] = parameter(1.9479627004385558)  # c_f1
    vgt_offset: Float[Array, ""] = parameter(-0.7763118932867504)  # c_f2
    vgt_width: Float[Array, ""] = parameter(126.87193572285548)  # c_vgt1, %
    vgt_centre: Float[Array, ""] = parameter(117.14474688230767)  # c_vgt2, %
    turbine_radius: Float[Array, ""] = parameter(0.04)  # R_t, m
    turbine_best: Float[Array, ""] = parameter(0.818002726891074)  # eta_tmmax
    blade_ratio: Float[Array, ""] = parameter(0.9755203161802092)  # BSR_opt
    blade_gain: Float[Array, ""] = parameter(1.35634406811)  # c_m1
    blade_start: Float[Array, ""] = parameter(2769.20920158)  # c_m2, rad/s
    blade_power: Float[Array, ""] = parameter(0.0100000987446)  # c_m3
    blade_linear_end: Float[Array, ""] = parameter(2796.9012935924584)  # w_tlin, rad/s
    blade_linear_gain: Float[Array, ""] = parameter(1.4021470818125312)  # c_mlin
    compressor_radius: Float[Array, ""] = parameter(0.04)  # R_c, m
    head_quadratic: Float[Array, ""] = parameter(1.08820510529e-8)  # c_w1
    head_linear: Float[Array, ""] = parameter(-1.73197603597e-4)  # c_w2
    head_constant: Float[Array, ""] = parameter(1.02861647564)  # c_w3
    flow_quadratic: Float[Array, ""] = parameter(-1.42977826851e-8)  # c_p1
    flow_linear: Float[Array, ""] = parameter(-1.54988141455e-3)  # c_p2
    flow_constant: Float[Array, ""] = parameter(29.6461721513)  # c_p3
    compressor_best: Float[Array, ""] = parameter(0.7363607879724583)  # eta_cmax
    best_flow: Float[Array, ""] = parameter(0.27533757461959213)  # W_copt, kg/s
    best_ratio: Float[Array, ""] = parameter(1.045517746825637)  # pi_copt
    ratio_power: Float[Array, ""] = parameter(0.2707594738764899)  # c_pi
    ratio_softening: Float[Array, ""] = parameter(0.0)  # see `compressor_side`
    loss_flow: Float[Array, ""] = parameter(3.09189776853)  # Q_c[0, 0]
    loss_cross: Float[Array, ""] = parameter(-2.48232013832)  # Q_c[0, 1]
    loss_ratio: Float[Array, ""] = parameter(2.14785596204)  # Q_c[1, 1]
    turbo_inertia: Float[Array, ""] = parameter(2.0e-4)  # J_t, kg m^2
    egr_time: Float[Array, ""] = parameter(0.05)  # tau_egr1, s
    egr_slow_time: Float[Array, ""] = parameter(0.13)  # tau_egr2, s
    vgt_time: Float[Array, ""] = parameter(0.025)  # tau_vgt, s
    egr_delay: Float[Array, ""] = parameter(0.065)  # tau_degr, s
    vgt_delay: Float[Array, ""] = parameter(0.040)  # tau_dvgt, s
    interval: float = eqx.field(default=0.1, static=True)  # s

    varied: ClassVar[Mapping[str, float]] = {
        "displacement": 0.3,
        "intake_volume": 1.0,
        "exhaust_volume": 1.0,
        "combustion": 0.2,
        "friction_constant": 1.0,
        "heat_transfer": 1.0,
        "egr_area": 1.0,
        "vgt_area": 0.5,
        "turbine_best": 0.2,
        "compressor_best": 0.2,
        "turbo_inertia": 1.0,
        "egr_time": 2.0,
        "vgt_time": 2.0,
        "egr_delay": 1.0,
        "vgt_delay": 1.0,
    }

    channels: ClassVar[Channels] = Channels(
        inputs=(
            Channel("fuel", "mg"),
            Channel("EGR", "%"),
            Channel("VGT", "%"),
            Channel("speed", "rpm"),
        ),
        outputs=(
            Channel("p_im", "bar"),
            Channel("p_em", "bar"),
            Channel("W_c", "kg/s"),
            Channel("torque", "Nm"),
            Channel("lambda_O", "-"),
            Channel("x_egr", "-"),
            Channel("turbo", "rpm"),
            Channel("X_im", "-"),
            Channel("T_em", "K"),
        ),
    )
    ranges: ClassVar[Borders] = {
        "fuel": (50.0, 140.0),
        "EGR": (0.0, 60.0),
        "VGT": (30.0, 75.0),
        "speed": (1100.0, 1700.0),
    }
    """Ranges of `excite`."""
    domain: ClassVar[Borders] = {
        "fuel": (1.0, 250.0),
        "EGR": (0.0, 100.0),
        "VGT": (20.0, 100.0),
        "speed": (500.0, 2000.0),
    }
    limits: ClassVar[Borders] = {}
    """None: the engine runs on beyond its limits; `flags` says where."""
    noise: ClassVar[Mapping[str, Noise]] = {
        name: Noise(relative=0.006 if name == "W_c" else 0.002)
        for name in channels.output_names
    }
    """0.2 % of the reading, of the air flow 0.6 % [O]."""
    event: ClassVar[float | None] = None
    """None: the bed samples time."""

    @property
    def sample_time(self) -> float:
        """`interval`, 0.1 s by default; exact, the bed does not sample by events."""
        return self.interval

    def derivative(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> Float[Array, " states"]:
        """Rate of change of the eight states, per second, without actuator delays."""
        return self.quantities(state, inputs).derivative

    def quantities(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> DieselQuantities:
        """All quantities of the model at one instant, without actuator delays.

            d p_im/dt = R_a T_im/V_im (W_c + W_egr - W_ei)
            d p_em/dt = R_e T_em/V_em (W_eo - W_t - W_egr)
            d X_im/dt = R_a T_im/(p_im V_im) ((X_em - X_im) W_egr + (X_Oc - X_im) W_c)
            d X_em/dt = R_e T_em/(p_em V_em) (X_e - X_em) W_eo
            d w_t/dt  = (P_tm - P_c)/(J_t w_t)
            d e/dt    = (u_e - e)/tau, twice;  d v/dt = (u_v - v)/tau_vgt

            W_ei = eta_vol p_im N V_d/(120 R_a T_im)
            eta_vol = c_vol1 sqrt(p_im) + c_vol2 sqrt(N) + c_vol3
            lambda_O = W_ei X_im/(W_f AF_s X_Oc)
            X_e  = max(0, (W_ei X_im - W_f AF_s X_Oc)/W_eo)
            4 pi M_e = eta_igch min(1, lambda_O) (1 - r_c^(1-gamma_c)) u_d q_HV n_cyl
                       - V_d (p_em - p_im) - V_d P_fr

        P_fr = 1e5 (c_fr1 n^2 + c_fr2 n + c_fr3), n in krpm. Pressures below 0.1 bar,
        turbo speeds below 50 rad/s and fuel flows below 1e-9 kg/s count as these, so
        that every expression stays finite.
        """
        fuel, egr_command, vgt_command, speed = inputs
        e1, e2, vgt = state[5:]
        intake = jnp.maximum(state[0], 1e4)
        exhaust = jnp.maximum(state[1], 1e4)
        oxygen, exhaust_oxygen = state[2], state[3]
        omega = jnp.maximum(state[4], 50.0)
        gas = self.gas_constant * self.intake_temperature

        filling = (
            self.filling_pressure * jnp.sqrt(intake)
            + self.filling_speed * root(speed)
            + self.filling_constant
        )
        air = filling * intake * speed * self.displacement / (120 * gas)
        burnt = jnp.maximum(1e-6 / 120 * fuel * speed * self.cylinders, 1e-9)
        out = air + burnt
        needed = burnt * self.stoichiometric * self.fresh_oxygen
        oxygen_ratio = air * oxygen / needed
        left_oxygen = jnp.maximum((air * oxygen - needed) / out, 0.0)

        temperature = exhaust_temperature(self, exhaust / intake, burnt, air)
        egr = egr_flow(self, e1, e2, intake, exhaust, temperature)
        turbine, turbine_power = turbine_side(self, vgt, exhaust, temperature, omega)
        compressor, compressor_power = compressor_side(self, intake, omega)
        hot = self.exhaust_gas_constant * temperature / self.exhaust_volume
        cold = gas / self.intake_volume
        derivative = jnp.stack(
            [
                cold * (compressor + egr - air),
                hot * (out - turbine - egr),
                cold
                / intake
                * (
                    (exhaust_oxygen - oxygen) * egr
                    + (self.fresh_oxygen - oxygen) * compressor
                ),
                hot / exhaust * (left_oxygen - exhaust_oxygen) * out,
                (turbine_power - compressor_power) / (self.turbo_inertia * omega),
                (egr_command - e1) / self.egr_time,
                (egr_command - e2) / self.egr_slow_time,
                (vgt_command - vgt) / self.vgt_time,
            ]
        )
        return DieselQuantities(
            pressure=intake / 1e5,
            exhaust_pressure=exhaust / 1e5,
            oxygen=oxygen,
            exhaust_oxygen=exhaust_oxygen,
            turbo=omega / RPM,
            torque=brake_torque(self, fuel, speed, oxygen_ratio, exhaust - intake),
            oxygen_ratio=oxygen_ratio,
            egr_share=egr / (compressor + egr),
            compressor=compressor,
            temperature=temperature,
            egr=egr,
            air=air,
            exhaust=out,
            turbine=turbine,
            turbine_power=turbine_power,
            compressor_power=compressor_power,
            derivative=derivative,
        )

    def steady_state(self, inputs: Float[Array, " inputs"]) -> Float[Array, " states"]:
        """The state that does not change under `inputs`.

        Found by `find_rest` from p_im = 1.5e5, p_em = 1.7e5 Pa, X_im = 0.20,
        X_em = 0.12, w_t = 5000 rad/s. NaN where it finds none. First derivatives are
        exact.
        """
        still = inputs[jnp.asarray([1, 1, 2])]
        start = jnp.asarray([1.5e5, 1.7e5, 0.20, 0.12, 5000.0], still.dtype)

        def rate(gas, given):
            engine, row = given
            state = jnp.concatenate([gas, row[jnp.asarray([1, 1, 2])]])
            return engine.derivative(state, row)[:5]

        return jnp.concatenate([find_rest(rate, start, (self, inputs)), still])

    def rest(self, inputs: Float[Array, " inputs"]):
        """Steady state, and the inputs of the last `LONGEST_DELAY` seconds."""
        held = math.ceil(LONGEST_DELAY / self.interval)
        return self.steady_state(inputs), jnp.tile(inputs, (held, 1))

    def advance(self, carry, inputs: Float[Array, " inputs"]):
        """One sample of `interval` seconds in equal Runge-Kutta steps up to 10 ms.

        Speed and fuel act at once, EGR and VGT through dead times (up to 0.2 s) and
        lags; the actuators move in closed form.
        """
        state, line = carry
        now = self.quantities(state, line[-1])
        line = jnp.concatenate([line, inputs[None]])
        steps = math.ceil(self.interval / SUBSTEP - 1e-9)
        times = jnp.arange(2 * steps + 1, dtype=state.dtype)
        times = times * (self.interval / (2 * steps))
        actuators = jnp.stack(
            [
                lag_and_delay(start, line[:, j], delay, lag, self.interval, times)
                for start, j, delay, lag in (
                    (state[5], 1, self.egr_delay, self.egr_time),
                    (state[6], 1, self.egr_delay, self.egr_slow_time),
                    (state[7], 2, self.vgt_delay, self.vgt_time),
                )
            ],
            axis=-1,
        )
        around = 2 * jnp.arange(steps)[:, None] + jnp.arange(3)[None]
        gas = rk4(
            lambda y, a: self.derivative(jnp.concatenate([y, a]), inputs)[:5],
            state[:5],
            times[2],
            actuators[around],
        )
        outputs = jnp.stack(
            [
                now.pressure,
                now.exhaust_pressure,
                now.compressor,
                now.torque,
                now.oxygen_ratio,
                now.egr_share,
                now.turbo,
                now.oxygen,
                now.temperature,
            ]
        )
        return (jnp.concatenate([gas, actuators[-1]]), line[1:]), outputs

    def margins(self, carry, inputs: Float[Array, " inputs"]):
        """`smoke`, `turbo` and `surge`; see `diesel_margins`."""
        state, line = carry
        now = self.quantities(state, line[-1])
        return diesel_margins(
            *(now.pressure, now.compressor, now.oxygen_ratio, now.turbo * RPM),
            ambient=self.ambient_pressure / 1e5,
        )

    def excite(self, key: PRNGKeyArray, length: int) -> Float[Array, "time inputs"]:
        """APRBS on all inputs; see `diesel_excitation`."""
        return diesel_excitation(key, length, interval=self.interval)
