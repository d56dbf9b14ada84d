"""Domain of a network: an index that is one at the border of its training data.

Four layers look at the inputs, each from another side; every one is scaled so that it
is one at a border of its own, and the index is the largest of them.

- `range`: an input alone, from the middle of its trained range, in half widths;
- `rate`: its change from sample to sample, in the largest of the training;
- `joint`: the ellipsoid of all features, sqrt((x - m)' S^-1 (x - m)): inputs that are
  each in their range, but were never so together;
- `distance`: to the nearest of some stored points of the training, features weighted
  by how far the free run follows them: holes inside the ellipsoid.

Features are the inputs that the network uses and, beside each, the same through a
first-order lag as slow as the network's memory, so that the index knows what the model
remembers. Borders are such that 95 of 100 samples of records left out are inside.

Distance and its threshold by records left out: H. Meyer and E. Pebesma, Predicting into
unknown space? Estimating the area of applicability of spatial prediction models,
Methods in Ecology and Evolution 12 (2021) 1620-1633.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.arrays import map_blocks, twin
from jaxnarx.regressors import Variables, record_columns

LAYERS = ("range", "rate", "joint", "distance")
BLOCK_SAMPLES = 256
"""Samples whose distances to all points are held at a time."""
LARGEST_INDEX = 1e6
"""The largest value of a layer: a channel that was constant has no width to leave."""


class Domain(eqx.Module):
    """The domain of a network: where its training data lie; see the module.

    `features` are the inputs in use, then the same inputs filtered, in physical units;
    `middle` and `spread` bring them to unit size. `weight` is how far the free run
    follows each, `points` are stored features of unit size, weighted; `whiten` makes
    those of unit size uncorrelated. `low`, `high` and `rate` (the largest step from one
    sample to the next) are those of the inputs in use, `border` what every layer's own
    measure is at its border.
    """

    features: Variables = eqx.field(static=True)
    middle: Float[Array, " features"]
    spread: Float[Array, " features"]
    weight: Float[Array, " features"]
    points: Float[Array, "points features"]
    whiten: Float[Array, "features features"]
    low: Float[Array, " used"]
    high: Float[Array, " used"]
    rate: Float[Array, " used"]
    border: Float[Array, " layers"]

    @property
    def nameless(self) -> "Domain":
        """The same with numbers for lags and filters, for programs: all that layers ask
        of a feature is whose it is."""
        inputs = self.inputs
        owners = [(inputs.index(s), n, None) for n, (s, _) in enumerate(self.features)]
        return twin(self, features=Variables.of(owners))

    @property
    def slowest(self) -> float:
        """Time constant [s] of the slowest filter of a feature; zero without any."""
        return self.features.slowest

    @property
    def inputs(self) -> tuple[int, ...]:
        """The inputs in use, by their place among the channels."""
        return tuple(dict.fromkeys(s for s, _ in self.features))

    def widths(self, xp: Any = jnp) -> tuple[Any, Any, Any]:
        """Middle and half width of the range of every input in use, and its largest
        step, to be divided by; physical units. `xp` is numpy on the host."""
        low, high, rate = (xp.asarray(a) for a in (self.low, self.high, self.rate))
        half, middle = 0.5 * (high - low), 0.5 * (high + low)
        return middle, _wide(half, middle, xp), _wide(rate, middle, xp)

    def layers(
        self, x: Float[Array, "features time"], step: Float[Array, "used time"]
    ) -> tuple[Float[Array, "time layers"], Int[Array, "time layers"]]:
        """Every layer, one at its border, and which of `inputs` it has to blame.

        `x` are the features and `step` the inputs' steps from the sample before, both
        in physical units.
        """
        return map_blocks(
            lambda columns: self._layers(*columns), (x, step), BLOCK_SAMPLES
        )

    def index(
        self, u: Float[Array, "time inputs"], sample_time: Float[Array, ""]
    ) -> Float[Array, " time"]:
        """The index of inputs over time, one at its border; filters begin at rest."""
        at = jnp.arange(u.shape[0])
        x = record_columns(u, None, at, self.features, sample_time)
        own = u[:, np.array(self.inputs)]
        step = jnp.diff(own, axis=0, prepend=own[:1]).T
        return self.layers(x, step)[0].max(axis=1)

    def joint_square(self, x: Float[Array, "features time"]) -> Float[Array, " time"]:
        """Square of the layer `joint`, smooth in the features (physical units)."""
        return jnp.sum(self._whitened(x) ** 2, axis=0) / self.border[2] ** 2

    def _whitened(self, x):
        return self.whiten @ ((x - self.middle[:, None]) / self.spread[:, None])

    def _layers(self, x, step):
        value = x[: len(self.inputs)]
        middle, half, most = self.widths()
        alone = jnp.abs(value - middle[:, None]) / half[:, None]
        rate = jnp.abs(step) / most[:, None]
        unit = (x - self.middle[:, None]) / self.spread[:, None]
        white = self._whitened(x)
        joint = jnp.sqrt(jnp.sum(white**2, axis=0))
        apart = self._nearest_distance(unit * self.weight[:, None])
        near = jnp.sqrt(apart.sum(axis=0))
        values = jnp.stack([alone.max(axis=0), rate.max(axis=0), joint, near])
        shares = self._sum_by_input(unit * (self.whiten.T @ white))
        blamed = [alone, rate, shares, self._sum_by_input(apart)]
        at = jnp.stack([jnp.argmax(one, axis=0) for one in blamed])
        return jnp.minimum(values / self.border[:, None], LARGEST_INDEX).T, at.T

    def _nearest_distance(self, unit: Float[Array, "features time"]) -> Array:
        """Squared parts of the distance to the nearest point."""
        apart = (unit[None] - self.points[:, :, None]) ** 2
        at = jnp.argmin(apart.sum(axis=1), axis=0)
        return jnp.take_along_axis(apart, at[None, None], axis=0)[0]

    def _sum_by_input(self, parts: Float[Array, "features time"]) -> Array:
        """The sum over all features of an input."""
        inputs = self.inputs
        place = np.array([inputs.index(s) for s, _ in self.features])
        total = jnp.zeros((len(inputs), parts.shape[1]), parts.dtype)
        return total.at[place].add(parts)


def _wide(width: Any, middle: Any, xp: Any) -> Any:
    """Widths to divide by: of what did not move, next to nothing."""
    least = 1e-9 * xp.maximum(xp.abs(middle), 1e-300 / 1e-9)
    return xp.maximum(width, xp.where(least > 0, least, 1.0))
