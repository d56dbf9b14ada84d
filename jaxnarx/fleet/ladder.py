"""Donors calibrated by the others, from few of their samples, then from more."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnarx.fleet.information import Information, gather_information, parts_of
from jaxnarx.fleet.passes import DonorWork, FittedDonors
from jaxnarx.fleet.population import Population, begin_population, fit_population
from jaxnarx.fleet.prior import rivals_of
from jaxnarx.fleet.rivals import judge_by_samples
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
COUNTS = 8, 16, 32, 64, 128
"""Donors that calibrate some others: what more of them bring."""
FOLD_STEPS = 10
"""Steps of the EM algorithm without a part, from those with all."""


@dataclasses.dataclass(frozen=True, eq=False)
class Ladder:
    """What donors that others calibrate tell: logarithms of squared errors over the
    variance of the output, by samples and ways, from all other donors and from so many
    (`counts`) of them."""

    rungs: tuple[int, ...]
    errors: Float[np.ndarray, "rungs ways outputs"]
    counts: tuple[int, ...]
    by_count: Float[np.ndarray, "counts rungs ways outputs"]


def calibrate_donors(
    work: DonorWork, fitted: FittedDonors, population: Population
) -> Ladder:
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
    begins = [BEGIN_SHARES[n // parts % len(BEGIN_SHARES)] for n in range(len(judged))]
    each = [
        _sums_of(work, runs, int(share * usual), rungs)
        for runs, share in zip(prepared, begins, strict=True)
    ]
    rows: list[np.ndarray] = []
    for fold in range(parts):
        weight = found.used.astype(float)
        weight[judged[fold::parts]] = 0.0
        if weight.any():
            chunks = fitted.sums.chunks(weight)
            others = fit_population(chunks, found.population, FOLD_STEPS)[0]
            rows += _errors(work, each[fold::parts], others, found.population)
    ways = len(rivals_of(work.own, population))
    shape = len(rungs), ways, work.shape.outputs
    errors = _mean(rows, shape)
    rest = np.setdiff1d(used, judged[::parts])
    counts = tuple(n for n in COUNTS if n <= len(rest))
    by_count = np.zeros((len(counts), *shape))
    for row, n in zip(by_count, counts, strict=True):
        few = _few(fitted, rest[:n])
        row[:] = _mean(_errors(work, each[::parts], few, found.population), shape)
    return Ladder(rungs, errors, counts, by_count)


def _few(fitted: FittedDonors, donors: Int[np.ndarray, " some"]) -> Population:
    """The population of some donors alone."""
    there = np.zeros(len(fitted.screened.used), bool)
    there[donors] = True
    chunks = [c for c in fitted.sums.chunks(there.astype(float)) if c[2].any()]
    sums = [Information(*(np.asarray(a)[c[2] > 0] for a in c[0])) for c in chunks]
    joined = Information(*(np.concatenate(a) for a in zip(*sums, strict=True)))
    at = np.concatenate([c[1][c[2] > 0] for c in chunks])
    return fit_population(chunks, begin_population(joined, at))[0]


def _mean(rows: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """The mean over donors that tell; zero where none does."""
    rows = [row for row in rows if np.all(np.isfinite(row))]
    return np.mean(rows, axis=0) if rows else np.zeros(shape)


@dataclasses.dataclass(frozen=True, eq=False)
class _Judged:
    """Sums of a donor that is judged, by rung and of its last samples, and the variance
    of these."""

    sums: Information
    spread: Float[np.ndarray, " outputs"]


def _sums_of(
    work: DonorWork, runs: Prepared, first: int, rungs: tuple[int, ...]
) -> _Judged:
    """Sums by which a donor is judged, behind its `first` samples."""
    zero = np.zeros(work.shape.params)
    edges = (first, *(first + n for n in rungs)) if first else rungs
    part = parts_of(runs, edges) - (1 if first else 0)
    at = jax.device_put(part)
    sums = gather_information(work.own, zero, runs, at, len(rungs) + 1)
    y = np.asarray(runs.drive.measured)[..., : work.shape.outputs]
    last = y[np.asarray(part) == len(rungs)]
    spread = last.var(axis=0) if len(last) else np.zeros(y.shape[-1])
    return _Judged(Information(*map(np.asarray, sums)), np.maximum(spread, 1e-12))


def _errors(
    work: DonorWork, judged: list[_Judged], others: Population, about: Population
) -> list[Float[np.ndarray, "rungs ways outputs"]]:
    """Logarithms of squared errors over the variance, of donors that others calibrate;
    NaN where a donor has not all the samples."""
    others = dataclasses.replace(others, mean=others.mean - about.mean)
    ways, noise = rivals_of(work.own, others), np.asarray(others.noise)
    zero, rows = np.zeros(work.shape.params), []
    for one in judged:
        host = one.sums
        if np.all(host.samples > 0) and np.all(np.isfinite(host.gram)):
            error = judge_by_samples(ways, host, zero, noise)
            rows.append(np.log(np.maximum(error / one.spread, 1e-12)))
    return rows
