"""Data prepared for the refinement of one network: drive, masks, weights, criterion."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.data import Dataset, stack_records
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import Network
from jaxnarx.refinement.criterion import Criterion, make_criterion, output_spread
from jaxnarx.simulation import (
    Masks,
    Prepared,
    RunInputs,
    begin_hidden,
    ensure_prepared,
    first_anchor,
    make_drive,
    make_masks,
    stack_batch,
    window_anchors,
)

CONSTANT_SHARE = 1e-12
"""Standard deviation, as a share of the largest value, up to which an output rests."""


@dataclasses.dataclass(frozen=True, eq=False)
class TrainingData:
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

    def score_only(self, rows: Bool[np.ndarray, "records time"]) -> "TrainingData":
        """The same task with weight on these samples alone; shapes stay."""
        return self._score(self.masks.scored & rows[:, :, None])

    def ignore_outputs(
        self, rows: Bool[np.ndarray, "records time"], history: int
    ) -> "TrainingData":
        """The same task as if the outputs had not been measured at `rows`.

        They have no weight, and no run begins within `history` samples after them.
        Records that train nothing then begin as they did.
        """
        before = np.cumsum(np.pad(rows, ((0, 0), (history + 1, 0))), axis=1)
        clear = before[:, history:-1] == before[:, : -history - 1]
        anchors = self.masks.anchors & clear
        some = np.any(anchors, axis=1)
        start = np.where(some, np.argmax(anchors, axis=1), self.masks.start)
        later = np.arange(rows.shape[1])[None] >= start[:, None]
        scored = self.masks.scored & (~rows & later & some[:, None])[:, :, None]
        used = np.any(scored, axis=(1, 2))
        start = np.where(used, start, self.masks.start)
        masks = dataclasses.replace(
            self.masks,
            anchors=np.where(used[:, None], anchors, self.masks.anchors),
            start=start,
            first=start,
        )
        return dataclasses.replace(self, masks=masks)._score(scored)

    def _score(
        self, scored: Bool[np.ndarray, "records time outputs"]
    ) -> "TrainingData":
        """Weight where samples are `scored`, as much in all for every output."""
        own = np.asarray(self.weight)
        weight = np.where(scored, own, 0.0)
        total, kept = own.sum(axis=(0, 1)), weight.sum(axis=(0, 1))
        share = np.where(kept > 0, total / np.where(kept > 0, kept, 1.0), 0.0)
        weight = jax.device_put((weight * share).astype(self.weight.dtype))
        masks = dataclasses.replace(self.masks, scored=scored)
        return dataclasses.replace(self, weight=weight, masks=masks)

    def with_hidden_starts(self, network: Network) -> "TrainingData":
        """The same task with what hidden channels of `network` best start from."""
        start = jax.device_put(self.masks.start)
        return dataclasses.replace(self, drive=begin_hidden(network, self.drive, start))

    def one_step(self) -> "TrainingData":
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
    data: Dataset | Prepared,
    *,
    criterion: Criterion | None = None,
    weights: Sequence[float | int] | None = None,
    loss: str = "squares",
    corner: float | int = 0.2,
    box_cox: float | int | Mapping[str, float | int] = 1.0,
    window: int = 0,
) -> tuple[TrainingData, Float[np.ndarray, " outputs"]]:
    """Prepare `data`, or take them as they are prepared; residuals are divided by the
    outputs' standard deviation in them.

    So the loss is the squared NRMSE that a report of these data states. A `criterion`
    may be given, as for validation records that of the training is. Also returns the
    standard deviations. `weights` holds one non-negative number per record; their
    scale does not matter. Runs begin so many samples before the first that counts as
    the `window` has, see `Masks`.
    """
    if isinstance(data, Prepared):
        runs, origin = ensure_prepared(network, data)
        data, batch, drive = origin.matched, origin.batch, runs.drive
    else:
        batch = stack_records(data)
        drive = make_drive(network, batch)
    masks = make_masks(network, batch, window)
    _require_scored(masks, network.history + window)
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
        spread = output_spread(criterion, measured, masks.scored)
    share = masks.scored * record_weights(weights, len(data))[:, None, None]
    total = share.sum(axis=(0, 1))
    total = np.where(total > 0, total, 1.0)
    weight = share / (total * spread**2 * len(network.modelled))[None, None]
    weight = jax.device_put(weight.astype(spread.dtype))
    return TrainingData(drive, masks, weight, criterion), spread


def require_window(network: Network, data: Dataset | Prepared) -> None:
    """`DataError` where no record is long enough to be run as the network is used, with
    a window to estimate hidden channels from."""
    if network.hidden:
        masks = make_masks(network, stack_batch(network, data)[1], network.window)
        _require_scored(masks, network.history + network.window)


def _require_scored(masks: Masks, needed: int) -> None:
    if not masks.scored.any():
        raise DataError(
            f"no record has {needed} valid samples in a row and one more to score; "
            "refinement has nothing to work on"
        )


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


def require_motion(network: Network, task: TrainingData) -> None:
    """`DataError` where a modelled output is constant over all samples that count."""
    for o, name in enumerate(network.computed_names):
        counted = np.asarray(task.drive.measured)[..., o][task.masks.scored[..., o]]
        # A constant's own standard deviation is a rounding error, not zero.
        if counted.size and counted.std() <= CONSTANT_SHARE * np.abs(counted).max():
            raise DataError(
                f"{name} is constant over all samples that count; there is nothing to "
                "refine: leave it out of the model or add records in which it moves",
                channel=name,
            )
