"""Normalised Gaussians."""

from collections.abc import Sequence
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.models.validity.abstract import (
    CENTRE_ROOM,
    AbstractValidity,
    Region,
    column,
    require_shape,
)

LEAST_LOG_WIDTH = -30.0
"""Least log width in use: narrower ones would overflow, and leave no weight at all."""


class Gaussians(AbstractValidity):
    """Normalised Gaussians, exp(-1/2 sum_d ((z_d - c_d)/s_d)^2) over their sum.

    Thesis (6.1), (6.2), (6.5), (6.6), without the factor that (6.1) prints: it would
    change the normalised weights. Unequal widths *reactivate*: far from all centres the
    widest wins, wherever its centre lies; see `reactivation`. With no scheduling
    variable (zero `dims`) one model has weight one everywhere.
    """

    trained: ClassVar[tuple[str, ...]] = ("centre", "log_width")
    is_convex: ClassVar[bool] = True

    centre: Float[Array, "models dims"]
    log_width: Float[Array, "models dims"]

    def __call__(
        self, z: Float[Array, "dims *rows"], active: Bool[Array, " models"]
    ) -> Float[Array, "models *rows"]:
        tail = z.ndim - 1
        log_width = jnp.maximum(self.log_width, LEAST_LOG_WIDTH)
        scale = column(jnp.exp(-log_width), tail)
        away = (z[None] - column(self.centre, tail)) * scale
        logit = -0.5 * jnp.sum(away**2, axis=1)
        logit = jnp.where(column(active, tail), logit, -jnp.inf)
        return jax.nn.softmax(logit, axis=0)

    def limits(
        self, width_band: tuple[float | int, float | int]
    ) -> tuple["Gaussians", "Gaussians"]:
        """Centres stay in the scheduling range, widths within a band of the present.

        A centre that lies beyond the range, or at its border, has its own limit there.
        """
        low, high = jnp.log(jnp.asarray(width_band, self.log_width.dtype))
        return (
            Gaussians(
                jnp.minimum(self.centre - CENTRE_ROOM, 0.0), self.log_width + low
            ),
            Gaussians(
                jnp.maximum(self.centre + CENTRE_ROOM, 1.0), self.log_width + high
            ),
        )

    def check(self, models: int, dims: int) -> None:
        """Two arrays, a row per model and an entry per dimension."""
        require_shape("centre", self.centre, (models, dims))
        require_shape("log_width", self.log_width, (models, dims))

    def regions(
        self,
        names: Sequence[str],
        offset: Float[np.ndarray, " dims"],
        span: Float[np.ndarray, " dims"],
    ) -> list[Region]:
        """Centre and width in every scheduling variable."""
        centre = np.asarray(self.centre) * span + offset
        width = np.exp(np.asarray(self.log_width)) * span
        return [
            {
                name: {"centre": float(c), "width": float(w)}
                for name, c, w in zip(names, *row, strict=True)
            }
            for row in zip(centre, width, strict=True)
        ]
