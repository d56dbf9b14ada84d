"""The judge of a refinement: whether a free run diverges, and its loss."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.programs import program, twin
from jaxnarx.models import Network
from jaxnarx.refinement.criterion import Criterion
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.task import Task
from jaxnarx.simulation import RunInputs, begun, has_diverged, limited, run


class Judged(eqx.Module):
    """Whether a free run diverges, and its loss; one without a loss diverges."""

    diverged: Bool[Array | np.ndarray, ""]
    loss: Float[Array | np.ndarray, ""]

    def better(self, other: "Judged") -> Bool[Array, ""]:
        """Whether this is the better one: a network that runs beats one that does
        not."""
        same = self.diverged == other.diverged
        return jnp.where(same, self.loss < other.loss, other.diverged)

    @property
    def told(self) -> tuple[bool, float]:
        """On the host; the smaller is the better one."""
        return bool(self.diverged), float(self.loss)


class Guard(eqx.Module):
    """Judges networks by the free run of records, from their measured starts.

    A record has diverged by its samples that are `counted`. Hidden channels are
    estimated anew for every network, before the sample `start` of each record.
    """

    layout: Layout
    drive: RunInputs
    anchor: Bool[Array | np.ndarray, "records time"]
    start: Int[Array | np.ndarray, " records"]
    counted: Bool[Array | np.ndarray, "records time"]
    weight: Float[Array, "records time outputs"]
    criterion: Criterion

    @property
    def nameless(self) -> "Guard":
        """That of the network without names, for programs."""
        return twin(self, layout=self.layout.nameless)

    def __call__(self, u: Float[Array, " params"]) -> Judged:
        """Of the network with the parameters `u`."""
        return self.of(self.layout.place(u))

    def of(self, network: Network) -> Judged:
        """Of any network that the records were prepared for."""
        y = run(
            network, begun(network, self.drive, jnp.asarray(self.start)), self.anchor
        )
        value = self.criterion(y, self.drive.measured, self.weight)
        held = jnp.moveaxis(limited(network, y), 2, 0)
        counted = jnp.broadcast_to(self.counted[None], held.shape)
        lost = jnp.any(has_diverged(held, counted))
        finite = jnp.isfinite(value)
        return Judged(lost | ~finite, jnp.where(finite, value, jnp.inf))


def make_guard(layout: Layout, task: Task) -> Guard:
    """Of the records of a task; those without a scored sample cannot diverge."""
    masks, time = task.masks, np.arange(task.masks.anchors.shape[1])[None]
    counted = (time >= masks.start[:, None]) & (time < masks.end[:, None])
    counted &= np.any(masks.scored, axis=(1, 2))[:, None]
    return Guard(
        layout,
        task.drive,
        task.anchors(None),
        masks.start,
        counted,
        task.weight,
        task.criterion,
    )


@program
def judged(guard: Guard, network: Network) -> Judged:
    """What the guard says of a network."""
    return guard.of(network)
