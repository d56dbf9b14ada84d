"""Flow through a throttling valve, as a share of its choked flow, and a safe root."""

import jax.numpy as jnp
from jaxtyping import Array, Float

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
