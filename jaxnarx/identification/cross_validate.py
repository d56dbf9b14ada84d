"""Free-run errors on groups left out, of methods that are trained step by step."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset, Groups, thin_records
from jaxnarx.errors import DataError, JaxnarxError
from jaxnarx.identification._by_method import run_method
from jaxnarx.linear import drop_inactive, fit_states, refit_states
from jaxnarx.models import Network, hold_to_range, set_ranges
from jaxnarx.partition import Errors
from jaxnarx.settings import HiddenStates, Identification
from jaxnarx.simulation import match_records, predict, simulate

FIRST_STEPS_FACTOR = 3.0
"""Error in training after the first steps of a start, as a multiple of the best
candidate's on groups left out, beyond which it is not trained."""
HOPELESS_FACTORS = 2.0, 1.5
"""Error on the first group, and on the first two or more, as a multiple of the best
candidate's there, beyond which the other groups are not tried."""
TRAINING_FACTOR = 1.25
"""Error in training, as a multiple of the best candidate's on groups left out, beyond
which no group is left out: up to there the mean of both may gain."""
WEAK_PULL = 0.001
"""Pull that does not hold on to anything."""


@dataclasses.dataclass(frozen=True, eq=False)
class CrossValidation:
    """Errors of one candidate on groups left out, in standard deviations."""

    losses: Float[np.ndarray, " groups"]
    """Mean squared error of every group; NaN where it was not tried, or too short."""
    counts: Float[np.ndarray, " groups"]
    """Samples that count."""
    one_step: float
    diverged: int
    """Records."""
    network: Network | None
    """Network trained on all records; None where the candidate was given up."""
    detail: str = ""
    left: tuple[Errors, ...] = ()
    """Errors of the free run over every group left out."""

    @property
    def complete(self) -> bool:
        """Whether every group has been tried."""
        return self.network is not None


def cross_validate(
    method: Identification | HiddenStates,
    data: Dataset,
    groups: Groups,
    spread: float,
    best: Float[np.ndarray, " groups"] | None = None,
    rows: int | None = None,
    *,
    one_step: bool | None = None,
    begin: int = 0,
    watch: Callable[[int], None] = lambda fold: None,
) -> list[CrossValidation]:
    """Train without every group in turn, run freely over it; then train on everything.

    A method may end with several networks of a kind (`trained`); each is judged. It is
    given up where runs of all of them diverge, or have errors far beyond those of the
    `best` candidate. `spread` is the output's standard deviation. Stretches of up to
    `rows` samples train; runs go over all samples of a group, held to the ranges of all
    data, as the network of all is in use. The error one step ahead is left out, NaN,
    where `one_step` is False, and by default with hidden states: it has an estimate of
    these for every sample, and takes longer than the training. The first `begin`
    samples of every record judge nothing (`DataProfile.begin`). `watch` is called with
    the number of every fold, from 1, before it is trained.

    With hidden states everything trains first, from several starts, and nothing is left
    out where the error in training is far beyond the best candidate's on what was left
    out.
    Without a group that of the strongest pull is then trained from where it stands, and
    again from there, the others one from the other: what a pull holds on to has been
    trained without the group. Candidates in closed form keep their partition and
    feedback in the same way. Training from the starts without a group of a short record
    often ends elsewhere, which says little of the network that is judged
    (`experiments/public/README.md`).
    """
    hidden = isinstance(method, HiddenStates)
    one_step = not hidden if one_step is None else one_step
    whole: list[Network] = []
    every: list[_Judging] = []
    parted = False
    if isinstance(method, HiddenStates):
        parted = rows is None or data.samples <= rows
        everything = groups.exclude_group(data) if parted else data
        whole = fit_full(method, everything, rows, best)
        every = [_Judging(len(groups), one_step, begin) for _ in whole]
        if told := _hopeless(whole, data, spread, best, begin):
            return [one.outcome(None, told) for one in every]
    for g, fold in enumerate(groups.folds(data, whole=True)):
        watch(g + 1)
        train = groups.exclude_group(data, g) if parted else fold.train
        if isinstance(method, HiddenStates):
            last = max(n for n, one in enumerate(every, 1) if not one.told)
            networks = refit_stages(whole[:last], method, train, data, rows)
            networks += [None] * (len(whole) - last)
        else:
            networks = fit_method(method, train, rows, known=data)
        every = every or [_Judging(len(groups), one_step, begin) for _ in networks]
        first = group_places(data, groups, g)
        for one, network in zip(every, networks, strict=True):
            one.look(g, network, fold.left, spread, best, first)
        if all(one.told for one in every):
            return [one.outcome(None, one.told) for one in every]
    whole = whole or fit_method(method, data, rows)
    return [
        one.outcome(None if one.told else drop_inactive(network), one.told)
        for one, network in zip(every, whole, strict=True)
    ]


class _Judging:
    """The held-out errors of one network of a method so far."""

    def __init__(self, groups: int, one_step: bool, begin: int):
        self.begin = begin
        self.losses, self.counts = np.full(groups, np.nan), np.zeros(groups)
        self.ahead, self.diverged, self.told = 0.0 if one_step else np.nan, 0, ""
        none = np.zeros(0, int), np.zeros(0, np.float32)
        self.left: list[Errors] = [none for _ in range(groups)]

    def look(
        self,
        g: int,
        network: Network | None,
        left: Dataset,
        spread: float,
        best: Float[np.ndarray, " groups"] | None,
        first: Sequence[int],
    ) -> None:
        """Run the network of the group left out, and say whether that is the last.

        `first` are the places of the records' first samples among all. One too short
        judges nothing. Without a network, if it was not given up before, it could not
        be trained: that counts as one that diverges.
        """
        if self.told:
            return
        if network is None:
            self.diverged += 1
        else:
            self._run(g, network, left, spread, first)
        self.told = self._stop_reason(g, best)

    def _run(
        self,
        g: int,
        network: Network,
        left: Dataset,
        spread: float,
        first: Sequence[int],
    ) -> None:
        try:
            own, bad = run_group(network, left, spread, first, begin=self.begin)
            self.losses[g], self.counts[g] = _pool([own])
            self.diverged += bad
            self.left[g] = own[0], own[1].astype(np.float32)
            if self.ahead == self.ahead:  # wanted
                ahead = score(network, left, spread, k=1, begin=self.begin)[0]
                self.ahead += self.counts[g] * ahead
        except DataError:
            return

    def _stop_reason(self, g: int, best: Float[np.ndarray, " groups"] | None) -> str:
        """Why no further group is tried, or ""."""
        if self.diverged:
            return "diverges"
        done, worst = slice(g + 1), HOPELESS_FACTORS[min(g, 1)] ** 2
        mine = np.nansum(self.losses[done])
        if best is None or mine <= worst * np.nansum(best[done]):
            return ""
        return f"given up after {g + 1} of {len(self.losses)} groups"

    def outcome(self, network: Network | None, detail: str = "") -> CrossValidation:
        """The outcome."""
        one_step = np.nan
        if network is not None:
            one_step = float(np.sqrt(self.ahead / max(self.counts.sum(), 1.0)))
        left = () if network is None else tuple(self.left)
        return CrossValidation(
            self.losses, self.counts, one_step, self.diverged, network, detail, left
        )


def fit_full(
    method: HiddenStates,
    data: Dataset,
    rows: int | None = None,
    best: Float[np.ndarray, " groups"] | None = None,
) -> list[Network]:
    """Networks trained on everything, one for every stage of the method.

    `DataError` where all are far beyond the `best` candidate after their first steps.
    """
    limit = (
        np.inf if best is None else FIRST_STEPS_FACTOR * float(np.nanmean(best)) ** 0.5
    )
    some = _thin_valid(data, rows, method.stretch)
    fit = fit_states(some, method, hopeless=limit)
    return _hold_to_range(fit.stats["path"], data)


def refit_stages(
    whole: list[Network],
    method: HiddenStates,
    data: Dataset,
    known: Dataset,
    rows: int | None = None,
) -> list[Network | None]:
    """The networks of all stages trained once more, on these data.

    The first network of every number of regions is trained twice from where it stands,
    for it is pulled towards its former parameters, which have seen other data (once
    where the pull is too weak for that); each other starts from the one before it, or
    is trained twice where that fails.
    """
    found: list[Network | None] = []
    before, size = None, 0
    for (regions, pull), network in zip(method.stages, whole, strict=False):
        if before is None or regions != size:
            before, size = refit(network, method, pull, data, known, rows), regions
            if pull <= WEAK_PULL:
                found.append(before)
                continue
        if before is not None:
            before = refit(before, method, pull, data, known, rows)
        found.append(before)
    return found


def refit(
    network: Network,
    method: HiddenStates,
    pull: float,
    data: Dataset,
    known: Dataset,
    rows: int | None = None,
) -> Network | None:
    """A network trained once more, on these data, and held to what all that are known
    say; None where that fails."""
    try:
        some = _thin_valid(data, rows, method.stretch)
        # Held as it is in use, it would be another program than the first training's.
        one = refit_states(hold_to_range(network, None), some, method, pull)
    except (JaxnarxError, np.linalg.LinAlgError):
        return None
    return _hold_to_range([one], known)[0]


def _hopeless(
    networks: list[Network],
    data: Dataset,
    spread: float,
    best: Float[np.ndarray, " groups"] | None,
    begin: int,
) -> str:
    """Why nothing needs to be left out, or ""."""
    try:
        scores = [score(network, data, spread, begin=begin) for network in networks]
    except DataError as error:
        return str(error)
    if all(bad for *_, bad in scores):
        return "diverges in training"
    error = min(loss for loss, *_ in scores)
    if best is not None and error > TRAINING_FACTOR**2 * np.nanmean(best):
        return f"an error in training of {error**0.5:.3g}"
    return ""


def fit_method(
    method: Identification | HiddenStates,
    data: Dataset,
    rows: int | None = None,
    *,
    known: Dataset | None = None,
) -> list[Network]:
    """The networks of a method, trained on at most so many samples and held to the
    range of all that are known, by default these: with hidden states one for every
    stage, else one alone."""
    shortest = method.stretch if isinstance(method, HiddenStates) else 0
    some, known = _thin_valid(data, rows, shortest), data if known is None else known
    if isinstance(method, HiddenStates):
        return _hold_to_range(fit_states(some, method).stats["path"], known)
    return _hold_to_range([run_method(some, method, None, None).value], known)


def _thin_valid(data: Dataset, rows: int | None, shortest: int = 0) -> Dataset:
    """Stretches of so many samples, of those that are valid."""
    count = sum(int(r.valid.any(axis=1).sum()) for r in data)
    return data if rows is None or count <= rows else thin_records(data, rows, shortest)


def _hold_to_range(networks: list[Network], known: Dataset) -> list[Network]:
    """Networks held to the range of all that is known, whatever part has trained
    them."""
    return [
        hold_to_range(set_ranges(network, match_records(network, known)))
        for network in networks
    ]


def score(
    network: Network,
    data: Dataset,
    spread: float,
    k: int | None = None,
    *,
    begin: int = 0,
) -> tuple[float, int, int]:
    """Mean squared error, samples that count, and records that diverge; see
    `run_errors`."""
    parts, diverged = run_errors(network, data, spread, k, begin=begin)
    return *_pool(parts), diverged


def run_errors(
    network: Network,
    data: Dataset,
    spread: float,
    k: int | None = None,
    *,
    begin: int = 0,
) -> tuple[list[Errors], int]:
    """Errors of every record where samples count, measured less computed, and the
    number of records that diverge.

    The run of one output is free, or `k` steps ahead. The first `begin` samples do not
    count; DataError where no other does.
    """
    run = (simulate(network, data) if k is None else predict(network, data, k)).value
    (o,) = network.modelled
    found = []
    for r, y, scored in zip(data, run.outputs, run.scored, strict=True):
        at = begin + np.flatnonzero(scored[begin:, 0])
        found.append((at, (r.y[at, o] - y[at, 0]) / spread))
    if not any(len(at) for at, _ in found):
        raise DataError(f"no sample counts behind the first {begin} of a record")
    return found, int(sum(d[0] for d in run.diverged))


def group_places(data: Dataset, groups: Groups, g: int) -> list[int]:
    """The places of the first samples of a group's records among all samples."""
    edges = np.cumsum([0, *map(len, data)])[:-1].tolist()
    return [n for n, own in zip(edges, groups.labels, strict=True) if g in own]


def run_group(
    network: Network,
    left: Dataset,
    spread: float,
    places: Sequence[int],
    *,
    begin: int,
) -> tuple[Errors, int]:
    """Errors of the free run over a group, whose records begin at these places, and the
    number of records that diverge; see `run_errors`."""
    parts, diverged = run_errors(network, left, spread, begin=begin)
    pairs = list(zip(places, parts, strict=True))
    at = np.concatenate([n + at for n, (at, _) in pairs])
    return (at, np.concatenate([error for _, (_, error) in pairs])), diverged


def _pool(parts: Sequence[Errors]) -> tuple[float, int]:
    """Mean squared error, and samples that count."""
    every = np.concatenate([error for _, error in parts])
    return float(np.mean(every**2)), len(every)
