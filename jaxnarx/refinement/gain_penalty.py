"""Signs of gains at rest as a penalty of a refinement.

At pairs of held inputs the output at rest must not be lower at one than at the other.
By how much it is, in quarters of the output's trained range, is squared, averaged over
the pairs and added to the loss. States of rest are differentiated by the implicit
function theorem (`jaxnarx.models.StateForm.equilibrium`); pairs at which there is none
say nothing.
"""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.arrays import Linear
from jaxnarx.data import Dataset
from jaxnarx.models import (
    Network,
    StateForm,
    driving_signals,
    make_pairs,
    require_computed,
)
from jaxnarx.refinement.layout import Layout
from jaxnarx.settings import Physics, require_physics

POINTS = 100
"""Operating points at which every sign is asked."""
WEIGHT = 100.0
"""Price of a mean squared fall, in quarters of the trained range. Gains with the least
slope that counts as wrong (`jaxnarx.evaluation`: 5 % of the output's range for the
whole range of an input) cost at all points as much as an NRMSE of .2."""

Arrays = Array | np.ndarray


class SignPenalty(eqx.Module):
    """Mean square of what outputs at rest fall from `low` to `high`, times a weight.

    `place` is that of the output of every pair, `size` its quarter of a range.
    """

    low: Float[Arrays, "pairs inputs"]
    high: Float[Arrays, "pairs inputs"]
    place: Int[Arrays, " pairs"]
    size: Float[Arrays, " pairs"]
    weight: Float[Arrays, ""]

    def residuals(
        self, layout: Layout, u: Float[Array, " params"]
    ) -> Float[Array, " pairs"]:
        """The roots whose sum of squares is the penalty."""
        form = StateForm(layout.place(u))

        def rest(row: Array) -> tuple[Array, Array]:
            x, settled = form.equilibrium(row)
            return form.h(x, row), settled

        both = jnp.concatenate([jnp.asarray(self.low), jnp.asarray(self.high)])
        y, settled = jax.vmap(rest)(both)
        y = y.reshape(2, len(self.size), -1)
        every = np.arange(len(self.size))
        fall = (y[0] - y[1])[every, jnp.asarray(self.place)] / self.size
        known = settled.reshape(2, -1).all(axis=0) & jnp.isfinite(fall)
        share = jnp.sqrt(self.weight / len(self.size))
        return share * jnp.where(known & (fall > 0), fall, 0.0)

    def __call__(self, layout: Layout, u: Float[Array, " params"]) -> Float[Array, ""]:
        """The penalty."""
        return jnp.sum(self.residuals(layout, u) ** 2)

    def linear(self, layout: Layout, u: Float[Array, " params"]) -> Linear:
        """The penalty with its normal equations."""

        def residuals(u: Array) -> tuple[Array, Array]:
            found = self.residuals(layout, u)
            return found, found

        slopes, r = jax.jacfwd(residuals, has_aux=True)(u)
        return Linear(u, jnp.sum(r**2), r @ slopes, slopes.T @ slopes)


def sign_penalty(
    network: Network, data: Dataset, physics: Mapping[str, Physics]
) -> SignPenalty | None:
    """The penalty of the signs that physics asks of a network's outputs; None where it
    asks none.

    SpecError where the network looks at outputs that it does not compute, or where an
    input does not move.
    """
    require_physics(physics, data.channels.input_names, data.channels.output_names)
    every, places = [], []
    for o, name in enumerate(network.output_names):
        if name in physics and physics[name].signs:
            every.append(make_pairs(data, physics[name], output=name, points=POINTS))
            places.append(np.full(len(every[-1]), o))
    if not every:
        return None
    require_computed(network, "physics")
    assert len(driving_signals(network)) == every[0].low.shape[1]
    place, dtype = np.concatenate(places), network.gain.dtype
    wide = np.asarray(network.high - network.low, float)[np.array(network.signals)]
    size = np.where(wide > 0, wide, 1.0)[place] / 4
    ends = (np.concatenate([getattr(p, end) for p in every]) for end in ("low", "high"))
    low, high, size = jax.device_put([a.astype(dtype) for a in (*ends, size)])
    return SignPenalty(low, high, place, size, np.asarray(WEIGHT, dtype))
