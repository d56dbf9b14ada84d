"""Estimated initial conditions: the outputs before a record's first simulated sample.

A free run starts from measured outputs, and their noise stays in it until the model has
forgotten. During refinement they may be estimated beside the parameters: offsets delta
from the measured values, each of which counts as one more residual of the same weight
as a scored sample, so that a start pays for every bit it departs from its measurement.
The finished network is judged and used from measured starts all the same.

Hidden channels have no measurement: their values before a record's start are always
estimated, as departures from those that fit the start's network best, with the weight
of the prior of `jaxnarx.models.observer`. When they are used, they start from its
windows.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.models import PRIOR_WEIGHT, Network, depth, fed_back_variables, scales
from jaxnarx.refinement.training_data import TrainingData


class Initial(eqx.Module):
    """The samples that are estimated: `at` is every record's first simulated sample.

    `weight` is that of an offset's square in the loss, zero where there is none to
    estimate. Offsets are vectors of (records, depth, outputs), the newest first, in
    scaled units.
    """

    at: Int[Array, " records"]
    weight: Float[Array, "records depth outputs"]

    @property
    def size(self) -> int:
        """Number of offsets."""
        return self.weight.size

    def begin(
        self, offset: Float[Array, " offsets"], measured: Float[Array, "r time outputs"]
    ) -> Float[Array, "r time outputs"]:
        """Measured outputs with the offsets added before each record's start."""
        records, depth, _ = self.weight.shape
        add = jnp.where(self.weight > 0, offset.reshape(self.weight.shape), 0.0)
        row = jnp.arange(records)[:, None]
        at = jnp.maximum(self.at[:, None] - 1 - jnp.arange(depth)[None], 0)
        return measured.at[row, at].add(add)

    def direct(
        self,
        slope: Float[Array, "rows states outputs depth"],
        own: Bool[Array, "rows depth"],
        time: Int[Array, " rows"],
        record: Int[Array, ""],
    ) -> Float[Array, "rows states offsets"]:
        """Derivative of one record's samples by all offsets at fixed simulated past.

        Offset k is lag d = t - at + k of sample t, where that lag is measured.
        `slope` is the derivative by every lag, measured ones included.
        """
        records, depth, outputs = self.weight.shape
        rows = time.shape[0]
        lag = time[:, None] - self.at[record] + jnp.arange(depth)[None]
        seen = (lag >= 0) & (lag < depth)
        lag = jnp.clip(lag, 0, depth - 1)
        seen &= ~jnp.take_along_axis(own, lag, axis=1)
        states = slope.shape[1]
        at = jnp.broadcast_to(lag[:, None, None], (rows, states, outputs, depth))
        value = jnp.take_along_axis(slope, at, axis=3)
        value = jnp.where(seen[:, None, None], value, 0.0)
        value = jnp.where(self.weight[record].T[None, None] > 0, value, 0.0)
        value = jnp.swapaxes(value, 2, 3)[:, :, None]
        here = (jnp.arange(records) == record)[None, None, :, None, None]
        return jnp.where(here, value, 0.0).reshape(rows, states, -1)


def initial_conditions(
    network: Network, task: TrainingData, *, measured: bool = True
) -> Initial | None:
    """The initial conditions that can be estimated; None where the network feeds
    nothing back.

    Without `measured` the hidden channels' values alone; None where there are none.
    """
    tables = [network.variables, *(m.scheduling for m in network.models)]
    if not any(fed_back_variables(t, network.signals) for t in tables):
        return None
    if not (measured or network.hidden):
        return None
    start, time = task.masks.start, task.masks.anchors.shape[1]
    weight, count = np.asarray(task.weight), len(network.modelled)
    each = weight.max(axis=1)
    square = scales(network, np)[1] ** 2
    unit = (each * square[None])[:, :count].max(axis=1, keepdims=True)
    each[:, count:] = PRIOR_WEIGHT * unit / square[None, count:]
    each[:, :count] *= measured
    each = each[:, None] * np.ones((1, depth(network), 1))
    at = start[:, None] - 1 - np.arange(depth(network))[None]
    there = (start < time)[:, None] & (at >= 0)
    each = np.where(there[..., None], each, 0.0).astype(weight.dtype)
    return Initial(*jax.device_put((start, each)))
