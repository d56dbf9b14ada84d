"""How long to search, by cross-validation over what is left out together.

For each group of the training data (`jaxnarx.data.groups`) the network is refined on
the others and judged on it after every accepted step. The position in the schedule at
which the mean of these scores is least is where the search on all data stops. Every
sample has then been judged while it took no part, and none is lost to the training.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool

from jaxnarx.data import Groups
from jaxnarx.errors import DataError
from jaxnarx.refinement.training_data import TrainingData


def split_folds(
    task: TrainingData, groups: Groups, history: int, judge: TrainingData | None = None
) -> list[tuple[TrainingData, TrainingData]]:
    """For every group, a task without it and one that it alone is judged by.

    That is a part of `judge`, where runs begin otherwise. Shapes stay. A group without
    samples that count is passed over, and so is one without which none are left; fewer
    than two others are a DataError.
    """
    rows = task.masks.anchors.shape[1]
    found = []
    for g in range(len(groups)):
        own = _stack([label == g for label in groups.labels], rows)
        out = _stack(groups.held_out_samples(g), rows)
        pair = task.ignore_outputs(out, history), (judge or task).score_only(own)
        if all(np.any(np.asarray(part.weight) > 0) for part in pair):
            found.append(pair)
    if len(found) < 2:
        raise DataError(
            f"of {len(groups)} groups of the training data {len(found)} can be left "
            "out: the others have no samples that count, or leave none. Give weight to "
            "more records, or none to folds."
        )
    return found


def _stack(
    masks: Sequence[Bool[np.ndarray, " _"]], rows: int
) -> Bool[np.ndarray, "records rows"]:
    return np.stack([np.pad(mask, (0, rows - len(mask))) for mask in masks])


def curve(start: tuple[bool, float], history: Sequence[dict], total: int) -> np.ndarray:
    """Validation score at every position of the schedule, infinite where diverged.

    A stage that ended early leaves its last score for the positions it skipped.
    """
    found = np.full(total + 1, np.nan)
    found[0] = np.inf if start[0] else start[1]
    for row in history:
        found[row["done"]] = np.inf if row["diverged"] else row["validation"]
    last = np.maximum.accumulate(np.where(np.isnan(found), 0, np.arange(total + 1)))
    return found[last]


def best_position(
    folds: Sequence[tuple[TrainingData, TrainingData]],
    judge: Callable[[TrainingData, TrainingData], np.ndarray],
) -> tuple[int, list[float]]:
    """The position of the least mean score, and the mean at every position.

    `judge` refines on the first of two tasks and returns the `curve` of the second.
    """
    mean = np.mean([judge(rest, left_out) for rest, left_out in folds], axis=0)
    return int(np.argmin(mean)), mean.tolist()
