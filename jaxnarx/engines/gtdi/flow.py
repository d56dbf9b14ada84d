"""Gas properties and restrictions of the turbocharged engine."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.engines.engine import parameter

LINEAR = 0.92  # Pi_lin, pressure ratio above which the flow is a straight line [O]


class Gas(eqx.Module):
    """An ideal gas of constant heat capacity; the values of air unless given."""

    constant: Float[Array, ""] = parameter(287.0)  # R, J/(kg K)
    heat: Float[Array, ""] = parameter(1005.0)  # c_p, J/(kg K)
    exponent: Float[Array, ""] = parameter(1.4)  # g, ratio of the heat capacities


def petrol_exhaust() -> Gas:
    """Burnt gas of a petrol engine: R_e, cp_e, g_e [P]."""
    values = (290.0, 1257.0, 1.30)
    return Gas(*(jnp.asarray(value, float) for value in values))


def orifice(
    downstream: Float[Array, ""],
    upstream: Float[Array, ""],
    temperature: Float[Array, ""],
    gas: Gas,
) -> Float[Array, ""]:
    """Mass flow per effective area through an orifice [kg/(s m^2)].

        p_up/sqrt(R T) Psi(Pi, g)    Pi = max(p_down/p_up, (2/(g+1))^(g/(g-1)))
        Psi = sqrt(2 g/(g-1) (Pi^(2/g) - Pi^((g+1)/g)))          Pi <= 0.92
            = Psi(0.92) (1 - Pi)/(1 - 0.92)                      Pi > 0.92   [O]

    Pressures in Pa, upstream temperature T in K. The straight line avoids the infinite
    slope of the root at Pi = 1; beyond 1 it goes on and gives reverse flow.

    Reference: L. Eriksson and L. Nielsen, Modeling and Control of Engines and
    Drivelines, Wiley 2014, section 7.2.
    """
    g = gas.exponent
    ratio = downstream / upstream
    critical = (2 / (g + 1)) ** (g / (g - 1))
    # Only ratios up to 0.92 reach the root, so that its slope stays finite.
    inner = jnp.clip(ratio, critical, LINEAR)
    small = jnp.exp(2 / g * jnp.log(inner))
    psi = jnp.sqrt(2 * g / (g - 1) * (small - small * inner ** ((g - 1) / g)))
    line = psi * (1 - jnp.maximum(ratio, LINEAR)) / (1 - LINEAR)
    return upstream / jnp.sqrt(gas.constant * temperature) * line


def tail_flow(
    inside: Float[Array, ""],
    outside: Float[Array, ""],
    temperature: Float[Array, ""],
    resistance: Float[Array, ""],
    linear: Float[Array, ""],
) -> Float[Array, ""]:
    """Mass flow from `inside` to `outside` through a turbulent restriction [kg/s].

        W = sqrt(p/(H T)) s(p - p_out),  s(d) = sqrt(d) if d > d_lin, else d/sqrt(d_lin)

    Pressures p, p_out and d_lin in Pa, resistance H in Pa^2 s^2/(kg^2 K). The straight
    line goes on below zero and gives reverse flow [O].

    Reference: L. Eriksson, Oil & Gas Science and Technology 62(4), 2007, 523-538.
    """
    drop = inside - outside
    above = drop > linear
    root = jnp.sqrt(jnp.where(above, drop, linear))
    share = jnp.where(above, root, drop / jnp.sqrt(linear))
    return jnp.sqrt(inside / (resistance * temperature)) * share
