"""Validity functions: where each local model speaks."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

NARROWEST = -30.0
"""Least log width in use: narrower ones would overflow, and leave no weight at all."""

EDGE = 0.01
"""Room for a centre at the border of the range, or beyond it, in the range's units."""


class AbstractValidity(eqx.Module):
    """Maps points to weights that sum to one over the active models.

    Points are columns: samples, where there are several, are trailing axes.
    """

    @abc.abstractmethod
    def __call__(
        self, z: Float[Array, "dims *rows"], active: Bool[Array, " models"]
    ) -> Float[Array, "models *rows"]: ...

    @abc.abstractmethod
    def limits(
        self, width_band: tuple[float | int, float | int]
    ) -> tuple["AbstractValidity", "AbstractValidity"]:
        """Lower and upper limits of every parameter for refinement, as such trees."""


class Gaussians(AbstractValidity):
    """Normalised Gaussians, exp(-1/2 sum_d ((z_d - c_d)/s_d)^2) over their sum.

    Thesis (6.1), (6.2), (6.5), (6.6), without the factor that (6.1) prints: it would
    change the normalised weights. Unequal widths *reactivate*: far from all centres the
    widest wins, wherever its centre lies. With no scheduling variable (zero `dims`) one
    model has weight one everywhere.
    """

    centre: Float[Array, "models dims"]
    log_width: Float[Array, "models dims"]

    def __call__(
        self, z: Float[Array, "dims *rows"], active: Bool[Array, " models"]
    ) -> Float[Array, "models *rows"]:
        tail = (1,) * (z.ndim - 1)
        centre = self.centre.reshape(self.centre.shape + tail)
        log_width = jnp.maximum(self.log_width, NARROWEST)
        scale = jnp.exp(-log_width).reshape(self.log_width.shape + tail)
        logit = -0.5 * jnp.sum(((z[None] - centre) * scale) ** 2, axis=1)
        return jax.nn.softmax(
            jnp.where(active.reshape(active.shape + tail), logit, -jnp.inf), axis=0
        )

    def limits(
        self, width_band: tuple[float | int, float | int]
    ) -> tuple["Gaussians", "Gaussians"]:
        """Centres stay in the scheduling range, widths within a band of the present.

        A centre that lies beyond the range, or at its border, has its own limit there.
        """
        low, high = jnp.log(jnp.asarray(width_band, self.log_width.dtype))
        return (
            Gaussians(jnp.minimum(self.centre - EDGE, 0.0), self.log_width + low),
            Gaussians(jnp.maximum(self.centre + EDGE, 1.0), self.log_width + high),
        )
