"""The error of a chosen candidate by nested cross-validation.

A search moves feedback, gates, dead times and ranges on all groups, so these have seen
every group that is "left out" afterwards. Here a group is left out first, and the
candidate is made again of the others: its structure stays, everything else is chosen
anew, by the groups among them.

These models lack a group that the one in use has. What that costs is told by the next
step down: the groups among the others, each left out, are judged by models that lack
two (`Candidate.data_factor`).

M. Stone, "Cross-validatory choice and assessment of statistical predictions", 1974; on
the records that a held-out error lacks P. Burman, "A comparative study of ordinary
cross-validation, v-fold cross-validation and the repeated learning-testing methods",
1989.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxnarx.data import Dataset, Groups
from jaxnarx.errors import JaxnarxError
from jaxnarx.identification.cross_validate import (
    fit_method,
    group_places,
    run_group,
)
from jaxnarx.identification.leaderboard import Candidate
from jaxnarx.models import Network, hold_to_range
from jaxnarx.partition import (
    ClosedSearch,
    ClosedStructure,
    DataProfile,
    Errors,
    align_errors,
    profile_data,
)
from jaxnarx.settings import HiddenStates, Identification, Partitioner

FEWEST_GROUPS = 3
"""Groups from which on two are left to choose by."""
LEAST_INNER_ERROR = 1e-12
"""Least error that is divided by [standard deviations]."""


@dataclasses.dataclass(frozen=True, eq=False)
class OuterFold:
    """The records of all groups but one, what is seen in them, and that group."""

    g: int
    train: Dataset
    apart: Dataset
    """The same, of runs that end where the group begins."""
    groups: Groups
    profile: DataProfile
    left: Dataset
    places: list[int]
    """Those of the first samples of the records `left`, among all."""
    spread: float
    begin: int
    """Samples of every record that judge nothing."""
    searches: dict[bool, ClosedSearch] = dataclasses.field(default_factory=dict)
    """The searches in closed form, of the output and (True) of its root: candidates
    that are made again share what they have grown."""

    def run(self, network: Network, inner: float | None = None) -> "Remade":
        """A network over the group."""
        own = self.left, self.spread, self.places
        return Remade(*run_group(network, *own, begin=self.begin), inner)


@dataclasses.dataclass(frozen=True, eq=False)
class Remade:
    """A candidate made of the records of an outer fold, run over its group."""

    errors: Errors
    diverged: int
    """Records."""
    inner: float | None = None
    """Root mean square error on the groups among those records, each by a model made
    without it too, in standard deviations of all records."""


Remake = Callable[[OuterFold], Remade]


def judge_nested(
    rows: Sequence[Candidate],
    remakes: Sequence[Remake],
    data: Dataset,
    groups: Groups,
    profile: DataProfile,
    spread: float,
    watch: Callable[[int], None] = lambda fold: None,
) -> list[Candidate]:
    """Candidates with their nested errors; as they are where there are too few groups.

    One that diverges is vetoed. A group without which it cannot be made, or that is too
    short, has no error. `watch` is called with the number of every group, from 1.
    """
    if len(groups) < FEWEST_GROUPS:
        return list(rows)
    every = [_Nested(row, len(groups)) for row in rows]
    for g, fold in enumerate(groups.folds(data)):
        watch(g + 1)
        try:
            train, inner = groups.without(data, g)
            apart = groups.exclude_group(data, g)
            seen = profile_data(train, profile.output)
            places = group_places(data, groups, g)
            own = fold.left, places, spread, profile.begin
            outer = OuterFold(g, train, apart, inner, seen, *own)
        except (JaxnarxError, np.linalg.LinAlgError):
            continue
        for one, remake in zip(every, remakes, strict=True):
            one.run(remake, outer, groups.names[g])
    return [one.outcome() for one in every]


class _Nested:
    """The nested errors of a candidate so far."""

    def __init__(self, row: Candidate, groups: int):
        self.row, self.lost = row, False
        self.losses, self.counts = np.full(groups, np.nan), np.zeros(groups)
        self.inner = np.full(groups, np.nan)

    def run(self, remake: Remake, fold: OuterFold, name: str) -> None:
        """One group more, unless an earlier one has vetoed the candidate."""
        if self.lost:
            return
        try:
            found = remake(fold)
        except (JaxnarxError, np.linalg.LinAlgError):
            return
        if lost := found.diverged:
            self.lost = True
            self.row = dataclasses.replace(
                self.row,
                status="diverged",
                free_run=None,
                diverged=self.row.diverged + lost,
                detail=f"made again without {name} it diverges there",
            )
        elif len(errors := found.errors[1]):
            self.losses[fold.g] = np.mean(errors.astype(float) ** 2)
            self.counts[fold.g] = len(errors)
            if found.inner is not None:
                self.inner[fold.g] = found.inner

    def outcome(self) -> Candidate:
        """The candidate with these errors."""
        losses, counts = self.losses, self.counts
        known = np.isfinite(losses)
        if self.lost or not known.any():
            return self.row
        error = float(np.sqrt(losses[known] @ counts[known] / counts[known].sum()))
        own = tuple(float(e) if np.isfinite(e) else None for e in np.sqrt(losses))
        judged = dataclasses.replace(
            self.row, nested=error, nested_groups=own, data_factor=self._data_factor()
        )
        if judged.keeps_promise or judged.free_run is None:
            return judged
        times = error / judged.free_run
        told = f"made again without a group it has {times:.2g} times the error there"
        return dataclasses.replace(judged, detail=told)

    def _data_factor(self) -> float | None:
        """`Candidate.data_factor`; None where a group has no inner error."""
        judged = self.counts > 0
        if self.row.free_run is None or not np.isfinite(self.inner[judged]).all():
            return None
        squares, counts = self.inner[judged] ** 2, self.counts[judged]
        inner = np.sqrt(np.average(squares, weights=counts))
        return float(min(self.row.free_run / max(inner, LEAST_INNER_ERROR), 1.0))


def repeat_closed_form(
    family: str,
    structure: ClosedStructure,
    partitions: Mapping[str, Partitioner],
    known: Mapping[str, Any],
    fold: OuterFold,
) -> Remade:
    """A candidate in closed form; `known` are the keywords of `ClosedSearch`.

    The signs of physics are asked at the points of all records: these are inputs, known
    beforehand. Operating points at rest are in no group.
    """
    root = known["root"]
    if root not in fold.searches:
        own = fold.train, fold.profile, fold.groups
        fold.searches[root] = ClosedSearch(*own, **known)
    found = fold.searches[root].repeat(family, structure, partitions)
    spread = found.stage.design.signals.output_spread
    inner = found.free_run * spread / fold.spread
    return fold.run(hold_to_range(found.network()), inner)


class Retraining:
    """Candidates of a method that is trained step by step, on up to `rows` samples,
    from its start: once without every group, for all of them."""

    def __init__(self, method: Identification | HiddenStates, rows: int):
        self.method, self.rows = method, rows
        self.networks: dict[int, list[Network]] = {}

    def run(self, stage: int, fold: OuterFold) -> Remade:
        """The candidate of a stage."""
        if fold.g not in self.networks:
            hidden = isinstance(self.method, HiddenStates)
            data = fold.apart if hidden else fold.train
            found = fit_method(self.method, data, self.rows, known=fold.train)
            self.networks[fold.g] = found
        return fold.run(self.networks[fold.g][stage])


def errors_of_fold(left: Sequence[Errors], fold: OuterFold) -> Remade:
    """Errors that are known already, of every group."""
    return Remade(left[fold.g], 0)


def remake_mean(remakes: Sequence[Remake], fold: OuterFold) -> Remade:
    """The mean of candidates, at the places that all of them judge."""
    every = [remake(fold) for remake in remakes]
    errors = [errors for (errors,) in align_errors([[one.errors] for one in every])]
    places = functools.reduce(np.intersect1d, (one.errors[0] for one in every))
    lost = sum(one.diverged for one in every)
    return Remade((places, np.mean(errors, axis=0)), lost)
