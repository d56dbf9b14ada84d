"""Cylinders of the turbocharged engine: filling, mixture, torque, exhaust heat."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.engines.engine import parameter


class Combustion(NamedTuple):
    """Flows, torque and heat of the cylinders at one instant."""

    fuel: Float[Array, ""]  # W_f, kg/s
    ratio: Float[Array, ""]  # lambda, dimensionless
    indicated: Float[Array, ""]  # Nm, of the fuel, without gas exchange
    spark_efficiency: Float[Array, ""]  # eta_s, dimensionless
    temperature: Float[Array, ""]  # T_em, K


class Cylinders(eqx.Module):
    """Filling, torque and exhaust temperature of the four cylinders.

    Tags: [P] published, [D] calibrated on a public map of a 2.0 L turbo engine, [O] our
    own choice.

    References: L. Eriksson, Oil & Gas Science and Technology 62(4), 2007, 523-538;
    L. Eriksson and L. Nielsen, Modeling and Control of Engines and Drivelines, Wiley
    2014; E. Frisk, M. Krysander, D. Jung, IFAC 2017.
    """

    displacement: Float[Array, ""] = parameter(1.969e-3)  # V_D, m^3 [P]
    count: Float[Array, ""] = parameter(4.0)  # n_cyl
    stoichiometric: Float[Array, ""] = parameter(14.6)  # AF_s [O]
    heating_value: Float[Array, ""] = parameter(43.0e6)  # q, J/kg [O]
    filling: Float[Array, ""] = parameter(0.3353)  # e_0 [D]
    filling_pressure: Float[Array, ""] = parameter(0.3761)  # e_1 [D]
    filling_speed: Float[Array, ""] = parameter(0.0699)  # e_2 [D]
    efficiency: Float[Array, ""] = parameter(0.377)  # eta_i [D]
    spark_square: Float[Array, ""] = parameter(3.217)  # c_2 [P]
    spark_cube: Float[Array, ""] = parameter(4.722)  # c_3 [P]
    lean_loss: Float[Array, ""] = parameter(2.5)  # per squared lambda [O]
    lean_limit: Float[Array, ""] = parameter(1.25)  # lambda [O]
    friction: Float[Array, ""] = parameter(0.82e5)  # f_0, Pa [D]
    friction_speed: Float[Array, ""] = parameter(0.0)  # f_1, Pa per krpm [D]
    friction_square: Float[Array, ""] = parameter(0.02e5)  # f_2, Pa per krpm^2 [D]
    best_spark_base: Float[Array, ""] = parameter(24.0)  # deg BTDC [O]
    best_spark_speed: Float[Array, ""] = parameter(3.0)  # deg per krpm [O]
    best_spark_pressure: Float[Array, ""] = parameter(-11.0)  # deg per bar [O]
    knock_slope: Float[Array, ""] = parameter(14.0)  # deg per bar above 1 bar [O]
    heat_base: Float[Array, ""] = parameter(1153.7)  # T_e0, K [D]
    heat_flow: Float[Array, ""] = parameter(974.0)  # K_e, K s/kg [D]
    heat_rich: Float[Array, ""] = parameter(78.0)  # k_r, K per lambda [D]
    heat_lean: Float[Array, ""] = parameter(-250.0)  # K per lambda [O]
    heat_late: Float[Array, ""] = parameter(400.0)  # K per lost eta_s [O]
    heat_loss: Float[Array, ""] = parameter(6.288)  # hA, W/K [D]

    def air(
        self,
        pressure: Float[Array, ""],
        speed: Float[Array, ""],
        density: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Air drawn in, W_ac [kg/s], at `pressure` [Pa], `speed` [rpm], `density`.

        W_ac = eta_v rho V_D N/120, with rho = p_im/(R T_im) [kg/m^3] and
        eta_v = e_0 + e_1 sqrt(p_im/1e5) + e_2 sqrt(n), n in krpm.
        """
        filling = (
            self.filling
            + self.filling_pressure * jnp.sqrt(pressure / 1e5)
            + self.filling_speed * jnp.sqrt(speed / 1000)
        )
        return filling * density * self.displacement * speed / 120

    def stoichiometric_fuel(
        self, air: Float[Array, ""], speed: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Fuel [mg/stroke] that burns `air` [kg/s] with nothing left at `speed`."""
        return air / (self.stoichiometric * self._injection(speed))

    def best_spark(
        self, pressure: Float[Array, ""], speed: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Spark advance of greatest torque, th_mbt [deg BTDC] [O].

        th_mbt = clip(24 + 3 (n - 2) - 11 (p_im/1e5 - 0.7), 4, 42)
        """
        by_speed = self.best_spark_speed * (speed / 1000 - 2)
        by_pressure = self.best_spark_pressure * (pressure / 1e5 - 0.7)
        return jnp.clip(self.best_spark_base + by_speed + by_pressure, 4.0, 42.0)

    def knock_limited_spark(
        self, pressure: Float[Array, ""], speed: Float[Array, ""]
    ) -> Float[Array, ""]:
        """The schedule th_mbt - 14 max(0, p_im/1e5 - 1) [deg BTDC] [O]."""
        charged = jnp.maximum(pressure / 1e5 - 1, 0.0)
        return self.best_spark(pressure, speed) - self.knock_slope * charged

    def burn(
        self,
        air: Float[Array, ""],
        fuel: Float[Array, ""],
        late: Float[Array, ""],
        speed: Float[Array, ""],
        ambient: Float[Array, ""],
        heat: Float[Array, ""],
    ) -> Combustion:
        """Mixture, torque and exhaust temperature.

            W_f   = FUL 1e-6 n_cyl N/120,  lambda = W_ac/(AF_s W_f),  W_e = W_ac + W_f
            D     = (SA - th_mbt)/100,  eta_s = 1 - c_2 D^2 - c_3 D^3
            eta_l = max(0, min(1, lambda) (1 - 2.5 max(0, lambda - 1.25)^2))   [O lean]
            T_ind = eta_i eta_s eta_l q (120 W_f/N)/(4 pi)
            T_0   = T_e0 + K_e W_e + k_r min(0, lambda - 1)
                    - 250 max(0, lambda - 1) + 400 (1 - eta_s)                 [O last]
            T_em  = T_amb + (T_0 - T_amb) exp(-hA/(W_e cp_e))

        `air` W_ac in kg/s, `fuel` FUL in mg/stroke, `late` SA - th_mbt in degrees,
        `ambient` T_amb in K, `heat` cp_e in J/(kg K). eta_s holds for -40 to 20
        degrees. Outside the flammable range T_0 is kept above T_amb; W_f above 1e-9.
        """
        flow = jnp.maximum(self._injection(speed) * fuel, 1e-9)
        ratio = air / (self.stoichiometric * flow)
        d = late / 100
        by_spark = 1 - self.spark_square * d**2 - self.spark_cube * d**3
        excess = jnp.maximum(ratio - self.lean_limit, 0.0)
        by_mixture = jnp.minimum(ratio, 1.0) * (1 - self.lean_loss * excess**2)
        by_mixture = jnp.maximum(by_mixture, 0.0)
        work = self.efficiency * by_spark * by_mixture * self.heating_value
        exhaust = air + flow
        source = (
            self.heat_base
            + self.heat_flow * exhaust
            + self.heat_rich * jnp.minimum(ratio - 1, 0.0)
            + self.heat_lean * jnp.maximum(ratio - 1, 0.0)
            + self.heat_late * (1 - by_spark)
        )
        kept = jnp.exp(-self.heat_loss / (exhaust * heat))
        return Combustion(
            fuel=flow,
            ratio=ratio,
            indicated=work * 120 * flow / speed / (4 * math.pi),
            spark_efficiency=by_spark,
            temperature=ambient + jnp.maximum(source - ambient, 0.0) * kept,
        )

    def drag(
        self, back_pressure: Float[Array, ""], speed: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Torque [Nm] of gas exchange and friction, V_D (p_em - p_im + p_f)/(4 pi).

        `back_pressure` is p_em - p_im [Pa]; p_f = f_0 + f_1 n + f_2 n^2 with n in krpm.
        """
        n = speed / 1000
        friction = self.friction + self.friction_speed * n + self.friction_square * n**2
        return self.displacement * (back_pressure + friction) / (4 * math.pi)

    def _injection(self, speed: Float[Array, ""]) -> Float[Array, ""]:
        return 1e-6 * self.count * speed / 120  # kg/s for each mg/stroke
