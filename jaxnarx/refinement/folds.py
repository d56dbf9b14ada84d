"""How long to search, by cross-validation over records.

Records are dealt into groups; for each group the network is refined on the others and
judged on it after every accepted step. The position in the schedule at which the mean
of these scores is least is where the search on all records stops. Every record has then
been judged while it took no part, and none is lost to the training.
"""

from collections.abc import Callable, Sequence

import numpy as np

from jaxnarx.errors import SpecError


def deal(records: np.ndarray, folds: int) -> list[np.ndarray]:
    """The records left out in each fold: every `folds`-th one."""
    if len(records) < folds:
        raise SpecError(
            f"{folds} folds need at least as many records with samples that count, "
            f"the data have {len(records)}",
            field="folds",
        )
    return [records[n::folds] for n in range(folds)]


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
    records: np.ndarray, folds: int, judge: Callable[[np.ndarray], np.ndarray]
) -> tuple[int, list[float]]:
    """The position of the least mean score, and the mean at every position.

    `judge` refines without the records it is given and returns their `curve`.
    """
    mean = np.mean([judge(left_out) for left_out in deal(records, folds)], axis=0)
    return int(np.argmin(mean)), mean.tolist()
