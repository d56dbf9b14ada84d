"""Compressor and turbine of the turbocharged engine."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.engines.engine import parameter
from jaxnarx.engines.flow import Gas

SURGE = 1e-6  # squared flow coefficient below which the compressor surges


class Compression(NamedTuple):
    """Flow, temperature and power of the compressor at one instant."""

    flow: Float[Array, ""]  # W_c, kg/s
    rise: Float[Array, ""]  # dT_c, K
    power: Float[Array, ""]  # P_c, W
    efficiency: Float[Array, ""]  # eta_c, dimensionless
    margin: Float[Array, ""]  # a, squared flow coefficient; surge at 1e-6 and below


class Compressor(eqx.Module):
    """Radial compressor behind an air filter.

    Ellipse between head and flow coefficient, and a quadratic form for the efficiency.
    Parameters of a 2.0 L engine as distributed by Frisk et al. 2017 [P]; the air
    filter is calibrated on a public engine map [D].

    References: L. Eriksson, Oil & Gas Science and Technology 62(4), 2007, 523-538;
    E. Frisk, M. Krysander, D. Jung, A toolbox for analysis and design of model based
    diagnosis systems for large scale models, IFAC 2017.
    """

    filter: Float[Array, ""] = parameter(8.6e7)  # H_af, Pa^2 s^2/(kg^2 K) [D]
    diameter: Float[Array, ""] = parameter(0.0394)  # D_c, m [P]
    head: Float[Array, ""] = parameter(0.31972)  # K_1 [P]
    width: Float[Array, ""] = parameter(18.1518)  # K_2 [P]
    efficiency_best: Float[Array, ""] = parameter(0.736)  # eta_cmax [P]
    efficiency_least: Float[Array, ""] = parameter(0.30)  # eta_cmin [P]
    flow_best: Float[Array, ""] = parameter(0.1347)  # W_opt, kg/s [P]
    ratio_best: Float[Array, ""] = parameter(2.10)  # Pi_opt [P]
    curvature_flow: Float[Array, ""] = parameter(35.03)  # Q_11, s^2/kg^2 [P]
    curvature_mixed: Float[Array, ""] = parameter(-3.310)  # Q_12, s/kg [P]
    curvature_ratio: Float[Array, ""] = parameter(0.7304)  # Q_22 [P]

    def __call__(
        self,
        boost: Float[Array, ""],
        turbo: Float[Array, ""],
        pressure: Float[Array, ""],
        temperature: Float[Array, ""],
        air: Gas,
    ) -> Compression:
        """Flow, heating and power at pressure `boost` [Pa] and speed `turbo` [rad/s].

        Draws air of `pressure` [Pa] and `temperature` [K]. Three rounds from
        p_af = p_amb:

            Pi_c  = max(1, p_b/p_af),  U = w D_c/2
            a     = (1 - K_1 (2 cp T_amb (Pi_c^(1-1/g) - 1)/U^2)^2)/K_2
            W_c   = p_af U pi D_c^2/(2 T_amb R) sqrt(a)
            p_af  = p_amb - H_af W_c^2 T_amb/p_amb

        then, from the corrected flow x_1 and the pressure x_2 about their best values,

            eta_c = max(eta_cmin, eta_cmax - (Q_11 x_1^2 + 2 Q_12 x_1 x_2 + Q_22 x_2^2))
            dT_c  = T_amb (Pi_c^(1-1/g) - 1)/eta_c,   P_c = W_c cp dT_c

        Towards surge, a <= 1e-6, sqrt(a) becomes 1e-3 exp((a - 1e-6)/1e-4): a tiny
        flow [O]. Where p_b < p_af the air is drawn through a slow compressor [O].
        """
        speed = turbo * self.diameter / 2
        heat = air.heat * temperature

        def draw(upstream: Float[Array, ""]):
            ratio = jnp.maximum(boost / upstream, 1.0)
            lift = ratio ** (1 - 1 / air.exponent) - 1
            head = 2 * heat * lift / speed**2
            margin = (1 - self.head * head**2) / self.width
            density = upstream / (temperature * air.constant)
            area = math.pi * self.diameter**2 / 2
            flow = density * speed * area * _flow_coefficient(margin)
            lack = jnp.maximum(1 - boost / upstream, 0.0)
            flow = flow * (1 - 2 * lack) + 0.4 * lack
            loss = self.filter * flow**2 * temperature / pressure
            upstream = jnp.maximum(pressure - loss, 0.2 * pressure)  # kept positive
            return upstream, flow, ratio, lift, margin

        upstream = draw(draw(pressure)[0])[0]
        upstream, flow, ratio, lift, margin = draw(upstream)
        efficiency = self._efficiency(flow, ratio, upstream, temperature)
        rise = temperature * lift / efficiency
        return Compression(
            flow=flow,
            rise=rise,
            power=flow * air.heat * rise,
            efficiency=efficiency,
            margin=margin,
        )

    def _efficiency(
        self,
        flow: Float[Array, ""],
        ratio: Float[Array, ""],
        upstream: Float[Array, ""],
        temperature: Float[Array, ""],
    ) -> Float[Array, ""]:
        corrected = flow * jnp.sqrt(temperature / 293.15) / (upstream / 1.013e5)
        x1 = corrected - self.flow_best
        # The floor keeps the slope of the root finite at ratio one.
        x2 = jnp.sqrt(jnp.maximum(ratio - 1, 1e-8)) + 1 - self.ratio_best
        loss = self.curvature_flow * x1**2 + self.curvature_ratio * x2**2
        loss = loss + 2 * self.curvature_mixed * x1 * x2
        return jnp.maximum(self.efficiency_best - loss, self.efficiency_least)


class Expansion(NamedTuple):
    """Flow, temperature and power of the turbine at one instant."""

    flow: Float[Array, ""]  # W_t, kg/s
    power: Float[Array, ""]  # P_t, W
    cooling: Float[Array, ""]  # h eta_t, share of the temperature given up
    efficiency: Float[Array, ""]  # eta_t, dimensionless


class Turbine(eqx.Module):
    """Radial turbine: flow by pressure ratio, efficiency by blade speed ratio.

    References: as for the compressor. The flow gain differs much from the listed
    2.92e-5; with that value there is no boost below 2500 rpm.
    """

    gain: Float[Array, ""] = parameter(1.5e-5)  # k_1, kg sqrt(K)/(s Pa) [D]
    exponent: Float[Array, ""] = parameter(1.9317)  # k_2 [P]
    diameter: Float[Array, ""] = parameter(0.046)  # D_t, m [O]
    efficiency_best: Float[Array, ""] = parameter(0.74)  # eta_tmax [D]
    efficiency_least: Float[Array, ""] = parameter(0.30)  # eta_tmin [P]
    speed_ratio: Float[Array, ""] = parameter(0.65)  # BSR_0 [O]

    def __call__(
        self,
        upstream: Float[Array, ""],
        downstream: Float[Array, ""],
        temperature: Float[Array, ""],
        turbo: Float[Array, ""],
        gas: Gas,
    ) -> Expansion:
        """Flow and power between two pressures [Pa] at speed `turbo` [rad/s].

        Pi_t  = clip(p_t/p_em, 0.1, 0.9999),  z = 1 - Pi_t^k_2
        W_t   = k_1 p_em z/sqrt(z + 0.004)/sqrt(T_em)
        h     = 1 - Pi_t^(1-1/g),  BSR = w D_t/2/sqrt(2 cp T_em h)
        eta_t = max(eta_tmin, eta_tmax (1 - ((BSR - BSR_0)/BSR_0)^2))
        P_t   = W_t cp T_em h eta_t
        """
        log_ratio = jnp.log(jnp.clip(downstream / upstream, 0.1, 0.9999))
        z = 1 - jnp.exp(self.exponent * log_ratio)
        flow = self.gain * upstream * z / jnp.sqrt((z + 0.004) * temperature)
        drop = 1 - jnp.exp((1 - 1 / gas.exponent) * log_ratio)
        jet = jnp.sqrt(2 * gas.heat * temperature * drop)
        off = turbo * self.diameter / 2 / jet / self.speed_ratio - 1
        efficiency = self.efficiency_best * (1 - off**2)
        efficiency = jnp.maximum(efficiency, self.efficiency_least)
        cooling = drop * efficiency
        return Expansion(
            flow=flow,
            power=flow * gas.heat * temperature * cooling,
            cooling=cooling,
            efficiency=efficiency,
        )


def _flow_coefficient(margin: Float[Array, ""]) -> Float[Array, ""]:
    root = jnp.sqrt(jnp.maximum(margin, SURGE))
    tail = 1e-3 * jnp.exp((jnp.minimum(margin, SURGE) - SURGE) / 1e-4)
    return jnp.where(margin > SURGE, root, tail)
