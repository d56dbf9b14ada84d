"""Gates that add up: one model counts everywhere, each other one beyond a gate."""

from collections.abc import Sequence
from typing import Any, ClassVar

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
from jaxnarx.models.validity.sigmoid_tree import LARGEST_ARGUMENT, combination_text


class AdditiveGates(AbstractValidity):
    """The first local model has weight one, every other that of its own sigmoid gate.

        phi_1 = 1,   phi_{k+1}(z) = sigma(d_k . z - c_k)

    Weights do not sum to one: what lies beyond a gate is added to what is there
    already. With a linear first model and constants behind the gates it is a network
    with one hidden layer of sigmoids beside a linear part, whose slope each gate
    changes by at most a quarter of its constant times its direction; far from all data
    it is linear. J. Sjöberg et al., Nonlinear black-box modeling in system
    identification: a unified overview, Automatica 31 (1995) 1691-1724.

    Outputs whose gates are alike before a training have the same ones after it.
    """

    trained: ClassVar[tuple[str, ...]] = ("direction", "border")
    sums_to_one: ClassVar[bool] = False

    direction: Float[Array, "gates dims"]
    border: Float[Array, " gates"]

    def __call__(
        self, z: Float[Array, "dims *rows"], active: Bool[Array, " models"]
    ) -> Float[Array, "models *rows"]:
        gates = jax.nn.sigmoid(self._arguments(z))
        phi = jnp.concatenate([jnp.ones_like(z[:1]), gates.astype(z.dtype)])
        return jnp.where(column(active, z.ndim - 1), phi, 0.0)

    def _arguments(self, z: Float[Array, "dims *rows"]) -> Float[Array, "gates *rows"]:
        a = jnp.tensordot(self.direction, z, axes=1) - column(self.border, z.ndim - 1)
        return jnp.clip(a, -LARGEST_ARGUMENT, LARGEST_ARGUMENT)

    def slopes(self, z: Float[Array, "dims *rows"]) -> Float[Array, "gates *rows"]:
        """Derivative of every gate by its argument, at most a quarter."""
        a = self._arguments(z)
        gates = jax.nn.sigmoid(a)
        return jnp.where(jnp.abs(a) < LARGEST_ARGUMENT, gates * (1.0 - gates), 0.0)

    def limits(
        self, width_band: tuple[float | int, float | int]
    ) -> tuple["AdditiveGates", "AdditiveGates"]:
        """None: a gate may turn, move and steepen as the training asks."""
        del width_band
        low, high = (
            AdditiveGates(
                jnp.full_like(self.direction, end), jnp.full_like(self.border, end)
            )
            for end in (-jnp.inf, jnp.inf)
        )
        return low, high

    def check(self, models: int, dims: int) -> None:
        """A direction and a border for every local model but the first."""
        require_shape("direction", self.direction, (models - 1, dims))
        require_shape("border", self.border, (models - 1,))

    def regions(
        self,
        names: Sequence[str],
        offset: Float[np.ndarray, " dims"],
        span: Float[np.ndarray, " dims"],
    ) -> list[Region]:
        """The borders that a gate opens above or below; nothing of the first model."""
        factor = np.asarray(self.direction, float) / span
        level = np.asarray(self.border, float) + factor @ offset
        weight = np.abs(np.asarray(self.direction))
        found: list[Region] = [{}]
        for row, value, size in zip(factor, level, weight, strict=True):
            lead = row[size.argmax()]
            if lead == 0:
                found.append({})
                continue
            side = "above" if lead > 0 else "below"
            text = combination_text(names, row / lead)
            found.append({text: {side: float(value / lead)}})
        return found


def tied_outputs(validities: Sequence[Any]) -> tuple[int, ...]:
    """For every output the first one that has the same additive gates, else itself."""
    owners: list[int] = []
    for o, one in enumerate(validities):
        same = (p for p in owners if p < o and _are_alike(one, validities[p]))
        owners.append(next(same, o))
    return tuple(owners)


def _are_alike(one: Any, other: Any) -> bool:
    if not isinstance(one, AdditiveGates) or not isinstance(other, AdditiveGates):
        return False
    pairs = zip(one.parameters, other.parameters, strict=True)
    return all(np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs)
