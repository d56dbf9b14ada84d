"""Tree of sigmoid gates: the partition of hierarchical local model trees."""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.models.validity.abstract import (
    CENTRE_ROOM,
    AbstractValidity,
    Region,
    column,
    require_shape,
)

LARGEST_ARGUMENT = 700.0
"""Largest argument of a gate: beyond it a sigmoid is 0 or 1 to the last digit, and its
logarithm stays finite."""


class SigmoidTree(AbstractValidity):
    """A leaf's weight is the product of the gates on its path from the root.

        gate g: sigma(a_g), a_g(z) = exp(log_steepness_g) (d_g . z / |d_g| - border_g)

    Gate g opens to the side of `direction` d_g with sigma(a_g) and to the other with
    1 - sigma(a_g); `path` holds +1, -1, or 0 where a gate is not on a leaf's path. So
    weights sum to one by construction and a leaf beyond the training range keeps its
    side of every gate. Axis-orthogonal where directions are unit vectors, oblique
    otherwise. O. Nelles, "Axes-oblique partitioning strategies for local model
    networks", 2006; thesis (7.1), (7.2), whose printed (7.1) has a wrong sign.
    """

    trained: ClassVar[tuple[str, ...]] = ("direction", "border", "log_steepness")
    is_convex: ClassVar[bool] = True

    direction: Float[Array, "gates dims"]
    border: Float[Array, " gates"]
    log_steepness: Float[Array, " gates"]
    path: Int[Array, "models gates"]

    def unit(self, xp: Any = jnp) -> Float[Any, "gates dims"]:
        """Directions of length one (zero for unused gates); `xp` is numpy on the
        host."""
        direction = xp.asarray(self.direction)
        square = xp.sum(direction**2, axis=1, keepdims=True)
        there = square > 0
        return xp.where(there, direction / xp.sqrt(xp.where(there, square, 1.0)), 0.0)

    def __call__(
        self, z: Float[Array, "dims *rows"], active: Bool[Array, " models"]
    ) -> Float[Array, "models *rows"]:
        tail = z.ndim - 1
        away = jnp.tensordot(self.unit(), z, axes=1) - column(self.border, tail)
        a = away * column(jnp.exp(self.log_steepness), tail)
        a = jnp.clip(a, -LARGEST_ARGUMENT, LARGEST_ARGUMENT)
        on, off = ((self.path == side).astype(z.dtype) for side in (1, -1))
        log_phi = jnp.tensordot(on, jax.nn.log_sigmoid(a), axes=1)
        log_phi = log_phi + jnp.tensordot(off, jax.nn.log_sigmoid(-a), axes=1)
        return jnp.where(column(active, tail), jnp.exp(log_phi), 0.0)

    def limits(
        self, width_band: tuple[float | int, float | int]
    ) -> tuple["SigmoidTree", "SigmoidTree"]:
        """Gates stay where they meet the range; directions within one of the present.

        A border has the limits of the range seen along the present direction. The
        steepness stays within the inverse of the band.
        """
        unit = self.unit()
        nearest = jnp.sum(jnp.minimum(unit, 0.0), axis=1)
        farthest = jnp.sum(jnp.maximum(unit, 0.0), axis=1)
        low, high = jnp.log(jnp.asarray(width_band, self.border.dtype))
        flat = self.log_steepness
        kind = type(self)
        return (
            kind(
                self.direction - 1.0,
                jnp.minimum(self.border - CENTRE_ROOM, nearest),
                flat - high,
                self.path,
            ),
            kind(
                self.direction + 1.0,
                jnp.maximum(self.border + CENTRE_ROOM, farthest),
                flat - low,
                self.path,
            ),
        )

    def check(self, models: int, dims: int) -> None:
        """A gate's direction, border and steepness; sides of gates for every model."""
        gates = self.border.shape[0] if self.border.ndim else 0
        require_shape("direction", self.direction, (gates, dims))
        require_shape("border", self.border, (gates,))
        require_shape("log_steepness", self.log_steepness, (gates,))
        require_shape("path", self.path, (models, gates))
        if not np.all(np.isin(np.asarray(self.path), (-1, 0, 1))):
            raise ValueError("a path of the tree holds other numbers than -1, 0 and 1")

    def regions(
        self,
        names: Sequence[str],
        offset: Float[np.ndarray, " dims"],
        span: Float[np.ndarray, " dims"],
    ) -> list[Region]:
        """The borders that a leaf lies above or below: a variable, or a combination of
        them.

        A combination is scaled so that the variable that matters most, by its range in
        the data, has factor one.
        """
        unit = self.unit(np)
        factor = unit / span
        level = np.asarray(self.border) + factor @ offset
        lead = factor[np.arange(len(unit)), np.abs(unit).argmax(axis=1)]
        return [
            _leaf(names, factor, level, lead, row.tolist())
            for row in np.asarray(self.path)
        ]


class GateProducts(SigmoidTree):
    """Products of gates, as in a tree, that need not sum to one.

    A model whose `path` meets no gate counts everywhere, one behind a single gate as
    far as that is open: additive gates are such products, and so are trees and additive
    gates side by side, each behind gates that give it its share.
    """

    sums_to_one: ClassVar[bool] = False
    is_convex: ClassVar[bool] = False


def _leaf(names, factor, level, lead, path: list[int]) -> Region:
    region: Region = {}
    for g, side in enumerate(path):
        if side == 0 or lead[g] == 0:
            continue
        text = combination_text(names, factor[g] / lead[g])
        value, bounds = float(level[g] / lead[g]), region.setdefault(text, {})
        if side * lead[g] > 0:
            bounds["above"] = max(bounds.get("above", value), value)
        else:
            bounds["below"] = min(bounds.get("below", value), value)
    return region


def combination_text(names: Sequence[str], factor: np.ndarray) -> str:
    """A combination of variables in words: `speed[t] - 0.3 load[t]`."""
    text = ""
    for name, c in zip(names, factor.tolist(), strict=True):
        if c == 0.0:
            continue
        sign = "-" if c < 0 else "+"
        size = "" if abs(c) == 1.0 else f"{abs(c):.3g} "
        text += f" {sign} {size}{name}" if text else f"{sign.strip('+')}{size}{name}"
    return text
