"""The verb `learn`: a population of engines from the records of donors."""

import dataclasses
import os
from collections import Counter
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import Progress
from jaxnarx.confidence import fit_domain, fit_error_model
from jaxnarx.data import Dataset, Groups, join
from jaxnarx.errors import DataError, JaxnarxError, SpecError
from jaxnarx.fleet.broken import (
    FAR_DEVIATIONS,
    LEAST_SPREAD,
    Screened,
    deviations,
    find_broken,
)
from jaxnarx.fleet.coefficients import FleetCoefficients, choose_coefficients
from jaxnarx.fleet.donors import (
    Donors,
    DonorTable,
    Pass,
    SumsShape,
    digest,
    gather_donors,
    open_folder,
    prepare_donor,
)
from jaxnarx.fleet.information import Information, gather_information, parts_of, warm_up
from jaxnarx.fleet.population import Population, fit_population
from jaxnarx.fleet.prior import FleetPrior, rivals_of
from jaxnarx.fleet.residuals import colour_of
from jaxnarx.fleet.rivals import Rivals, judge_by_samples
from jaxnarx.formatting import count, list_names
from jaxnarx.identification import identify
from jaxnarx.models import Network, ranges, set_bounds
from jaxnarx.refinement import attach_certificate
from jaxnarx.settings import Identification
from jaxnarx.simulation import Prepared, join_runs, match_records, simulate
from jaxnarx.solution import RESULTS, Solution

RUNGS = (10, 20, 50, 100, 200, 500)
"""Samples of a new engine for which the donors say what serves."""
POOLED_DONORS = 64
"""Donors whose records choose a structure, tell domain and intervals, and colour."""
JUDGED_DONORS = 128
"""Donors that are calibrated by the others."""
FOLDS = 4
"""Parts of the donors that are left out together."""
INTERVAL_GROUPS = 8
"""The same for the sizes of errors."""
FOLD_STEPS = 10
"""Steps of the EM algorithm without a part, from those with all."""
PASSES = 3
"""Linearisations at most, the first about the network as it was given."""
LINEAR_SHARE = 1e-3
"""Share of the loss by which it may differ from what was expected to first order."""
PROBED_DONORS = 8
"""Donors by whose runs that is judged."""
SEARCH_FOLDER = "search"
"""Folder of the search for a structure, in that of the sums."""
BOUND_WIDTHS = 10.0
"""Bounds of what is fed back, in widths of the donors' ranges."""


@guard_arguments
def learn(
    donors: Donors,
    network: Network | Identification | None = None,
    *,
    gates: bool = False,
    feedback: bool | None = None,
    preset: str = "quick",
    rungs: tuple[int, ...] = RUNGS,
    folder: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Solution[FleetPrior]:
    """The population that donors are drawn from: one structure, many engines.

    Coefficients of the local models are normally distributed over the engines; mean,
    covariance and the noise of every output are learnt by the EM algorithm from sums of
    every donor's free run, linearised about its own coefficients (N. M. Laird, J. H.
    Ware, Biometrics 38, 1982; `jaxnarx.fleet.population`). Donors unlike all others,
    by their coefficients or by what is left of their outputs, are found, not used and
    named. Then up to 128 donors are calibrated by the others, from 10, 20, 50 ... of
    their samples: what serves at how many samples `calibrate` takes from there.

    Args:
        donors: Records of every donor by its name, of any length, or the DataError that
            there are none. Each is asked for when it is needed: a mapping that reads
            files holds one engine at a time.
        network: The structure that all share, trained on engines of the fleet. Or the
            settings of an identification, or nothing for a search of `preset`: then the
            structure is chosen from up to 64 donors together, judged on engines that
            were left out.
        gates: Whether engines differ in the gates of their regions too.
        feedback: Whether they differ in coefficients of what is fed back. Default: only
            where hidden states are.
        preset: Of the search, see `jnx.identify`.
        rungs: Numbers of samples, rising, by which donors are calibrated.
        folder: Folder that keeps a search and the sums of every donor: the same call
            goes on there. It is for the same records: what they hold is not compared.
        progress: A function called with `verb` `"learn"`, the `pass` and how many
            donors are `done` `of` how many.

    Returns:
        `value` is the prior. `stats`: `broken` donors with what is wrong by name,
        `passes`, and `colour` by output. Status `ok`; `unidentifiable` with fewer than
        three donors that can be used: the covariance then says little.

    Raises:
        SpecError: no donor, or settings that make no sense.
        DataError: not one donor can be run.

    Example:
        prior = jnx.fleet.learn({"one": data, "other": data}, network).value
        print(prior)
    """
    names = [str(name) for name in donors]
    if not names:
        raise SpecError("a fleet needs at least one donor", field="donors")
    if list(rungs) != sorted(set(rungs)) or not rungs or rungs[0] < 1:
        raise SpecError(f"rungs must rise from 1 or more, got {rungs}", field="rungs")
    pooled = _pool(donors, names)
    base = network
    if not isinstance(base, Network):
        search = None if folder is None else Path(folder) / SEARCH_FOLDER
        base = _choose_structure(pooled, base, preset, search, progress)
    base = _widened(base, pooled)
    varied = bool(base.hidden) if feedback is None else feedback
    own = choose_coefficients(base, gates=gates, feedback=varied)
    skip = warm_up(base, map(len, pooled))
    own, spread = _scaled(own, pooled, skip)
    place = None if folder is None else Path(folder)
    key = {"network": digest(base), "donors": names, "kind": [gates, varied]}
    open_folder(place, key)
    work = _Work(donors, names, own, tuple(rungs), skip, place, progress)
    fitted = _fit(work)
    prior = _finish(
        work,
        fitted,
        pooled,
        {"gates": gates, "feedback": varied, "warm_up": skip, "output_spread": spread},
    )
    stats: dict[str, Any] = {
        "broken": {n: t for n, t in zip(names, prior.remark, strict=True) if t},
        "passes": fitted.passes,
        "colour": np.asarray(prior.population.colour),
    }
    good = int(prior.used.sum())
    detail = ""
    if broken := prior.broken():
        detail = f"{count(len(broken), 'donor')} not used: {list_names(broken)}"
    if good < 3:
        detail = f"{count(good, 'donor')} of use say little about a population"
        return Solution(prior, RESULTS.unidentifiable, stats, detail)
    return Solution(prior, RESULTS.ok, stats, detail)


def _pool(donors: Donors, names: list[str]) -> Dataset:
    """Records of some donors together, each a group of its own; without those whose
    channels, sample time, or outputs are unlike most others'."""
    step = max(1, len(names) // POOLED_DONORS)
    found, last = {}, None
    for name in names[::step][:POOLED_DONORS]:
        data = donors[name]
        if isinstance(data, DataError):
            last = data
            continue
        found[name] = data
    if not found:
        raise last or DataError("no donor has records")
    kinds = {n: (*d.channels.all, round(d.sample_time, 9)) for n, d in found.items()}
    usual = Counter(kinds.values()).most_common(1)[0][0]
    alike = {n: d for n, d in found.items() if kinds[n] == usual}
    parts = [
        dataclasses.replace(
            d,
            records=tuple(
                dataclasses.replace(r, name=f"{n} {r.name}", group=n) for r in d
            ),
        )
        for n, d in alike.items()
    ]
    size = [[np.concatenate([r.y for r in d]).std(axis=0)] for d in parts]
    size = np.log(np.maximum(np.concatenate(size), 1e-300))
    far = np.abs(deviations(size, np.full(len(size), True), LEAST_SPREAD)).max(axis=1)
    kept = [d for d, f in zip(parts, far.tolist(), strict=True) if f < FAR_DEVIATIONS]
    return join(kept or parts)


def _widened(network: Network, pooled: Dataset) -> Network:
    """The network with ranges of all donors, and bounds that let engines differ."""
    low, high = ranges(match_records(network, pooled))
    kind = network.low.dtype
    low = jnp.minimum(network.low, jnp.asarray(low, kind))
    high = jnp.maximum(network.high, jnp.asarray(high, kind))
    return set_bounds(dataclasses.replace(network, low=low, high=high), BOUND_WIDTHS)


def _engine_groups(pooled: Dataset, parts: int = FOLDS) -> Groups:
    """Engines in so many groups that are held out together."""
    engines = list(dict.fromkeys(r.group for r in pooled))
    parts = min(parts, len(engines))
    place = {name: n % parts for n, name in enumerate(engines)}
    labels = tuple(np.full(len(r), place[r.group]) for r in pooled)
    return Groups(tuple(f"engines, part {n + 1}" for n in range(parts)), labels, True)


def _choose_structure(
    pooled: Dataset,
    method: Identification | None,
    preset: str,
    folder: Path | None,
    progress: Progress | None,
) -> Network:
    """The structure of all engines, judged on engines left out."""
    if method is not None:
        return identify(pooled, method, progress=progress).value
    groups = _engine_groups(pooled)
    given: dict[str, Any] = {"groups": groups} if len(groups) > 1 else {}
    given |= {"preset": preset, "folder": folder, "progress": progress}
    return identify(pooled, **given).value


@dataclasses.dataclass(frozen=True, eq=False)
class _Work:
    """Donors, and the coefficients in which they differ."""

    donors: Donors
    names: list[str]
    own: FleetCoefficients
    rungs: tuple[int, ...]
    skip: int
    folder: Path | None
    progress: Progress | None

    @property
    def shape(self) -> SumsShape:
        """Sizes of a donor's sums."""
        network = self.own.layout.base
        return SumsShape(len(network.modelled), len(self.own.free), 1)

    def gather(self, number: int, at: np.ndarray, remark: dict[str, str]) -> Pass:
        """Sums of all donors, each about its own coefficients."""
        every = len(self.names)
        name, row = f"pass{number}", self.shape.row
        table = DonorTable.begin(self.folder, name, every, row)

        def told(n: int) -> None:
            if self.progress is not None:
                event = {"verb": "learn", "pass": number + 1, "done": n + 1}
                self.progress(event | {"of": every})

        own = self.donors, self.names, self.own, at, table, self.shape, self.skip
        gather_donors(*own, remark, told)
        return Pass(table, self.shape, at)

    def runs(self, n: int) -> Prepared:
        """The prepared records of a donor."""
        return prepare_donor(
            self.own.layout.base, self.donors[self.names[n]], self.skip
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _Fitted:
    """A population, what was found about its donors, and from which sums."""

    screened: Screened
    sums: Pass
    remark: dict[str, str]
    passes: int


def _fit(work: _Work) -> _Fitted:
    """The population, from sums about the network, then about every donor's own
    coefficients until a run loses what the last sums expect."""
    fitted = _pass(work, 0, np.zeros((len(work.names), work.shape.params)))
    while fitted.passes < PASSES and not _as_expected(work, fitted):
        fitted = _pass(work, fitted.passes, fitted.screened.estimate)
    return fitted


def _pass(work: _Work, number: int, at: Float[np.ndarray, "donors params"]) -> _Fitted:
    """The population from sums about these coefficients."""
    remark: dict[str, str] = {}
    sums = work.gather(number, at, remark)
    there = _have_samples(sums, work.names, remark)
    found = find_broken(sums.chunks, there, work.own.layout.base.output_names)
    notes = remark | {work.names[n]: text for n, text in found.remark.items()}
    return _Fitted(found, sums, notes, number + 1)


def _have_samples(
    sums: Pass, names: list[str], remark: dict[str, str]
) -> Bool[np.ndarray, " donors"]:
    """Donors of which samples count; DataError where there is none."""
    rows = [
        np.asarray(c[0].samples).sum(axis=1) > 0 for c in sums.chunks(sums.at[:, 0])
    ]
    there = np.concatenate(rows)[: len(names)]
    for n in np.flatnonzero(~there).tolist():
        remark.setdefault(names[n], "no sample counts")
    if not there.any():
        first = "; ".join(f"{n}: {t}" for n, t in list(remark.items())[:3])
        raise DataError(f"not one donor can be run: {first}")
    return there


def _as_expected(work: _Work, fitted: _Fitted) -> bool:
    """Whether runs of some donors lose what the sums of the last pass expect."""
    estimate, sums = fitted.screened.estimate, fitted.sums
    for n in np.flatnonzero(fitted.screened.used)[:PROBED_DONORS].tolist():
        expected = sums.one(n).loss(estimate[n] - sums.at[n])
        runs = work.runs(n)
        part = jax.device_put(parts_of(runs, ()))
        true = gather_information(work.own, estimate[n], runs, part, 1).square[0]
        if not np.allclose(true, expected, rtol=LINEAR_SHARE):
            return False
    return True


def _scaled(
    own: FleetCoefficients, pooled: Dataset, skip: int
) -> tuple[FleetCoefficients, Float[np.ndarray, " outputs"]]:
    """Coefficients in units of their effect on the outputs of some donors, and the
    variances of these, scaled."""
    runs = prepare_donor(own.layout.base, pooled, skip)
    part = jax.device_put(parts_of(runs, ()))
    found = gather_information(own, np.zeros(len(own.free)), runs, part, 1)
    y = np.asarray(runs.drive.measured)
    spread = [
        y[..., o][s].var() if (s := np.asarray(runs.scored)[..., o]).any() else 1.0
        for o in range(runs.scored.shape[2])
    ]
    spread = np.maximum(spread, 1e-12)
    total = np.asarray(found.samples)[0] * spread
    power = np.einsum("opp->op", np.asarray(found.gram)[0])
    size = np.sqrt((power / np.maximum(total, 1e-300)[:, None]).max(axis=0))
    if not np.all(np.isfinite(size)):
        raise DataError(
            "the free run of the network diverges on the donors: train it on some of "
            "them first"
        )
    scale = 1.0 / np.where(size > 0, size, 1.0)
    scale = jnp.asarray(scale, own.start.dtype)
    return dataclasses.replace(own, scale=scale), spread


def _finish(work: _Work, fitted: _Fitted, pooled: Dataset, facts: dict) -> FleetPrior:
    """The prior about the population's mean, and what donors say of calibration."""
    found = fitted.screened
    mean, own = np.asarray(found.population.mean), work.own
    colour = _colour(work, found)
    network = own.place(jnp.asarray(mean))
    network = _with_domain(network, work, found, pooled)
    own = dataclasses.replace(
        own,
        layout=dataclasses.replace(own.layout, base=network),
        start=own.vector(jnp.asarray(mean)),
    )
    centred = Population(
        jnp.zeros_like(found.population.mean),
        found.population.covariance,
        found.population.noise,
        jnp.asarray(colour),
    )
    rungs, ladder = _climb(dataclasses.replace(work, own=own), fitted, centred)
    remark = tuple(fitted.remark.get(n, "") for n in work.names)
    return FleetPrior(
        network,
        own,
        centred,
        tuple(work.names),
        found.estimate - mean,
        found.distance,
        found.freedom,
        found.used,
        remark,
        rungs,
        ladder,
        np.exp(_left(found, fitted.sums)),
        **facts,
    )


def _with_domain(
    network: Network, work: _Work, found: Screened, pooled: Dataset
) -> Network:
    """The network with domain and certificate, and intervals that hold the errors of
    donors by their own coefficients."""
    good = dict(zip(work.names, found.used.tolist(), strict=True))
    place = {name: n for n, name in enumerate(work.names)}
    engines = [n for n in dict.fromkeys(r.group for r in pooled) if n and good[n]]
    each = [
        dataclasses.replace(pooled, records=tuple(r for r in pooled if r.group == name))
        for name in engines
    ]
    if not each:
        return network
    runs = [
        simulate(work.own.place(jnp.asarray(found.estimate[place[name]])), one).value
        for name, one in zip(engines, each, strict=True)
    ]
    together = dataclasses.replace(
        pooled, records=tuple(r for one in each for r in one)
    )
    network = attach_certificate(network)
    try:
        network = fit_domain(network, together)
    except JaxnarxError:
        return network
    groups = _engine_groups(together, INTERVAL_GROUPS)
    known = groups if len(groups) > 1 else None
    return fit_error_model(network, together, groups=known, run=join_runs(runs))


def _left(found: Screened, sums: Pass) -> Float[np.ndarray, " outputs"]:
    """Mean logarithm of what donors' own coefficients leave of the outputs, scaled."""
    each = [
        sums.one(n).loss(found.estimate[n] - sums.at[n])
        / np.maximum(sums.one(n).samples, 1.0)
        for n in np.flatnonzero(found.used).tolist()
    ]
    return np.mean(np.log(np.maximum(each, 1e-300)), axis=0)


def _colour(work: _Work, found: Screened) -> Float[np.ndarray, " outputs"]:
    """How many samples of the residuals tell as much as one, in the median of some
    donors."""
    picked = np.flatnonzero(found.used)[:POOLED_DONORS].tolist()
    each = [colour_of(work.own, found.estimate[n], work.runs(n)) for n in picked]
    return np.median(each, axis=0)


def _climb(
    work: _Work, fitted: _Fitted, population: Population
) -> tuple[tuple[int, ...], Float[np.ndarray, "rungs ways outputs"]]:
    """Errors of donors that are calibrated by the others, rung by rung."""
    found = fitted.screened
    used = np.flatnonzero(found.used)
    judged = used[:: max(1, len(used) // JUDGED_DONORS)][:JUDGED_DONORS]
    prepared = [work.runs(n) for n in judged.tolist()]
    lengths = [int(np.asarray(r.scored).any(axis=2).sum()) for r in prepared]
    most = int(np.median(lengths)) // 2
    rungs = tuple(r for r in work.rungs if r <= most) or (max(1, most),)
    parts = min(FOLDS, len(judged))
    rows: list[np.ndarray] = []
    for fold in range(parts):
        weight = found.used.astype(float)
        weight[judged[fold::parts]] = 0.0
        if weight.any():
            chunks = fitted.sums.chunks(weight)
            others = fit_population(chunks, found.population, FOLD_STEPS)[0]
            centre = others.mean - found.population.mean
            others = dataclasses.replace(others, mean=centre)
            ways = rivals_of(work.own, others)
            pairs = prepared[fold::parts]
            rows += [_errors_of(work, r, rungs, ways, others) for r in pairs]
    rows = [row for row in rows if np.all(np.isfinite(row))]
    if not rows:
        ways = rivals_of(work.own, population)
        return rungs, np.zeros((len(rungs), len(ways), work.shape.outputs))
    return rungs, np.mean(rows, axis=0)


def _errors_of(
    work: _Work,
    runs: Prepared,
    rungs: tuple[int, ...],
    ways: Rivals,
    others: Population,
) -> Float[np.ndarray, "rungs ways outputs"]:
    """Logarithm of the squared error over the variance, of one donor's last samples;
    NaN where it has none."""
    zero = np.zeros(work.shape.params)
    part = jax.device_put(parts_of(runs, rungs))
    sums = gather_information(work.own, zero, runs, part, len(rungs) + 1)
    host = Information(*map(np.asarray, sums))
    empty = np.full((len(rungs), len(ways), work.shape.outputs), np.nan)
    if not (np.all(host.samples > 0) and np.all(np.isfinite(host.gram))):
        return empty
    y = np.asarray(runs.drive.measured)[..., : work.shape.outputs]
    spread = np.maximum(y[np.asarray(part) == len(rungs)].var(axis=0), 1e-12)
    error = judge_by_samples(ways, host, zero, np.asarray(others.noise))
    return np.log(np.maximum(error / spread, 1e-12))
