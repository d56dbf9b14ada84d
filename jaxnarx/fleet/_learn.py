"""The verb `learn`: a population of engines from the records of donors."""

import dataclasses
import os
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import Progress
from jaxnarx.confidence import fit_domain, fit_error_model
from jaxnarx.data import Dataset
from jaxnarx.errors import JaxnarxError, SpecError
from jaxnarx.fleet.broken import Screened
from jaxnarx.fleet.coefficients import choose_coefficients
from jaxnarx.fleet.donors import Donors, Pass, digest, open_folder
from jaxnarx.fleet.information import warm_up
from jaxnarx.fleet.ladder import calibrate_donors
from jaxnarx.fleet.passes import DonorWork, FittedDonors, fit_donors
from jaxnarx.fleet.population import expect
from jaxnarx.fleet.prior import FleetPrior
from jaxnarx.fleet.structure import (
    choose_structure,
    engine_groups,
    pool_donors,
    scale_coefficients,
    widen_ranges,
)
from jaxnarx.formatting import count, list_names
from jaxnarx.models import Network
from jaxnarx.refinement import attach_certificate
from jaxnarx.settings import Identification
from jaxnarx.simulation import join_runs, simulate
from jaxnarx.solution import RESULTS, Solution

RUNGS = (10, 20, 50, 100, 200, 500)
"""Samples of a new engine for which the donors say what serves."""
INTERVAL_GROUPS = 8
"""Groups of engines by which the sizes of errors are cross-validated."""
ALONE_SPREAD = 10.0
"""Deviation from the mean that a donor's own estimate may have, in those of the
output."""
SEARCH_FOLDER = "search"
"""Folder of the search for a structure, in that of the sums."""


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
    pooled = pool_donors(donors, names)
    base = network
    if not isinstance(base, Network):
        search = None if folder is None else Path(folder) / SEARCH_FOLDER
        base = choose_structure(pooled, base, preset, search, progress)
    base = widen_ranges(base, pooled)
    varied = bool(base.hidden) if feedback is None else feedback
    own = choose_coefficients(base, gates=gates, feedback=varied)
    skip = warm_up(base, map(len, pooled))
    own, spread = scale_coefficients(own, pooled, skip)
    place = None if folder is None else Path(folder)
    key = {"network": digest(base), "donors": names, "kind": [gates, varied]}
    open_folder(place, key)
    work = DonorWork(donors, names, own, tuple(rungs), skip, place, progress)
    fitted = fit_donors(work)
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


def _finish(
    work: DonorWork, fitted: FittedDonors, pooled: Dataset, facts: dict
) -> FleetPrior:
    """The prior about the population's mean, and what donors say of calibration."""
    found = fitted.screened
    mean, own = np.asarray(found.population.mean), work.own
    network = own.place(jnp.asarray(mean))
    network = _with_domain(network, work, found, pooled)
    own = dataclasses.replace(
        own,
        layout=dataclasses.replace(own.layout, base=network),
        start=own.vector(jnp.asarray(mean)),
    )
    zero = jnp.zeros_like(found.population.mean)
    centred = dataclasses.replace(found.population, mean=zero)
    typical = _typical_gram(found, fitted.sums)
    left = np.exp(_measure_left(found, fitted.sums))
    work = dataclasses.replace(work, own=own)
    ladder = calibrate_donors(work, fitted, centred, typical, left)
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
        ladder.rungs,
        ladder.errors,
        left,
        expected_before=ladder.expected,
        slope=ladder.slope,
        typical=typical,
        counts=ladder.counts,
        by_count=ladder.by_count,
        linear=fitted.linear,
        alone=_estimate_alone(found, fitted.sums) - mean,
        **facts,
    )


def _estimate_alone(found: Screened, sums: Pass) -> Float[np.ndarray, "donors params"]:
    """Coefficients of every donor by its own samples, hardly drawn to the mean."""
    wide = np.eye(len(np.asarray(found.population.mean))) * ALONE_SPREAD
    loose = dataclasses.replace(found.population, covariance=jnp.asarray(wide**2))
    chunks = sums.chunks(found.used.astype(float))
    each = [expect(sums, at, w, loose, wide).mean for sums, at, w in chunks]
    return np.concatenate(each)[: len(found.used)]


def _with_domain(
    network: Network, work: DonorWork, found: Screened, pooled: Dataset
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
    groups = engine_groups(together, INTERVAL_GROUPS)
    known = groups if len(groups) > 1 else None
    return fit_error_model(network, together, groups=known, run=join_runs(runs))


def _typical_gram(
    found: Screened, sums: Pass
) -> Float[np.ndarray, "outputs params params"]:
    """Mean square of what the coefficients move, over all samples of the donors."""
    gram, samples = 0.0, 0.0
    for one, _, weight in sums.chunks(found.used.astype(float)):
        gram = gram + np.einsum("n,nopq->opq", weight, np.asarray(one.gram))
        samples = samples + weight @ np.asarray(one.samples)
    return gram / np.maximum(samples, 1.0)[:, None, None]


def _measure_left(found: Screened, sums: Pass) -> Float[np.ndarray, " outputs"]:
    """Mean logarithm of what donors' own coefficients leave of the outputs, scaled."""
    each = []
    for n in np.flatnonzero(found.used).tolist():
        one = sums.one(n)
        loss = one.loss(found.estimate[n] - sums.at[n])
        each.append(loss / np.maximum(one.samples, 1.0))
    return np.mean(np.log(np.maximum(each, 1e-300)), axis=0)
