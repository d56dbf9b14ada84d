"""Partition of one variable by sigmoids."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from jaxnarx.models.validity.abstract import (
    CENTRE_ROOM,
    AbstractValidity,
    Region,
    column,
    require_shape,
)


class LogSigmoids(AbstractValidity):
    """Regions of one variable between borders b_1 < b_2 < ..., by log-sigmoids.

        phi_m(z) = sigma(a (z - b_(m-1))) - sigma(a (z - b_m)),  a = exp(log_steepness)

    with 1 and 0 in place of the first and last sigmoid: open ends, so that beyond the
    training range the outermost models go on. Sums to one everywhere and is one half at
    every border (thesis (6.4) with the ends corrected: its symmetric form does not sum
    to one outside the outermost centres). Borders of inactive models are ignored.
    """

    trained: ClassVar[tuple[str, ...]] = ("border", "log_steepness")
    is_convex: ClassVar[bool] = True

    border: Float[Array, " gates"]
    log_steepness: Float[Array, ""]

    def __check_init__(self):
        _require_rising(self.border)

    def __call__(
        self, z: Float[Array, "dims *rows"], active: Bool[Array, " models"]
    ) -> Float[Array, "models *rows"]:
        tail = z.ndim - 1
        away = z - column(self.border, tail)
        beyond = jax.nn.sigmoid(jnp.exp(self.log_steepness) * away)
        beyond = jnp.where(column(active[1:], tail), beyond, 0.0)
        one = jnp.ones((1, *z.shape[1:]), z.dtype)
        steps = jnp.concatenate([one, beyond, 0.0 * one])
        return steps[:-1] - steps[1:]

    def limits(
        self, width_band: tuple[float | int, float | int]
    ) -> tuple["LogSigmoids", "LogSigmoids"]:
        """Borders stay in the range and on their side of the middle to the next one.

        So their order holds. The steepness stays within the inverse of the band.
        """
        middle = (self.border[1:] + self.border[:-1]) / 2
        first = jnp.minimum(self.border[:1] - CENTRE_ROOM, 0.0)
        last = jnp.maximum(self.border[-1:] + CENTRE_ROOM, 1.0)
        low, high = jnp.log(jnp.asarray(width_band, self.border.dtype))
        flat = self.log_steepness
        return (
            LogSigmoids(jnp.concatenate([first, middle]), flat - high),
            LogSigmoids(jnp.concatenate([middle, last]), flat - low),
        )

    def check(self, models: int, dims: int) -> None:
        """A border between every two models, in one dimension."""
        if dims != 1:
            raise ValueError(f"log-sigmoids divide one variable, not {dims}")
        require_shape("border", self.border, (models - 1,))
        require_shape("log_steepness", self.log_steepness, ())
        _require_rising(self.border)

    def regions(
        self,
        names: Sequence[str],
        offset: Float[np.ndarray, " dims"],
        span: Float[np.ndarray, " dims"],
    ) -> list[Region]:
        """The borders below and above each model; none at the open ends."""
        border = (np.asarray(self.border) * span[0] + offset[0]).tolist()
        lower = [{}, *({"above": b} for b in border)]
        upper = [*({"below": b} for b in border), {}]
        return [{names[0]: a | b} for a, b in zip(lower, upper, strict=True)]


def _require_rising(border: Array) -> None:
    """ValueError where known borders fall: weights would be negative.

    Borders of a program that is being traced are not known.
    """
    if isinstance(border, Tracer) or not eqx.is_inexact_array(border):
        return
    if np.any(np.diff(np.asarray(border)) < 0):
        raise ValueError(
            f"borders of log-sigmoids must rise, got {np.asarray(border).tolist()}"
        )
