"""Validation of a refinement: whether a free run diverges, and its loss."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import ValidationScore, twin
from jaxnarx.refinement.criterion import Criterion
from jaxnarx.refinement.gain_penalty import SignPenalty
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.training_data import TrainingData
from jaxnarx.simulation import (
    RunInputs,
    begin_hidden,
    has_diverged,
    limited_samples,
    run,
)


class Validator(eqx.Module):
    """Scores networks by the free run of records, from their measured starts.

    A record has diverged by its samples that are `counted`. Hidden channels begin with
    the values that the training has for its own records (`trained`): after a few steps
    no window tells them well, and what would be scored is that; a state at its bound is
    no reason to turn back there, the finished network is scored by its own run. On
    other records they are estimated anew for every network, before the sample `start`
    of each. What gains at rest have against `signs` counts as part of the loss.
    """

    layout: Layout
    drive: RunInputs
    anchor: Bool[Array | np.ndarray, "records time"]
    start: Int[Array | np.ndarray, " records"]
    counted: Bool[Array | np.ndarray, "records time"]
    weight: Float[Array, "records time outputs"]
    criterion: Criterion
    signs: SignPenalty | None = None
    trained: bool = eqx.field(static=True, default=False)

    @property
    def nameless(self) -> "Validator":
        """Copy with a network without names, so that names are no part of a program."""
        return twin(self, layout=self.layout.nameless)

    def __call__(self, u: Float[Array, " params"]) -> ValidationScore:
        """Score the network with the parameters `u`."""
        network, drive = self.layout.place(u), self.drive
        if self.trained:
            measured = self.layout.begin(u, jnp.asarray(drive.measured))
            drive = eqx.tree_at(lambda d: d.measured, drive, measured)
        else:
            drive = begin_hidden(network, drive, jnp.asarray(self.start))
        y = run(network, drive, self.anchor)
        value = self.criterion(y, drive.measured, self.weight)
        if self.signs is not None:
            value = value + self.signs(self.layout, u)
        held = jnp.moveaxis(limited_samples(network, y), 2, 0)
        counted = jnp.broadcast_to(self.counted[None], held.shape)
        lost = jnp.any(has_diverged(held, counted))
        lost &= not self.trained
        finite = jnp.isfinite(value)
        return ValidationScore(lost | ~finite, jnp.where(finite, value, jnp.inf))


def make_validator(
    layout: Layout,
    task: TrainingData,
    *,
    trained: bool = False,
    signs: SignPenalty | None = None,
) -> Validator:
    """Make the validator of a task's records; those without a scored sample cannot
    diverge.

    `trained` where it is the task of the training itself.
    """
    masks, time = task.masks, np.arange(task.masks.anchors.shape[1])[None]
    counted = (time >= masks.start[:, None]) & (time < masks.end[:, None])
    counted &= np.any(masks.scored, axis=(1, 2))[:, None]
    return Validator(
        layout,
        task.drive,
        task.anchors(None),
        masks.start,
        counted,
        task.weight,
        task.criterion,
        signs,
        trained and layout.base.hidden > 0,
    )
