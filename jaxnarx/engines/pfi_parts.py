"""Fuel film, spark and efficiency of the port-injected engine."""

import jax.numpy as jnp
from jaxtyping import Array, Float


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
