"""The error of a chosen candidate by nested cross-validation.

What a search moves on all groups (feedback, gates, dead times, ranges) has seen every
group that is "left out" afterwards, and the choice has seen all their errors. Here a
group is left out first, and the candidate is made again of the others: its structure
stays, everything else is chosen anew, by the groups among them.

M. Stone, "Cross-validatory choice and assessment of statistical predictions", 1974.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from jaxnarx.data import Dataset, Groups
from jaxnarx.errors import JaxnarxError
from jaxnarx.identification.cross_validate import run_errors
from jaxnarx.identification.leaderboard import Candidate
from jaxnarx.models import Network
from jaxnarx.partition import DataProfile, profile_data

FEWEST_GROUPS = 3
"""Groups from which on two are left to choose by."""


@dataclasses.dataclass(frozen=True, eq=False)
class OuterFold:
    """The records of all groups but one, and what is seen in them."""

    train: Dataset
    apart: Dataset
    """The same, of runs that end where the group begins."""
    groups: Groups
    profile: DataProfile


Remake = Callable[[OuterFold], Network]
"""A candidate made of these records alone."""


def judge_nested(
    row: Candidate,
    remake: Remake,
    data: Dataset,
    groups: Groups,
    profile: DataProfile,
    spread: float,
    watch: Callable[[int], None] = lambda fold: None,
) -> Candidate:
    """The candidate with its nested errors; as it is where there are too few groups.

    One that diverges is vetoed. A group without which it cannot be made, or that is too
    short, has no error. `watch` is called with the number of every group, from 1.
    """
    if len(groups) < FEWEST_GROUPS:
        return row
    losses, counts = np.full(len(groups), np.nan), np.zeros(len(groups))
    for g, fold in enumerate(groups.folds(data)):
        watch(g + 1)
        try:
            train, inner = groups.without(data, g)
            apart = groups.exclude_group(data, g)
            seen = profile_data(train, profile.output)
            network = remake(OuterFold(train, apart, inner, seen))
            parts, lost = run_errors(network, fold.left, spread, begin=profile.begin)
        except (JaxnarxError, np.linalg.LinAlgError):
            continue
        if lost:
            return dataclasses.replace(
                row,
                status="diverged",
                free_run=None,
                diverged=row.diverged + lost,
                detail=f"made again without {groups.names[g]} it diverges there",
            )
        errors = np.concatenate([error for _, error in parts])
        losses[g], counts[g] = np.mean(errors**2), len(errors)
    known = np.isfinite(losses)
    if not known.any():
        return row
    error = float(np.sqrt(losses[known] @ counts[known] / counts[known].sum()))
    own = tuple(float(e) if np.isfinite(e) else None for e in np.sqrt(losses))
    return dataclasses.replace(row, nested=error, nested_groups=own)
