"""Flow through valves, orifices and turbulent restrictions, with safe roots."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxnarx.engines.engine import parameter

CRITICAL = 0.4125
LINEAR = 0.98


def throttle_share(ratio: Float[Array, ""]) -> Float[Array, ""]:
    """Share beta2 of the choked flow at pressure ratio r = downstream/upstream.

        beta2(r) = 1                                   r < 0.4125        [P]
                 = sqrt(r^0.4404 - r^2.3143)/0.7404    0.4125 <= r       [P]
                 = beta2(0.98) (1 - r)/0.02            r > 0.98          [O]

    Dimensionless. The straight line avoids the infinite slope of the root at r = 1;
    it goes on beyond and gives reverse flow. The slope jumps at 0.4125.

    Reference: E. Hendricks et al., SAE 960037, 1996 (the two-exponent form).
    """
    # Only ratios inside (0.4125, 0.98) reach the root, so that the hidden branches
    # have finite derivatives.
    inner = jnp.clip(ratio, CRITICAL, LINEAR)
    root = jnp.sqrt(inner**0.4404 - inner**2.3143) / 0.7404
    line = (LINEAR**0.4404 - LINEAR**2.3143) ** 0.5 / 0.7404
    unchoked = jnp.where(ratio > LINEAR, line * (1 - ratio) / (1 - LINEAR), root)
    return jnp.where(ratio < CRITICAL, jnp.ones_like(ratio), unchoked)


def root(x: Float[Array, ""]) -> Float[Array, ""]:
    """Square root of max(0, x), with slope zero where x is not positive."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


STRAIGHT = 0.92  # Pi_lin, pressure ratio above which the flow is a straight line [O]


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
    inner = jnp.clip(ratio, critical, STRAIGHT)
    small = jnp.exp(2 / g * jnp.log(inner))
    psi = jnp.sqrt(2 * g / (g - 1) * (small - small * inner ** ((g - 1) / g)))
    line = psi * (1 - jnp.maximum(ratio, STRAIGHT)) / (1 - STRAIGHT)
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
