"""Donors calibrated by the others, from few of their samples, then from more."""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnarx.fleet.climb import Climb, climb, sums_about
from jaxnarx.fleet.information import Arrays, Information, parts_of
from jaxnarx.fleet.passes import DonorWork, FittedDonors
from jaxnarx.fleet.population import (
    Population,
    begin_population,
    fit_population,
    root_of,
)
from jaxnarx.fleet.prior import rivals_of
from jaxnarx.fleet.rivals import expect_errors, judge_by_samples
from jaxnarx.simulation import Prepared

JUDGED_DONORS = 128
"""Donors that are calibrated by the others; of fewer, about so many stretches."""
FOLDS = 4
"""Parts of them that are left out together."""
BEGIN_SHARES = (0.0, 0.1, 0.2, 0.3)
"""Shares of a record before the samples that calibrate, donor by donor in turns, of few
donors several each: all may have the same excitation, and one stretch of it says little
about others."""
MOST_SHARE = 0.4
"""Share of a record that calibrates at most."""
COUNTS = 8, 16, 32, 64, 128
"""Donors that calibrate some others: what more of them bring."""
RUNG_STEPS = 15
"""Runs at most, of every rung, where they are not linear in the coefficients."""
LEARNT = "offset and gain", "prior"
"""Ways that go out from what others have told."""
FOLD_STEPS = 10
"""Steps of the EM algorithm without a part, from those with all."""


@dataclasses.dataclass(frozen=True, eq=False)
class Ladder:
    """What donors that others calibrate tell: logarithms of squared errors over the
    variance of the output, by samples and ways, from all other donors and from so many
    (`counts`) of them; `expected` are the logarithms of the squared errors that their
    samples let expect, and `slope` says by how much theirs are larger where these
    are."""

    rungs: tuple[int, ...]
    errors: Float[np.ndarray, "rungs ways outputs"]
    expected: Float[np.ndarray, "rungs ways outputs"]
    slope: Float[np.ndarray, " outputs"]
    counts: tuple[int, ...]
    by_count: Float[np.ndarray, "counts rungs ways outputs"]


def calibrate_donors(
    work: DonorWork,
    fitted: FittedDonors,
    population: Population,
    typical: Float[np.ndarray, "outputs params params"],
    left: Float[np.ndarray, " outputs"],
) -> Ladder:
    """Errors of donors that are calibrated by the others, rung by rung; over samples
    like `typical` ones, of which own coefficients leave `left`, see `expect_errors`."""
    found = fitted.screened
    used = np.flatnonzero(found.used)
    judged = used[:: max(1, len(used) // JUDGED_DONORS)][:JUDGED_DONORS]
    prepared = [work.runs(n) for n in judged.tolist()]
    lengths = [int(np.asarray(r.scored).any(axis=2).sum()) for r in prepared]
    usual = int(np.median(lengths))
    most = int(MOST_SHARE * usual)
    rungs = tuple(r for r in work.rungs if r <= most) or (max(1, most),)
    parts = min(FOLDS, len(judged))
    begins = _begins(len(judged), parts)
    rows: list[np.ndarray] = []
    hopes: list[np.ndarray] = []
    each: list[_Judged] = []
    for fold in range(parts):
        weight = found.used.astype(float)
        weight[judged[fold::parts]] = 0.0
        if weight.any():
            chunks = fitted.sums.chunks(weight)
            others = fit_population(chunks, found.population, FOLD_STEPS)[0]
            centre = others.mean - found.population.mean
            others = dataclasses.replace(others, mean=centre)
            drawn = None if fitted.linear else _climb_from(others, population)
            of_fold = [
                _sums_of(work, prepared[n], int(share * usual), rungs, drawn)
                for n in range(fold, len(judged), parts)
                for share in begins[n]
            ]
            rows += _errors(work, of_fold, others)
            hopes += _expected(work, of_fold, others, typical, left)
            each = each or of_fold
    ways = rivals_of(work.own, population)
    shape = len(rungs), len(ways), work.shape.outputs
    errors, expected = _mean(rows, shape), _mean(hopes, shape)
    slope = _slope(rows, hopes, ways.kinds, shape[-1])
    rest = np.setdiff1d(used, judged[::parts])
    counts = tuple(n for n in COUNTS if n <= len(rest))
    by_count = np.zeros((len(counts), *shape))
    for row, n in zip(by_count, counts, strict=True):
        few = _few(fitted, rest[:n], population.colour)
        centre = few.mean - found.population.mean
        few = dataclasses.replace(few, mean=centre)
        row[:] = _mean(_errors(work, each, few), shape)
    return Ladder(rungs, errors, expected, slope, counts, by_count)


def _begins(donors: int, parts: int) -> list[tuple[float, ...]]:
    """Where the stretches of every donor begin, as shares of its record."""
    every = len(BEGIN_SHARES)
    each = min(max(JUDGED_DONORS // donors, 1), every)
    turns = (n // parts for n in range(donors))
    return [tuple(BEGIN_SHARES[(t + k) % every] for k in range(each)) for t in turns]


def _few(
    fitted: FittedDonors, donors: Int[np.ndarray, " some"], colour: Arrays
) -> Population:
    """The population of some donors alone."""
    there = np.zeros(len(fitted.screened.used), bool)
    there[donors] = True
    chunks = [c for c in fitted.sums.chunks(there.astype(float)) if c[2].any()]
    sums = [Information(*(np.asarray(a)[c[2] > 0] for a in c[0])) for c in chunks]
    joined = Information(*(np.concatenate(a) for a in zip(*sums, strict=True)))
    at = np.concatenate([c[1][c[2] > 0] for c in chunks])
    return fit_population(chunks, begin_population(joined, at, np.asarray(colour)))[0]


def _mean(rows: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """The mean over donors that tell; zero where none does."""
    rows = [row for row in rows if np.all(np.isfinite(row))]
    return np.mean(rows, axis=0) if rows else np.zeros(shape)


def _slope(
    rows: list[np.ndarray],
    hopes: list[np.ndarray],
    kinds: Sequence[str],
    outputs: int,
) -> Float[np.ndarray, " outputs"]:
    """Slope of the errors of donors by what was expected of them, all rungs and ways
    that learn from others together, from 0 to 1; 0 where nothing tells."""
    pairs = [p for p in zip(rows, hopes, strict=True) if np.all(np.isfinite(p))]
    if len(pairs) < 2:
        return np.zeros(outputs)
    learnt = [n for n, kind in enumerate(kinds) if kind in LEARNT]
    apart = np.array(pairs)[:, :, :, learnt]
    error, expected = np.moveaxis(apart - apart.mean(axis=0), 1, 0)
    both, alone = ((expected * a).sum(axis=(0, 1, 2)) for a in (error, expected))
    return np.clip(both / np.where(alone > 0, alone, 1.0), 0.0, 1.0)


def _climb_from(others: Population, population: Population) -> Climb:
    """What a donor's coefficients are drawn from by the others."""
    root = root_of(np.asarray(others.covariance))
    return Climb(np.asarray(others.mean), root, np.asarray(population.colour))


@dataclasses.dataclass(frozen=True, eq=False)
class _Judged:
    """Sums of a donor that is judged, by rung and of its last samples, as they are seen
    from every rung; the variance of these, and their squared error by the mean."""

    sums: tuple[Information, ...]
    spread: Float[np.ndarray, " outputs"]
    as_is: Float[np.ndarray, " outputs"]


def _sums_of(
    work: DonorWork,
    runs: Prepared,
    first: int,
    rungs: tuple[int, ...],
    drawn: Climb | None,
) -> _Judged:
    """Sums by which a donor is judged, behind its `first` samples: about the mean, or
    about the most probable coefficients by the samples of every rung."""
    zero = np.zeros(work.shape.params)
    edges = (first, *(first + n for n in rungs)) if first else rungs
    part = parts_of(runs, edges) - (1 if first else 0)
    parts = len(rungs) + 1
    about_mean = sums_about(work.own, zero, runs, part, parts)
    every = (about_mean,) * len(rungs)
    if drawn is not None and np.all(about_mean.samples > 0):
        at, found = drawn.mean, []
        for rung in range(len(rungs)):
            known = jax.device_put(np.where((part >= 0) & (part <= rung), 0, -1))
            at = climb(work.own, runs, known, drawn, at, RUNG_STEPS)
            found.append(sums_about(work.own, at, runs, part, parts))
        every = tuple(found)
    y = np.asarray(runs.drive.measured)[..., : work.shape.outputs]
    last = y[np.asarray(part) == len(rungs)]
    spread = last.var(axis=0) if len(last) else np.zeros(y.shape[-1])
    return _Judged(every, np.maximum(spread, 1e-12), np.asarray(about_mean.square)[-1])


def _errors(
    work: DonorWork, judged: Sequence[_Judged], others: Population
) -> list[Float[np.ndarray, "rungs ways outputs"]]:
    """Logarithms of squared errors over the variance, of donors that others calibrate;
    those without all the samples are left out."""
    ways, noise = rivals_of(work.own, others), np.asarray(others.noise)
    zero, rows = np.zeros(work.shape.params), []
    for one in filter(_has_all, judged):
        found = [judge_by_samples(ways, s, zero, noise) for s in one.sums]
        error = np.stack([e[rung] for rung, e in enumerate(found)])
        count = np.asarray(one.sums[0].samples)[-1]
        error[:, ways.kinds.index("as is")] = one.as_is / count
        rows.append(np.log(np.maximum(error / one.spread, 1e-12)))
    return rows


def _expected(
    work: DonorWork,
    judged: Sequence[_Judged],
    others: Population,
    typical: Float[np.ndarray, "outputs params params"],
    left: Float[np.ndarray, " outputs"],
) -> list[Float[np.ndarray, "rungs ways outputs"]]:
    """Logarithms of the squared errors to be expected of the same donors."""
    ways, rows = rivals_of(work.own, others), []
    for one in filter(_has_all, judged):
        grams = [np.asarray(s.gram)[: n + 1] for n, s in enumerate(one.sums)]
        found = [
            expect_errors(ways, gram.sum(axis=0), others, typical, left)
            for gram in grams
        ]
        rows.append(np.log(np.maximum(found, 1e-12)))
    return rows


def _has_all(one: _Judged) -> bool:
    """Whether a donor has all samples, and sums that can be computed with."""
    return all(np.all(s.samples > 0) and np.all(np.isfinite(s.gram)) for s in one.sums)
