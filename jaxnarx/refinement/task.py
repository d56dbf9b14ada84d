"""Data prepared for the refinement of one network: drive, masks, weights, criterion."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.data import Dataset
from jaxnarx.data.batch import stack
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import Network
from jaxnarx.refinement.criterion import Criterion, make_criterion, spread_of
from jaxnarx.simulation import (
    Masks,
    RunInputs,
    first_anchor,
    make_drive,
    make_masks,
    window_anchors,
)

CONSTANT = 1e-12
"""Standard deviation, as a share of the largest value, up to which an output rests."""


@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """A dataset prepared for runs of one network: the loss is mean squared NRMSE."""

    drive: RunInputs
    masks: Masks
    weight: Float[Array, "records time outputs"]
    criterion: Criterion

    def anchors(self, horizon: int | None) -> Bool[Array, "records time"]:
        """Restarts every `horizon` samples where the history is valid; None: one."""
        if horizon is None:
            return jax.device_put(first_anchor(self.masks))
        return jax.device_put(window_anchors(self.masks, horizon))

    def only(self, records: Int[np.ndarray, " _"]) -> "Task":
        """The same task with weight on these records alone; shapes stay."""
        there = np.isin(np.arange(len(self.masks.start)), records)[:, None, None]
        weight = np.where(there, np.asarray(self.weight), 0.0)
        total = np.asarray(self.weight).sum(axis=(0, 1))
        kept = weight.sum(axis=(0, 1))
        share = np.where(kept > 0, total / np.where(kept > 0, kept, 1.0), 0.0)
        weight = jax.device_put((weight * share).astype(self.weight.dtype))
        masks = dataclasses.replace(self.masks, scored=self.masks.scored & there)
        return dataclasses.replace(self, weight=weight, masks=masks)

    def one_step(self) -> "Task":
        """The same task, counting samples with a complete measured history alone."""
        ready = self.masks.anchors[:, :, None]
        weight = jax.device_put(np.where(ready, np.asarray(self.weight), 0.0))
        masks = dataclasses.replace(self.masks, scored=self.masks.scored & ready)
        return dataclasses.replace(self, weight=weight, masks=masks)

    @property
    def longest(self) -> int:
        """Scored samples of the longest record."""
        return int(self.masks.scored.any(axis=2).sum(axis=1).max())


def make_task(
    network: Network,
    data: Dataset,
    *,
    criterion: Criterion | None = None,
    weights: Sequence[float | int] | None = None,
    loss: str = "squares",
    corner: float | int = 0.2,
    box_cox: float | int | Mapping[str, float | int] = 1.0,
) -> tuple[Task, Float[np.ndarray, " outputs"]]:
    """Prepare `data`; residuals are divided by the outputs' standard deviation in them.

    So the loss is the squared NRMSE that a report of these data states. A `criterion`
    may be given, as for validation records that of the training is. Also returns the
    standard deviations. `weights` holds one non-negative number per record; their
    scale does not matter.
    """
    batch = stack(data)
    masks = make_masks(network, batch)
    if not masks.scored.any():
        raise DataError(
            f"no record has {network.history} valid samples in a row and one more to "
            "score; refinement has nothing to work on"
        )
    drive = make_drive(network, batch)
    measured = np.asarray(drive.measured)
    if criterion is None:
        criterion, spread = make_criterion(
            network,
            data,
            measured,
            masks.scored,
            loss=loss,
            corner=corner,
            box_cox=box_cox,
        )
    else:
        spread = spread_of(criterion, measured, masks.scored)
    share = masks.scored * record_weights(weights, len(data))[:, None, None]
    total = share.sum(axis=(0, 1))
    total = np.where(total > 0, total, 1.0)
    weight = share / (total * spread**2 * len(spread))[None, None]
    weight = jax.device_put(weight.astype(spread.dtype))
    return Task(drive, masks, weight, criterion), spread


def record_weights(
    weights: Sequence[float | int] | None, records: int
) -> Float[np.ndarray, " records"]:
    """One checked weight per record; ones where none are given."""
    if weights is None:
        return np.ones(records)
    value = np.asarray(weights, float)
    good = value.shape == (records,) and np.all(np.isfinite(value))
    if not good or np.any(value < 0) or not np.any(value > 0):
        raise SpecError(
            f"weights must be one non-negative number for each of the {records} "
            f"records, not all zero, got {np.shape(weights)}",
            field="weights",
        )
    return value


def require_motion(network: Network, task: Task) -> None:
    """`DataError` where a modelled output is constant over all samples that count."""
    for o, name in enumerate(network.output_names):
        counted = np.asarray(task.drive.measured)[..., o][task.masks.scored[..., o]]
        # A constant's own standard deviation is a rounding error, not zero.
        if counted.size and counted.std() <= CONSTANT * np.abs(counted).max():
            raise DataError(
                f"{name} is constant over all samples that count; there is nothing to "
                "refine: leave it out of the model or add records in which it moves",
                channel=name,
            )
