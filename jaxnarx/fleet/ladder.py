"""Donors calibrated by the others, from few of their samples, then from more."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.fleet.information import Information, gather_information, parts_of
from jaxnarx.fleet.passes import DonorWork, FittedDonors
from jaxnarx.fleet.population import Population, fit_population
from jaxnarx.fleet.prior import rivals_of
from jaxnarx.fleet.rivals import Rivals, judge_by_samples
from jaxnarx.simulation import Prepared

JUDGED_DONORS = 128
"""Donors that are calibrated by the others."""
FOLDS = 4
"""Parts of them that are left out together."""
BEGIN_SHARES = (0.0, 0.1, 0.2, 0.3)
"""Shares of a record before the samples that calibrate, donor by donor in turns: all
may have the same excitation, and one stretch of it says little about others."""
MOST_SHARE = 0.4
"""Share of a record that calibrates at most."""
FOLD_STEPS = 10
"""Steps of the EM algorithm without a part, from those with all."""


def calibrate_donors(
    work: DonorWork, fitted: FittedDonors, population: Population
) -> tuple[tuple[int, ...], Float[np.ndarray, "rungs ways outputs"]]:
    """Errors of donors that are calibrated by the others, rung by rung."""
    found = fitted.screened
    used = np.flatnonzero(found.used)
    judged = used[:: max(1, len(used) // JUDGED_DONORS)][:JUDGED_DONORS]
    prepared = [work.runs(n) for n in judged.tolist()]
    lengths = [int(np.asarray(r.scored).any(axis=2).sum()) for r in prepared]
    usual = int(np.median(lengths))
    most = int(MOST_SHARE * usual)
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
            for place in range(fold, len(judged), parts):
                first = int(BEGIN_SHARES[place // parts % len(BEGIN_SHARES)] * usual)
                runs = prepared[place]
                rows.append(_errors_of(work, runs, first, rungs, ways, others))
    rows = [row for row in rows if np.all(np.isfinite(row))]
    if not rows:
        ways = rivals_of(work.own, population)
        return rungs, np.zeros((len(rungs), len(ways), work.shape.outputs))
    return rungs, np.mean(rows, axis=0)


def _errors_of(
    work: DonorWork,
    runs: Prepared,
    first: int,
    rungs: tuple[int, ...],
    ways: Rivals,
    others: Population,
) -> Float[np.ndarray, "rungs ways outputs"]:
    """Logarithm of the squared error over the variance, of one donor's last samples;
    NaN where it has none."""
    zero = np.zeros(work.shape.params)
    edges = (first, *(first + n for n in rungs)) if first else rungs
    part = parts_of(runs, edges) - (1 if first else 0)
    sums = gather_information(
        work.own, zero, runs, jax.device_put(part), len(rungs) + 1
    )
    host = Information(*map(np.asarray, sums))
    empty = np.full((len(rungs), len(ways), work.shape.outputs), np.nan)
    if not (np.all(host.samples > 0) and np.all(np.isfinite(host.gram))):
        return empty
    y = np.asarray(runs.drive.measured)[..., : work.shape.outputs]
    spread = np.maximum(y[np.asarray(part) == len(rungs)].var(axis=0), 1e-12)
    error = judge_by_samples(ways, host, zero, np.asarray(others.noise))
    return np.log(np.maximum(error / spread, 1e-12))
