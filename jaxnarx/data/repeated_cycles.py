"""Records that repeat each other's inputs: one test cycle, driven more than once.

Two records repeat each other where their inputs agree in course and in level, perhaps
with a small shift in time, as far as the shorter one goes. The measure of likeness is
the concordance of Lin (1989) over all inputs, each in units of its standard deviation
over all records:

    likeness = 2 sum cov(a, b) / sum (var a + var b + (mean a - mean b)^2)

It is one for equal records and about zero for independent ones. An input that both
hold constant adds nothing, so that records at one operating point are not alike for
that, and one held at two levels speaks against a repeat. Switches count only where
there is nothing else.
"""

import dataclasses

import numpy as np
from jaxtyping import Complex, Float, Int

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.pieces import average_samples, standardise

COMPARED_SAMPLES = 1 << 12
"""Longer records are compared by means over as many samples as bring them below."""
MAX_SHIFT_SHARE = 0.1
"""Largest shift between two records, as a share of the shorter one."""
LEAST_LIKENESS, SURE_LIKENESS = 0.65, 0.95
"""Records less alike than the first are not tied; more alike than the second always."""
CHANCE_DEVIATIONS = 5.0
"""In between, likeness must be this many of its standard deviations under chance."""
STILL_VARIANCE = 0.05**2
"""Variance [of an input's own over all records] that counts as agreement: records that
rest at one point throughout repeat each other."""


@dataclasses.dataclass(frozen=True)
class Cycle:
    """Records, by their numbers, that repeat each other's inputs, alone or several.

    `begins` is the sample of the longest of them at which each record begins.
    """

    records: tuple[int, ...]
    begins: tuple[int, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class InputCourse:
    """The inputs of a record, standardised and freed of its own means, for comparing.

    `sums` and `squares` are running sums from 0, the latter over all inputs.
    """

    mean: Float[np.ndarray, " inputs"]
    sums: Float[np.ndarray, "inputs edges"]
    squares: Float[np.ndarray, " edges"]
    spectrum: Complex[np.ndarray, "inputs frequencies"]

    def __len__(self) -> int:
        return len(self.squares) - 1

    def parts(
        self, low: Int[np.ndarray, " lags"], high: Int[np.ndarray, " lags"]
    ) -> tuple[Float[np.ndarray, "inputs lags"], Float[np.ndarray, " lags"]]:
        """Sums, and sums of squares over all inputs, of samples `low` to `high`."""
        return (
            self.sums[:, high] - self.sums[:, low],
            self.squares[high] - self.squares[low],
        )


def cycles(data: Dataset) -> list[Cycle]:
    """Every record of `data` once, tied to those whose inputs it repeats.

    In the order of their first records. Missing samples count as held. Takes the time
    of one Fourier transform for every pair of records.
    """
    courses, every = _courses(data)
    shifts: dict[int, dict[int, int]] = {n: {} for n in range(len(data))}
    for i in range(len(courses)):
        for j in range(i):
            shift = shift_between(courses[i], courses[j])
            if shift is not None:
                shifts[i][j], shifts[j][i] = shift * every, -shift * every
    found, seen = [], set()
    for n in range(len(data)):
        if n not in seen:
            cycle = _cycle(n, shifts, data)
            seen.update(cycle.records)
            found.append(cycle)
    return found


def _cycle(first: int, shifts: dict[int, dict[int, int]], data: Dataset) -> Cycle:
    """All that are tied to record `first`, directly or through others."""
    begins, open_ = {first: 0}, [first]
    while open_:
        i = open_.pop(0)
        new = {j: begins[i] + shift for j, shift in shifts[i].items()}
        open_ += [j for j in new if j not in begins]
        begins = new | begins
    records = sorted(begins)
    origin = begins[max(records, key=lambda n: len(data.records[n]))]
    return Cycle(tuple(records), tuple(begins[n] - origin for n in records))


def _courses(data: Dataset) -> tuple[list[InputCourse], int]:
    """The courses that are compared of each record, none without moving inputs, and
    their thinning."""
    from scipy.fft import next_fast_len

    every = -(-max(map(len, data), default=0) // COMPARED_SAMPLES)
    chosen = _comparable_inputs(data)
    if not chosen:
        return [], 1
    parts = [average_samples(r.u[:, chosen].T, min(every, len(r))) for r in data]
    parts = standardise(parts)
    longest = max(x.shape[1] for x in parts)
    size = 2 * int(next_fast_len(longest, real=True) or 0)
    return [_course(x, size) for x in parts], every


def _comparable_inputs(data: Dataset) -> list[int]:
    """The inputs to compare: those that are not constant; switches, which jump between
    two values within records, only if there are no others."""
    inputs = range(len(data.channels.inputs) if data.samples else 0)
    ends = [
        [(r.u[:, i].min(), r.u[:, i].max()) for r in data if len(r)] for i in inputs
    ]
    low = {i: min(a for a, _ in ends[i]) for i in inputs}
    high = {i: max(b for _, b in ends[i]) for i in inputs}
    moving = [i for i in inputs if low[i] < high[i]]

    def is_switch(i: int) -> bool:
        return any(a < b for a, b in ends[i]) and all(
            np.isin(r.u[:, i], (low[i], high[i])).all() for r in data
        )

    return [i for i in moving if not is_switch(i)] or moving


def _course(x: Float[np.ndarray, "inputs time"], size: int) -> InputCourse:
    from scipy.fft import rfft

    mean = x.mean(axis=1)
    x = x - mean[:, None]
    sums = np.pad(np.cumsum(x, axis=1), ((0, 0), (1, 0)))
    squares = np.pad(np.cumsum(np.sum(x**2, axis=0)), (1, 0))
    return InputCourse(mean, sums, squares, np.asarray(rfft(x, size)))


def shift_between(a: InputCourse, b: InputCourse) -> int | None:
    """The sample of `a` at which `b` begins, None where they do not repeat."""
    likeness, chance, lag = compare_courses(a, b)
    return (
        lag
        if likeness > np.clip(CHANCE_DEVIATIONS * chance, LEAST_LIKENESS, SURE_LIKENESS)
        else None
    )


def compare_courses(a: InputCourse, b: InputCourse) -> tuple[float, float, int]:
    """The largest likeness over small shifts, its deviation under chance, the shift.

    The deviation is that of the covariance at full overlap of independent signals with
    these spectra (Bartlett 1946): the sum over all lags of the product of their
    autocovariances, which is that of the squared cross-covariances. Slow courses agree
    by chance more often than fast ones.
    """
    from scipy.fft import irfft

    n_a, n_b = len(a), len(b)
    size = 2 * (a.spectrum.shape[1] - 1)
    product = np.sum(a.spectrum * b.spectrum.conj(), axis=0)
    cross = np.asarray(irfft(product, size))
    reach = int(MAX_SHIFT_SHARE * min(n_a, n_b))
    lags = np.arange(-reach, reach + 1)
    lags = lags[np.argsort(np.abs(lags), kind="stable")]
    low, high = np.maximum(lags, 0), np.minimum(n_a, n_b + lags)
    count = high - low
    sum_a, square_a = a.parts(low, high)
    sum_b, square_b = b.parts(low - lags, high - lags)
    gap = (a.mean - b.mean)[:, None] + (sum_a - sum_b) / count
    covariance = cross[lags] - np.sum(sum_a * sum_b, axis=0) / count
    spread = square_a + square_b - np.sum(sum_a**2 + sum_b**2, axis=0) / count
    still = STILL_VARIANCE * count
    both = spread + count * np.sum(gap**2, axis=0) + still
    likeness = (2 * covariance + still * min(n_a, n_b) / max(n_a, n_b)) / both
    best = int(np.argmax(likeness))
    chance = 2 * np.sqrt(np.sum(cross**2) / max(n_a, n_b)) / both[best]
    return float(likeness[best]), float(chance), int(lags[best])
