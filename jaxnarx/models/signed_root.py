"""Outputs of which a root is modelled: what is far above all else weighs less then."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

LEAST_DISTANCE = 1e-12
"""Distance from the floor, scaled, from which on the root has its slope; nearer to it
that has no bound."""


class SignedRoot(eqx.Module):
    """Groups of local models whose output is the square of what they compute.

        y = floor + r |r| ,   r = sign(y - floor) sqrt(|y - floor|)

    where a group `squares`, else y = r. Monotone, with an inverse everywhere; scaled
    signals. The square root is the power 1/2 of the transformations of G. Box and D.
    Cox, An analysis of transformations, Journal of the Royal Statistical Society B 26
    (1964) 211-252.
    """

    squares: Bool[Array, " groups"]
    floor: Float[Array, " groups"]

    def to_output(
        self, r: Float[Array, "groups *rows"]
    ) -> Float[Array, "groups *rows"]:
        """Give the outputs of the groups for what they compute."""
        floor = _align(self.floor, r)
        return jnp.where(_align(self.squares, r), floor + r * jnp.abs(r), r)

    def to_root(self, y: Float[Array, "groups *rows"]) -> Float[Array, "groups *rows"]:
        """Invert `to_output`."""
        far = y - _align(self.floor, y)
        steep = jnp.abs(far) > LEAST_DISTANCE
        root = jnp.sign(far) * jnp.sqrt(jnp.where(steep, jnp.abs(far), 1.0))
        root = jnp.where(steep, root, far / LEAST_DISTANCE**0.5)
        return jnp.where(_align(self.squares, y), root, y)

    def slope(self, r: Float[Array, "groups *rows"]) -> Float[Array, "groups *rows"]:
        """Derivative of the outputs by what the groups compute."""
        return jnp.where(_align(self.squares, r), 2.0 * jnp.abs(r), jnp.ones_like(r))


def _align(values: Array, r: Array) -> Array:
    """Shape one value for every group as samples are."""
    return values.reshape(values.shape + (1,) * (r.ndim - 1))
