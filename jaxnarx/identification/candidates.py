"""All candidates of one output, from cheap to rich, each judged and with its model."""

import dataclasses
import functools
import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset, Groups
from jaxnarx.errors import JaxnarxError, SpecError
from jaxnarx.evaluation import (
    cost,
    count_wrong_signs,
    is_slower,
    longest_time_constants,
)
from jaxnarx.extensions import Registry
from jaxnarx.identification.cross_validate import CrossValidation, cross_validate
from jaxnarx.identification.leaderboard import (
    AGAINST_PHYSICS,
    Candidate,
    Leaderboard,
)
from jaxnarx.identification.narx_candidates import propose_narx
from jaxnarx.identification.nested import (
    Remake,
    Retraining,
    errors_of_fold,
    judge_nested,
    remake_mean,
    repeat_closed_form,
)
from jaxnarx.identification.state_space_candidates import (
    LONG_RECORDS,
    SHORT_RECORDS,
    propose_gates,
    propose_state_space,
)
from jaxnarx.models import Network, hold_to_range, make_pairs, total
from jaxnarx.partition import (
    OF_ROOT,
    ClosedForm,
    ClosedSearch,
    ClosedStructure,
    DataProfile,
    Sum,
    Summand,
    best_sum,
)
from jaxnarx.refinement import largest_local_pole, stays_bounded
from jaxnarx.settings import (
    HiddenStates,
    Identification,
    Partitioner,
    Physics,
    Preset,
)

NOT_SUMMED = "constant", "ARX"
"""Families that are in no sum."""
CLOSED_KIND, ROOT_KIND = "closed form", "closed form of the root"
"""Kinds of candidates in closed form; of all others every family is a kind."""
LEAST_SKEWNESS = 3.0
"""Skewness of an output from which on its root is modelled too: few high peaks weigh as
much as all else in least squares of the output itself. Of a measured engine's particle
number (12.7) the error of groups left out was .62 with two grown polynomials of the
output, .42 with two of its root, of its HC emissions .42 and .36."""
MOST_ADDED = 20
"""Methods that are tried of each family that another package adds."""
FED_PATIENCE = 1
"""After so many structures with products of past outputs, none of which came near the
best, they are given up: on 32 outputs of open sets and virtual engines
none was better than all others (`experiments/open_sets/order.py`). `quick`, which has
no hidden states, tries one: of 20 random systems it chose that for a few."""
MOST_SMALLER_ONES = 3
"""Candidates with fewer regions that are made again without every group beside the
chosen one (of long records `Preset.smaller`). Halvings are chosen by all groups: of a
measured engine's CO2 14 regions had .0735 on groups left out; made again without a
group 14 had .089, eight .084, and on six test records 14 had .167, seven .086."""
MOST_CHOICES = 3
"""Candidates that nested cross-validation may veto, or find to promise too much, before
no other is judged so."""
NEAR_BEST_FACTOR = 1.5
"""Error, as a multiple of the best candidate's, up to which a kind is promising."""

Trial = tuple[str, list[str], Identification | HiddenStates]
"""Family, names of the candidates that a method ends with, and the method."""
CandidateFactory = Callable[[Dataset, str], Iterable[tuple[str, Identification]]]
"""A function by which another package adds candidates to a search: it takes the data
and the name of an output, and gives names and methods to be tried, those that promise
most first."""
CANDIDATES: Registry[CandidateFactory] = Registry("candidate of identify", {})
"""Families of other packages. They are tried after the closed-form candidates;
functions of modules, for outputs are searched in processes of their own."""


@dataclasses.dataclass(frozen=True)
class Trying:
    """A candidate that is being tried: `fold` of `folds` groups is left out (0: none
    yet)."""

    family: str
    name: str = ""
    fold: int = 0
    folds: int = 0
    nested: bool = False
    """Whether it is made again without the group, as it was chosen."""


Watch = Callable[[Trying], None]
Tried = tuple[Candidate, Network | None]
"""A candidate, and its network trained on all records if there is one."""


class CandidateSearch:
    """The search for one output."""

    def __init__(
        self,
        data: Dataset,
        profile: DataProfile,
        groups: Groups,
        preset: Preset,
        *,
        known: Sequence[Candidate] = (),
        late: Callable[[], bool] = lambda: False,
        added: Mapping[str, CandidateFactory] | None = None,
        partitions: Mapping[str, Partitioner] | None = None,
        watch: Watch = lambda trying: None,
        physics: Physics | None = None,
        at_rest: Dataset | None = None,
    ):
        """`known` are candidates that need not be tried again; `late` tells that the
        time is up; `added` and `partitions` are those of other packages; `watch` hears
        what is tried; `physics` is what every candidate keeps to;
        `at_rest` are operating points that candidates in closed form are trained on."""
        self.added, self.partitions = dict(added or {}), dict(partitions or {})
        self.data, self.profile = data, profile
        self.groups, self.preset = groups, preset
        self.known = {(row.family, row.name): row for row in known}
        self.late, self.passed, self.spread = late, 0, 1.0
        self.watch, self.physics, self.at_rest = watch, physics, at_rest
        self.kept: dict[str, Any] = {"pairs": None, "longest": None}
        """What physics asks, as keywords of `ClosedSearch`."""
        if physics is not None:
            self.kept["longest"] = physics.longest_time_constant
            if physics.signs:
                self.kept["pairs"] = make_pairs(data, physics, output=profile.output)
        self.best: np.ndarray | None = None
        self.parts: dict[str, Summand] = {}
        """The best of every kind, as a part of a sum."""
        self.best_of: dict[str, Candidate] = {}
        self.remakes: dict[str, Remake] = {}
        """How every candidate is made again, by family and name."""
        self.divided: dict[tuple[str, str], tuple[Candidate, ClosedStructure]] = {}
        """Candidates of several regions, by family and name."""
        self.judged_before: dict[str, Callable[[], Summand | None]] = {}
        """Kinds whose best was judged before this search went on: by what it is judged
        once more, for the errors at all samples are not kept."""

    def __iter__(self) -> Iterator[Tried]:
        """One after the other; at least one, whatever the time. Sums come last, and
        behind them the chosen candidate once more with its nested error, and without
        its network; then the simplest within one standard error likewise."""
        rows = dict(self.known)
        for row, network in self._every_kind():
            if row.nested is not None or (row.family, row.name) not in rows:
                rows[row.family, row.name] = row
            yield row, network
        for _ in range(MOST_CHOICES):
            choice = self._board(rows).choose(self.profile.output)
            if choice is None or choice.nested is not None:
                break
            judged = self._judge_again(choice, *self._smaller_ones(choice))
            if not judged:
                break
            for row in judged:
                rows[row.family, row.name] = row
                yield row, None
        board = self._board(rows)
        choice = board.choose(self.profile.output)
        if choice is None or choice.nested is None:
            return
        for row in self._judge_again(board.simplest(self.profile.output)):
            yield row, None

    def _board(self, rows: Mapping[tuple[str, str], Candidate]) -> Leaderboard:
        return Leaderboard(tuple(rows.values()), self.groups.names, self.preset.rule)

    def _judge_again(self, *rows: Candidate | None) -> list[Candidate]:
        """Candidates with their nested errors; without those of which these are known,
        which cannot be made again, or when the time is up."""
        found = [row for row in rows if row is not None and row.nested is None]
        pairs = [(row, self.remakes.get(_title(row.family, row.name))) for row in found]
        pairs = [(row, remake) for row, remake in pairs if remake is not None]
        if not pairs or self.late():
            return []
        first = pairs[0][0]

        def watch(fold: int) -> None:
            folds = len(self.groups)
            self.watch(Trying(first.family, first.name, fold, folds, nested=True))

        before, remakes = zip(*pairs, strict=True)
        own = (self.data, self.groups, self.profile)
        judged = judge_nested(before, remakes, *own, self.spread, watch)
        return [new for old, new in zip(before, judged, strict=True) if new != old]

    def _smaller_ones(self, row: Candidate) -> list[Candidate]:
        """Candidates of the same polynomial with fewer regions: those whose gates have
        moved first, and half as many first."""
        mine = self.divided.get((row.family, row.name))
        if mine is None:
            return []
        own = mine[1]
        fewer = [
            (one, structure)
            for one, structure in self.divided.values()
            if one.family == row.family
            and one.eligible
            and structure.models < own.models
            and structure.undivided() == own.undivided()
        ]
        half = own.models / 2
        fewer.sort(key=lambda pair: (not pair[1].gates, abs(pair[1].models - half)))
        by_size: dict[int, Candidate] = {}
        for one, structure in fewer:
            by_size.setdefault(structure.models, one)
        long = self.data.samples > LONG_RECORDS
        most = self.preset.smaller if long else MOST_SMALLER_ONES
        return list(by_size.values())[:most]

    def _every_kind(self) -> Iterator[Tried]:
        """All candidates, as they are tried."""
        yield from self._closed_forms()
        skewed = self.profile.skewness >= LEAST_SKEWNESS
        if skewed and self.preset.roots and not self.late():
            yield from self._closed_forms(root=True)
        if not self.late():
            yield from self._trained_kinds()
        yield from self._sum_kinds()

    def _closed_search(self, root: bool) -> ClosedSearch:
        own = self.data, self.profile, self.groups
        return ClosedSearch(*own, root=root, at_rest=self.at_rest, **self.kept)

    def _closed_forms(self, *, root: bool = False) -> Iterator[Tried]:
        """Candidates in closed form, of the output or of its root."""
        kind = ROOT_KIND if root else CLOSED_KIND
        search = self._closed_search(root)
        begin = time.perf_counter()
        limits = dict(max_models=self.preset.max_models, degree=self.preset.degree)
        if self.preset.linear:
            limits = dict(max_models=1, degree=1)
        grown = self.preset.roots if root else self.preset.grown
        self.watch(Trying(kind))
        found_by = search.candidates(**limits, grown_roots=grown)
        if not root:
            found_by = itertools.chain(found_by, self._divide_by_partitions(search))
        for found in found_by:
            self.passed += 1
            if isinstance(found, Candidate):
                row, network = found, None
            else:
                row, network = self._score_closed_form(
                    found, time.perf_counter() - begin
                )
                self.remakes[_title(row.family, row.name)] = functools.partial(
                    repeat_closed_form,
                    found.family,
                    found.structure,
                    self.partitions,
                    {"root": root, "at_rest": self.at_rest, **self.kept},
                )
                if found.structure.models > 1:
                    self.divided[row.family, row.name] = row, found.structure
                if row.eligible and self._takes_lead(kind, row):
                    self.parts[kind] = found.part(network)
            yield row, network
            if self.late():
                break
            self.watch(Trying(kind, f"the next behind {found.family}"))
            begin = time.perf_counter()
        self.spread = search.spread

    def _trained_kinds(self) -> Iterator[Tried]:
        """Candidates that are trained step by step."""
        for family, trials in self.added.items():
            methods = trials(self.data, self.profile.output)
            own = ((family, [name], method) for name, method in methods)
            yield from self._train_methods(own, MOST_ADDED, MOST_ADDED)
        hidden, gated = self._hidden_states(), self._gated_states()
        # Of long records those with gates were better, of short ones mostly others.
        long = self.data.samples > LONG_RECORDS
        yield from itertools.chain(*((gated, hidden) if long else (hidden, gated)))
        fed = propose_narx(self.data, self.profile)
        patience = self.preset.patience if self.preset.rule == "best" else FED_PATIENCE
        yield from self._train_methods(fed, self.preset.fed_back, patience)

    def _hidden_states(self) -> Iterator[Tried]:
        hidden = propose_state_space(self.data, self.profile.output, self.preset)
        # Of short records one takes seconds, and the next may be the first to run.
        most, patience = self.preset.states, self.preset.patience
        patience = most if self.data.samples <= SHORT_RECORDS else patience
        yield from self._train_methods(hidden, most, patience)

    def _gated_states(self) -> Iterator[Tried]:
        gated = list(propose_gates(self.data, self.profile, self.preset))
        yield from self._train_methods(iter(gated), len(gated), len(gated))

    def _takes_lead(self, kind: str, row: Candidate) -> bool:
        """Note a candidate that is the best of its kind so far, and may be in a sum."""
        if self.preset.sums < 2 or row.family in NOT_SUMMED or row.free_run is None:
            return False
        best = self.best_of.get(kind)
        if best is not None and row.free_run >= (best.free_run or 0.0):
            return False
        self.best_of[kind] = row
        return True

    def _settle_sizes(self) -> Iterator[Tried]:
        """The numbers of regions of parts in closed form, where a sum may gain."""
        if len(self.best_of) < 2:
            return
        least = min(row.free_run or 0.0 for row in self.best_of.values())
        for kind in (CLOSED_KIND, ROOT_KIND):
            best = self.best_of.get(kind)
            if best is None or (best.free_run or 0.0) > NEAR_BEST_FACTOR * least:
                continue
            every = best, *self._smaller_ones(best)
            found = {
                (r.family, r.name): self.known.get((r.family, r.name), r) for r in every
            }
            for row in self._judge_again(*found.values()):
                found[row.family, row.name] = row
                yield row, None
            rows = [r for r in found.values() if r.eligible and r.nested is not None]
            if not rows:
                continue
            chosen = min(rows, key=lambda row: (row.nested, row.number))
            if chosen.name != best.name:
                self.parts.pop(kind, None)
                again = functools.partial(self._repeat_part, chosen)
                self.judged_before[kind] = again

    def _repeat_part(self, row: Candidate) -> Summand:
        """A candidate in closed form once more, as a part of a sum."""
        structure = self.divided[row.family, row.name][1]
        search = self._closed_search(row.family.endswith(OF_ROOT))
        found = search.repeat(row.family, structure, self.partitions)
        found = dataclasses.replace(found, name=row.name)
        return found.part(hold_to_range(found.network()))

    def _sum_kinds(self) -> Iterator[Tried]:
        """The mean of the best of some kinds, where it gains."""
        yield from self._settle_sizes()
        begin = time.perf_counter()
        for kind, judge in self.judged_before.items():
            if not self.late():
                self.watch(Trying(kind, "the best, for the sum"))
                part = judge()
                if part is not None:
                    self.parts[kind] = part
        parts = [part for part in self.parts.values() if _fits(part, self.parts)]
        found = best_sum(parts, self.preset.sums)
        if found is not None:
            remakes = [self.remakes[part.name] for part in found.parts]
            self.remakes[_title("sum", found.name)] = functools.partial(
                remake_mean, remakes
            )
            yield self._sum(found, time.perf_counter() - begin)

    def _divide_by_partitions(
        self, search: ClosedSearch
    ) -> Iterator[ClosedForm | Candidate]:
        """Candidates of partitions of other packages; a row of one that fails."""
        for name, partition in self.partitions.items():
            begin = time.perf_counter()
            try:
                yield from search.divide_by_partition(name, partition)
            except (JaxnarxError, np.linalg.LinAlgError) as error:
                seconds = time.perf_counter() - begin
                row = self._row("shared feedback", f"regions, {name}", seconds, None)
                yield dataclasses.replace(row, status="failed", detail=str(error))

    def _remember(self, losses: Float[np.ndarray, " groups"]) -> None:
        """The losses of the best so far."""
        if self.best is None or np.nansum(losses) < np.nansum(self.best):
            self.best = losses

    def _score_closed_form(
        self, found: ClosedForm, seconds: float
    ) -> tuple[Candidate, Network]:
        network = hold_to_range(found.network())
        row = self._row(found.family, found.name, seconds, network)
        lost = found.count_diverged()
        if not lost:
            self._remember(found.losses())
        row = dataclasses.replace(
            row,
            free_run=None if lost else found.free_run,
            groups=_list_errors(found.groups()),
            one_step=found.one_step(),
            unconstrained=found.unconstrained,
            detail=_turned(found),
            diverged=lost,
            status="diverged" if lost else "ok",
        )
        return _add_standard_error(row, found.losses()), network

    def _sum(self, found: Sum, seconds: float) -> Tried:
        network = found.network()
        self._remember(found.losses())
        row = self._row("sum", found.name, seconds, network)
        row = dataclasses.replace(
            row,
            free_run=found.free_run,
            groups=_list_errors(np.sqrt(found.losses())),
            one_step=found.one_step(),
        )
        return _add_standard_error(row, found.losses()), network

    def _train_methods(
        self, methods: Iterator[Trial], most: int, patience: int
    ) -> Iterator[Tried]:
        """Try methods that are trained step by step, so many of a kind at most.

        A method whose networks are all known is not tried again, nor one that failed:
        of that there is one row.
        """
        promising = False
        for n, (family, names, method) in enumerate(methods):
            if n >= most or self.late():
                return
            if n >= patience and not promising:
                return
            self.passed += 1
            anew = Retraining(method, self._most_rows(method))
            for stage, name in enumerate(names):
                again = functools.partial(anew.run, stage)
                self.remakes[_title(family, name)] = again
            rows = [self.known.get((family, name)) for name in names]
            first = rows[0]
            if all(rows) or (first is not None and first.status == "failed"):
                for stage, row in enumerate(rows):
                    if row is None:
                        continue
                    promising |= self._is_near(row)
                    if row.eligible:
                        self._remember(_losses(row))
                    if row.eligible and self._takes_lead(family, row):
                        again = functools.partial(self._part_of, method, row, stage)
                        self.judged_before[family] = again
                        self.parts.pop(family, None)
                continue
            begin = time.perf_counter()
            trying = Trying(family, names[0], folds=len(self.groups))
            self.watch(trying)
            try:
                found = self._judge(method, trying)
            except (JaxnarxError, np.linalg.LinAlgError) as error:
                row = self._row(family, names[0], time.perf_counter() - begin, None)
                yield dataclasses.replace(row, status="failed", detail=str(error)), None
                continue
            seconds = (time.perf_counter() - begin) / len(names)
            for name, one in zip(names, found, strict=True):
                row, network = self._score_trained(family, name, one, seconds)
                self._keep_errors(method, row, one)
                promising |= self._is_near(row)
                if network is not None and self._takes_lead(family, row):
                    self.parts[family] = _part(row, one, network)
                    self.judged_before.pop(family, None)
                yield row, network

    def _part_of(
        self, method: Identification | HiddenStates, row: Candidate, stage: int
    ) -> Summand | None:
        """A candidate that was judged before, as a part of a sum."""
        try:
            one = self._judge(method, Trying(row.family, row.name))[stage]
        except (JaxnarxError, np.linalg.LinAlgError):
            return None
        self._keep_errors(method, row, one)
        return None if one.network is None else _part(row, one, one.network)

    def _keep_errors(
        self,
        method: Identification | HiddenStates,
        row: Candidate,
        found: CrossValidation,
    ) -> None:
        """With hidden states on long records the errors of the cross-validation, which
        trains on without the group, stand for nested ones: training anew from the start
        would take too long. What the group has told at first may flatter them."""
        hidden = isinstance(method, HiddenStates)
        if hidden and found.complete and self.data.samples > LONG_RECORDS:
            again = functools.partial(errors_of_fold, found.left)
            self.remakes[_title(row.family, row.name)] = again

    def _is_near(self, row: Candidate) -> bool:
        """Whether a candidate came near the best so far."""
        if not row.eligible or self.best is None:
            return row.eligible
        return bool(
            np.nansum(_losses(row)) <= NEAR_BEST_FACTOR**2 * np.nansum(self.best)
        )

    def _judge(
        self, method: Identification | HiddenStates, trying: Trying
    ) -> list[CrossValidation]:
        def watch(fold: int) -> None:
            self.watch(dataclasses.replace(trying, fold=fold))

        return cross_validate(
            method,
            self.data,
            self.groups,
            self.spread,
            self.best,
            self._most_rows(method),
            begin=self.profile.begin,
            watch=watch,
        )

    def _most_rows(self, method: Identification | HiddenStates) -> int:
        """Samples that train a candidate at most."""
        bank = isinstance(method, HiddenStates) and len(method.times) > 0
        return self.preset.longest_bank if bank else self.preset.longest

    def _score_trained(
        self, family: str, name: str, found: CrossValidation, seconds: float
    ) -> Tried:
        row = self._row(family, name, seconds, found.network, found.detail)
        groups = _list_errors(np.sqrt(found.losses))
        row = dataclasses.replace(row, groups=groups, diverged=found.diverged)
        if found.diverged:
            return dataclasses.replace(row, status="diverged"), None
        if not found.complete:
            return row, None
        if told := self._contradiction(found.network):
            return dataclasses.replace(row, status=AGAINST_PHYSICS, detail=told), None
        self._remember(found.losses)
        total = float(np.nansum(found.losses * found.counts) / found.counts.sum())
        row = dataclasses.replace(
            row,
            free_run=total**0.5,
            one_step=found.one_step if np.isfinite(found.one_step) else None,
            status="ok",
        )
        return _add_standard_error(row, found.losses), found.network

    def _contradiction(self, network: Network | None) -> str:
        """What a trained network has against physics, in words; nothing if all is
        well."""
        output, physics = self.profile.output, self.physics
        if physics is None or network is None:
            return ""
        asked = f"{output} {physics} by physics"
        if physics.signs:
            found = count_wrong_signs(network, self.data, {output: physics})[output]
            if not found.known:
                return f"it comes to rest nowhere, and {asked}"
            if found.wrong:
                share = f"{found.wrong} of {found.known} gains at rest"
                return f"{share} have the wrong sign: {asked}"
        if physics.longest_time_constant is None:
            return ""
        slow = longest_time_constants(network, self.data)[output]
        if np.isnan(slow):
            return f"it comes to rest nowhere, and {asked}"
        if np.isinf(slow):
            return f"it is unstable at rest, and {asked}"
        late = is_slower(slow, physics)
        return f"a time constant is {slow:.3g} s: {asked}" if late else ""

    def _row(
        self,
        family: str,
        name: str,
        seconds: float,
        network: Network | None,
        detail: str = "",
    ) -> Candidate:
        price = None if network is None else cost(network)
        return Candidate(
            self.profile.output,
            0,
            family,
            name,
            operations=None if price is None else price.operations,
            parameters=None if price is None else price.parameters,
            seconds=round(seconds, 2),
            pole=None if network is None else largest_local_pole(network),
            bounded=None if network is None else stays_bounded(network),
            status="skipped" if network is None else "ok",
            detail=detail,
        )


def _title(family: str, name: str) -> str:
    """A candidate as its sums name it."""
    return f"{family}, {name}"


def _turned(found: ClosedForm) -> str:
    """What the constraints of physics have changed, in words."""
    wrong = [
        f"by {name} at {count} of {of} operating points"
        for name, (count, of) in found.turned.items()
        if count
    ]
    return f"without constraints its gain is wrong {', '.join(wrong)}" if wrong else ""


def _part(row: Candidate, found: CrossValidation, network: Network) -> Summand:
    return Summand(_title(row.family, row.name), network, found.left)


def _fits(part: Summand, parts: Mapping[str, Summand]) -> bool:
    """Whether a part can be added to the first of all."""
    first = next(iter(parts.values()))
    try:
        total([first.network, part.network], [1.0, 1.0])
    except SpecError:
        return False
    return True


def _list_errors(errors: Float[np.ndarray, " groups"]) -> tuple[float | None, ...]:
    return tuple(float(e) if np.isfinite(e) else None for e in errors)


def _losses(row: Candidate) -> Float[np.ndarray, " groups"]:
    """Mean squared errors of the groups of a row."""
    return np.array([np.nan if e is None else e**2 for e in row.groups])


def _add_standard_error(
    row: Candidate, losses: Float[np.ndarray, " groups"]
) -> Candidate:
    """Add the standard error of the free run, from the spread between groups."""
    losses = losses[np.isfinite(losses)]
    if row.free_run is None or len(losses) < 2:
        return row
    of_square = float(np.std(losses, ddof=1) / np.sqrt(len(losses)))
    error = of_square / (2 * max(row.free_run, 1e-300))
    return dataclasses.replace(row, standard_error=error)
