"""Piecewise constant validity."""

from collections.abc import Sequence
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.models.validity.abstract import (
    AbstractValidity,
    Region,
    column,
    require_shape,
)


class Boxes(AbstractValidity):
    """One model at a time: weight one in its own box and zero elsewhere, thesis (6.3).

    A point outside all boxes, as beyond the training range, belongs to the nearest one
    (largest norm of the distance); of several equally near ones, such as at a shared
    border, the last has it, so that the boxes of a grid hold their lower borders.
    Nothing of it can be trained by gradients.
    """

    trained: ClassVar[tuple[str, ...]] = ()
    is_convex: ClassVar[bool] = True

    low: Float[Array, "models dims"]
    high: Float[Array, "models dims"]

    def __call__(
        self, z: Float[Array, "dims *rows"], active: Bool[Array, " models"]
    ) -> Float[Array, "models *rows"]:
        tail = z.ndim - 1
        below = column(self.low, tail) - z[None]
        above = z[None] - column(self.high, tail)
        away = jnp.max(jnp.maximum(jnp.maximum(below, above), 0.0), axis=1, initial=0.0)
        away = jnp.where(column(active, tail), away, jnp.inf)
        models = away.shape[0]
        last = models - 1 - jnp.argmin(away[::-1], axis=0)
        return jax.nn.one_hot(last, models, axis=0, dtype=z.dtype)

    def limits(
        self, width_band: tuple[float | int, float | int]
    ) -> tuple["Boxes", "Boxes"]:
        """Limits at the present place: boxes are not trained."""
        return self, self

    def check(self, models: int, dims: int) -> None:
        """Two arrays, a row per model and an entry per dimension."""
        require_shape("low", self.low, (models, dims))
        require_shape("high", self.high, (models, dims))

    def regions(
        self,
        names: Sequence[str],
        offset: Float[np.ndarray, " dims"],
        span: Float[np.ndarray, " dims"],
    ) -> list[Region]:
        """Lower and upper border in every scheduling variable."""
        return box_regions(names, self.low, self.high, offset, span)


def box_regions(
    names: Sequence[str],
    low: Float[Array, "models dims"],
    high: Float[Array, "models dims"],
    offset: Float[np.ndarray, " dims"],
    span: Float[np.ndarray, " dims"],
) -> list[Region]:
    """Borders of scaled boxes as regions in physical units."""
    return [
        {
            name: {"above": float(a), "below": float(b)}
            for name, a, b in zip(names, *row, strict=True)
        }
        for row in zip(
            *(np.asarray(b) * span + offset for b in (low, high)), strict=True
        )
    ]
