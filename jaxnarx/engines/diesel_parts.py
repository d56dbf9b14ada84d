"""Parts of the diesel engine, its usual excitation and its limits.

`engine` is a `Diesel` throughout; its type is not named to keep imports one-way.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.engines.flow import root
from jaxnarx.excitation import aprbs

TEMPERATURE_ROUNDS = 6


def brake_torque(
    engine: Any,
    fuel: Float[Array, ""],
    speed: Float[Array, ""],
    oxygen_ratio: Float[Array, ""],
    pumping: Float[Array, ""],
) -> Float[Array, ""]:
    """Brake torque M_e [Nm]; `pumping` is p_em - p_im."""
    n = speed / 1000
    efficiency = engine.combustion * jnp.minimum(oxygen_ratio, 1.0)
    efficiency = efficiency * (1 - engine.compression ** (1 - engine.gamma_c))
    indicated = efficiency * fuel * 1e-6 * engine.heating_value * engine.cylinders
    friction = engine.friction_quadratic * n**2 + engine.friction_linear * n
    friction = 1e5 * (friction + engine.friction_constant)
    return (indicated - engine.displacement * (pumping + friction)) / (4 * math.pi)


def exhaust_temperature(
    engine: Any,
    ratio: Float[Array, ""],
    burnt: Float[Array, ""],
    air: Float[Array, ""],
) -> Float[Array, ""]:
    """Exhaust manifold temperature T_em [K] at pressure ratio p_em/p_im.

    Seliger cycle with its constant-volume share left out (published: 2.3e-14),
    residual gas share x_r and start temperature T_1 by six fixed-point rounds:

        q  = W_f q_HV (1 - x_r)/(W_f + W_ei)       H = r_c^(gamma_a - 1)
        x_r = clip(Pi_e^(1/gamma_a)/(r_c (1 + q/(c_pa T_1 H))), 0, 1)
        T_e = eta_sc Pi_e^(1 - 1/gamma_a)/H (q/c_pa + T_1 H)
        T_1 = max(273, x_r T_e + (1 - x_r) T_im)
        T_em = T_w + (T_e - T_w) exp(-h_tot pi d l n/(W_eo c_pe))
    """
    heating = engine.compression ** (engine.gamma_a - 1)
    release = burnt * engine.heating_value / ((burnt + air) * engine.heat_capacity)
    emptied = ratio ** (1 / engine.gamma_a)
    cooling = engine.cycle_factor * ratio / (emptied * heating)
    left = emptied / engine.compression

    residual, start = jnp.zeros_like(ratio), engine.intake_temperature
    hot = start
    # Written out, with one division a round: it is a good part of the whole model's
    # cost, and a loop inside the loops of the integration would add to it.
    for _ in range(TEMPERATURE_ROUNDS):
        compressed = start * heating
        burnt_out = compressed + release * (1 - residual)  # T_1 H + q/c_pa
        residual = jnp.clip(left * compressed / burnt_out, 0.0, 1.0)
        hot = cooling * burnt_out
        start = residual * hot + (1 - residual) * engine.intake_temperature
        start = jnp.maximum(start, 273.0)
    area = math.pi * engine.pipe_diameter * engine.pipe_length * engine.pipes
    kept = (burnt + air) * engine.exhaust_heat_capacity
    share = jnp.exp(-engine.heat_transfer * area / kept)
    return engine.wall_temperature + (hot - engine.wall_temperature) * share


def egr_flow(
    engine: Any,
    e1: Float[Array, ""],
    e2: Float[Array, ""],
    intake: Float[Array, ""],
    exhaust: Float[Array, ""],
    temperature: Float[Array, ""],
) -> Float[Array, ""]:
    """EGR flow W_egr [kg/s]; none where p_im exceeds p_em.

        u = min(K_egr e1 - (K_egr - 1) e2, -c_e2/(2 c_e1))
        f = max(0, c_e1 u^2 + c_e2 u + c_e3)
        W_egr = A f p_em/sqrt(T_em R_e) (1 - ((1 - Pi)/(1 - Pi_opt) - 1)^2)

    with Pi = clip(p_im/p_em, Pi_opt, 1).
    """
    u = engine.egr_overshoot * e1 - (engine.egr_overshoot - 1) * e2
    u = jnp.minimum(u, -engine.egr_linear / (2 * engine.egr_quadratic))
    opening = engine.egr_quadratic * u**2 + engine.egr_linear * u + engine.egr_constant
    # Not `maximum`: the slope of a shut valve shall be that of opening it.
    opening = jnp.where(opening < 0, 0.0, opening)
    ratio = jnp.clip(intake / exhaust, engine.egr_ratio, 1.0)
    share = 1 - ((1 - ratio) / (1 - engine.egr_ratio) - 1) ** 2
    root_gas = jnp.sqrt(temperature * engine.exhaust_gas_constant)
    return engine.egr_area * opening * exhaust / root_gas * share


def turbine_side(
    engine: Any,
    vgt: Float[Array, ""],
    exhaust: Float[Array, ""],
    temperature: Float[Array, ""],
    omega: Float[Array, ""],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Turbine flow W_t [kg/s] and power P_tm [W], mechanical losses included.

    f = max(0, c_f2 + c_f1 sqrt(max(0, 1 - ((v - c_vgt2)/c_vgt1)^2)))
    W_t = A p_em f sqrt(1 - Pi^K_t)/sqrt(T_em R_e)    Pi = min(.9999, p_amb/p_em)
    P_tm = W_t c_pe T_em h eta                        h = 1 - Pi^(1 - 1/gamma_e)
    eta = clip(eta_tmmax - c_m(w_t) (BSR - BSR_opt)^2, 0.2, 1)
    BSR = clip(R_t w_t/sqrt(2 c_pe T_em h), 0, 2 BSR_opt)
    """
    opening = root(1 - ((vgt - engine.vgt_centre) / engine.vgt_width) ** 2)
    opening = jnp.maximum(engine.vgt_offset + engine.vgt_gain * opening, 0.0)
    ratio = jnp.minimum(engine.ambient_pressure / exhaust, 0.9999)
    flow = (
        engine.vgt_area * exhaust * opening * jnp.sqrt(1 - ratio**engine.vgt_exponent)
    )
    flow = flow / jnp.sqrt(temperature * engine.exhaust_gas_constant)
    energy = engine.exhaust_heat_capacity * temperature
    energy = energy * (1 - ratio ** (1 - 1 / engine.gamma_e))  # J/kg
    blade = engine.turbine_radius * omega / jnp.sqrt(2 * energy)
    blade = jnp.clip(blade, 0.0, 2 * engine.blade_ratio)
    above = jnp.maximum(omega, engine.blade_linear_end) - engine.blade_start
    below = jnp.maximum(omega, engine.blade_start) - engine.blade_start
    below = below / (engine.blade_linear_end - engine.blade_start)
    steep = jnp.where(
        omega >= engine.blade_linear_end,
        engine.blade_gain * above**engine.blade_power,
        engine.blade_linear_gain * below,
    )
    efficiency = engine.turbine_best - steep * (blade - engine.blade_ratio) ** 2
    return flow, flow * energy * jnp.clip(efficiency, 0.2, 1.0)


def compressor_side(
    engine: Any,
    intake: Float[Array, ""],
    omega: Float[Array, ""],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Compressor flow W_c [kg/s] and power P_c [W]; Pi = max(1, p_im/p_amb).

        Psi = 2 c_pa T_amb (Pi^(1 - 1/gamma_a) - 1)/(R_c w_t)^2
        Phi = sqrt(max(0, 1 - c_psi Psi^2)/c_phi)
        W_c = max(1e-4, p_amb pi R_c^3 w_t Phi/(R_a T_amb))
        P_c = W_c c_pa T_amb (Pi^(1 - 1/gamma_a) - 1)/eta_c
        eta_c = max(0.2, eta_cmax - chi' Q_c chi)
        chi = [W_c - W_copt, (Pi - 1 + e)^c_pi - pi_copt]

    c_psi = max(0, .) and c_phi = max(0.1, .) are quadratic in w_t. The softening e is
    zero; the slope of eta_c then grows without bound towards Pi = 1, which a value of
    1e-4 prevents, at the cost of 0.14 % of turbo speed at light load.
    """
    ratio = jnp.maximum(intake / engine.ambient_pressure, 1.0)
    lift = engine.heat_capacity * engine.ambient_temperature
    lift = lift * (ratio ** (1 - 1 / engine.gamma_a) - 1)  # J/kg
    head = 2 * lift / (engine.compressor_radius * omega) ** 2
    steep = engine.head_quadratic * omega**2 + engine.head_linear * omega
    steep = jnp.maximum(steep + engine.head_constant, 0.0)
    wide = engine.flow_quadratic * omega**2 + engine.flow_linear * omega
    wide = jnp.maximum(wide + engine.flow_constant, 0.1)
    phi = root((1 - steep * head**2) / wide)
    density = engine.ambient_pressure / (
        engine.gas_constant * engine.ambient_temperature
    )
    flow = density * math.pi * engine.compressor_radius**3 * omega * phi
    flow = jnp.maximum(flow, 1e-4)
    a = flow - engine.best_flow
    excess = ratio - 1 + engine.ratio_softening
    raised = excess > 0
    b = jnp.where(raised, jnp.where(raised, excess, 1.0) ** engine.ratio_power, 0.0)
    b = b - engine.best_ratio
    loss = engine.loss_flow * a**2 + 2 * engine.loss_cross * a * b
    loss = loss + engine.loss_ratio * b**2
    efficiency = jnp.maximum(engine.compressor_best - loss, 0.2)
    return flow, flow * lift / efficiency


def diesel_excitation(
    key: PRNGKeyArray, length: int, *, interval: float = 0.1
) -> Float[Array, "time inputs"]:
    """Rows of fuel [mg], EGR [%], VGT [%] and speed [rpm] to excite the bed with.

    APRBS, hold times 2 to 10 s: fuel 50 to 140 mg, EGR 0 to 60 %, VGT 30 to 75 %; speed
    1100 to 1700 rpm, hold 10 to 30 s, through a first-order lag of 1 s. Section 1.7 of
    the bed's specification [O].
    """

    def staircase(key, seconds, amplitude):
        low, high = (max(1, round(s / interval)) for s in seconds)
        return aprbs(key, length, hold=(low, high), amplitude=amplitude)

    fuel, egr, vgt, target = (
        staircase(k, seconds, amplitude)
        for k, seconds, amplitude in zip(
            jax.random.split(key, 4),
            [(2, 10)] * 3 + [(10, 30)],
            [(50.0, 140.0), (0.0, 60.0), (30.0, 75.0), (1100.0, 1700.0)],
            strict=True,
        )
    )
    share = -jnp.expm1(jnp.asarray(-interval / 1.0, target.dtype))

    def follow(speed, aim):
        return speed + share * (aim - speed), speed

    speed = jax.lax.scan(follow, target[0], target)[1]
    return jnp.stack([fuel, egr, vgt, speed], axis=-1)


def diesel_margins(
    pressure: Float[Array, ""],
    compressor: Float[Array, ""],
    oxygen_ratio: Float[Array, ""],
    turbo: Float[Array, ""],
    *,
    ambient: Float[Array, ""],
) -> dict[str, Float[Array, ""]]:
    """Margins to the limits of section 1.7 of the bed's specification [O].

    `smoke`: `oxygen_ratio` lambda_O at least 1.2. `turbo`: at most 12500 rad/s.
    `surge`: `compressor` flow at least 0.05 kg/s wherever `pressure` exceeds 1.5 times
    `ambient`, both in the same unit; relative to the nearer of the two.
    """
    low = 1.5 - pressure / ambient
    return {
        "smoke": oxygen_ratio - 1.2,
        "turbo": 12500.0 - turbo,
        "surge": jnp.maximum(low, compressor / 0.05 - 1),
    }
