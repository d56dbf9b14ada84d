"""Smooth validity with bounded support."""

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
from jaxnarx.models.validity.boxes import Boxes, box_regions


class Compact(AbstractValidity):
    """Smooth curves that are exactly zero outside their own region, normalised.

    In every dimension a curve rises from 0 at `low` - m to 1 at `low` + m and falls
    likewise about `high`, m = exp(`log_margin`), by the polynomial s(t) = 10 t^3 -
    15 t^4 + 6 t^5, which joins with two continuous derivatives. This gives the valid
    curve the lower and upper bounds of the thesis's outlook (chapter 8, third item): a
    local model cannot *reactivate*. Where no curve reaches, between regions or outside
    all of them, the nearest box has weight one, and no slope. A point beyond the
    training range has the weights of the nearest point of the range.
    """

    trained: ClassVar[tuple[str, ...]] = ("low", "high", "log_margin")
    is_convex: ClassVar[bool] = True

    low: Float[Array, "models dims"]
    high: Float[Array, "models dims"]
    log_margin: Float[Array, "models dims"]

    def __call__(
        self, z: Float[Array, "dims *rows"], active: Bool[Array, " models"]
    ) -> Float[Array, "models *rows"]:
        z = jnp.clip(z, 0.0, 1.0)
        curve = jnp.where(column(active, z.ndim - 1), self.curves(z), 0.0)
        total = jnp.sum(curve, axis=0)
        nearest = Boxes(*map(jax.lax.stop_gradient, (self.low, self.high)))(z, active)
        alone = total <= jnp.finfo(total.dtype).tiny
        share = curve / jnp.where(alone, 1.0, total)[None]
        return jnp.where(alone[None], nearest, share)

    def curves(self, z: Float[Array, "dims *rows"]) -> Float[Array, "models *rows"]:
        """The curves before normalisation."""
        low, high, log_margin = (column(p, z.ndim - 1) for p in self.parameters)
        margin = jnp.exp(log_margin)
        rise = _smooth((z[None] - low) / (2 * margin) + 0.5)
        fall = _smooth((high - z[None]) / (2 * margin) + 0.5)
        return jnp.prod(rise * fall, axis=1)

    def limits(
        self, width_band: tuple[float | int, float | int]
    ) -> tuple["Compact", "Compact"]:
        """Borders stay in the range and on their own side of the middle of their box.

        Margins stay within a band of the present.
        """
        middle = (self.low + self.high) / 2
        narrow, wide = jnp.log(jnp.asarray(width_band, self.low.dtype))
        return (
            Compact(
                jnp.minimum(self.low - CENTRE_ROOM, 0.0),
                middle,
                self.log_margin + narrow,
            ),
            Compact(
                middle,
                jnp.maximum(self.high + CENTRE_ROOM, 1.0),
                self.log_margin + wide,
            ),
        )

    def check(self, models: int, dims: int) -> None:
        """Three arrays, a row per model and an entry per dimension."""
        for name, value in zip(self.trained, self.parameters, strict=True):
            require_shape(name, value, (models, dims))

    def regions(
        self,
        names: Sequence[str],
        offset: Float[np.ndarray, " dims"],
        span: Float[np.ndarray, " dims"],
    ) -> list[Region]:
        """The places at which the curves pass one half, in every scheduling
        variable."""
        return box_regions(names, self.low, self.high, offset, span)


def _smooth(t: Array) -> Array:
    t = jnp.clip(t, 0.0, 1.0)
    return t**3 * (10 - 15 * t + 6 * t**2)
