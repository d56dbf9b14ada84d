"""Ways to calibrate a new engine, each a prior and a weight of the new samples.

`as is`: the population's mean. `offset and gain`: what is done by hand, two numbers for
every output. `prior`: mean and covariance of the population; residuals of engine models
are errors of the model, not white noise, so new samples weigh less than their number,
and by how much is tried. `own fit`: least squares of the new samples alone, with a
ridge.

Which one serves is learnt from the donors: each is calibrated by a population without
it from 10, 20, 50 ... samples in a row and judged on its last ones. A stretch of
samples may tell less than theirs did, of a gain nothing where all inputs rest, say: how
much is computed for every way (`expect_errors`), and counts as far as the donors'
errors went along with it. All of it is algebra on the sums of `information`.
"""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.fleet.information import Information
from jaxnarx.fleet.population import Population, root_of

WEIGHTS = (1.0, 0.25, 1 / 16, 1 / 64, 1 / 256)
"""Weights of the new samples that are tried beside a prior."""
SPREADS = (0.1, 0.3, 1.0, 3.0)
"""Standard deviations of coefficients that are tried in an engine's own fit."""
TWO_NUMBERS_SPREAD = 1.0
"""Standard deviation of an offset, in those of the output, and of a gain."""
DONORS_COUNT = 20.0
"""Independent samples of the new engine that say as much about which way is best as all
donors do."""
WEIGHT_DOUBT = 0.03
"""What a weight adds to the logarithm of its error for every factor of 4 from that of
the colour of the residuals: where the donors do not tell, theory does."""
KINDS = ("as is", "offset and gain", "prior", "own fit")


@dataclasses.dataclass(frozen=True, eq=False)
class Rivals:
    """All ways at once: their kinds, weights, means, and roots of their covariances."""

    kinds: tuple[str, ...]
    weight: Float[np.ndarray, " ways"]
    mean: Float[np.ndarray, "ways params"]
    root: Float[np.ndarray, "ways params params"]

    def __len__(self) -> int:
        return len(self.kinds)


def make_rivals(
    population: Population,
    two_numbers: Float[np.ndarray, "params two"],
    zero: Float[np.ndarray, " params"],
) -> Rivals:
    """The ways to calibrate an engine of a population.

    `two_numbers` are the directions of offset and gain, `zero` the place at which all
    coefficients vanish.
    """
    mean = np.asarray(population.mean)
    params = len(mean)
    learnt = root_of(np.asarray(population.covariance))
    width = max(params, two_numbers.shape[1])

    def padded(root):
        return np.pad(root, ((0, 0), (0, width - root.shape[1])))

    ways = [("as is", 1.0, mean, padded(np.zeros((params, 0))))]
    by_two = padded(TWO_NUMBERS_SPREAD * two_numbers)
    ways.append(("offset and gain", 1.0, mean, by_two))
    ways += [("prior", w, mean, padded(learnt)) for w in WEIGHTS]
    ways += [("own fit", 1.0, zero, padded(s * np.eye(params))) for s in SPREADS]
    kinds, weight, means, roots = zip(*ways, strict=True)
    return Rivals(kinds, np.array(weight), np.stack(means), np.stack(roots))


def estimate_each(
    information: Information,
    at: Float[np.ndarray, " params"],
    precision: Float[np.ndarray, " outputs"],
    weight: Float[np.ndarray, " ways"],
    mean: Float[np.ndarray, "ways params"],
    root: Float[np.ndarray, "ways params rank"],
) -> Float[np.ndarray, "sets ways params"]:
    """Coefficients from every one of many sums of samples, by every way; all sums are
    about the same coefficients. As `posterior`, by LAPACK for all sets at once."""
    gram = np.einsum("sopq,o->spq", np.asarray(information.gram), precision)
    right = np.einsum("sop,o->sp", np.asarray(information.right), precision)
    found = []
    for w, m, r in zip(weight, mean, root, strict=True):
        inner = np.eye(r.shape[1]) + w * (r.T @ gram @ r)
        slope = w * (right - gram @ (at - m)) @ r
        found.append(m - np.linalg.solve(inner, slope[..., None])[..., 0] @ r.T)
    return np.stack(found, axis=1)


def _by_all(rivals: Rivals, information: Information, at, noise) -> np.ndarray:
    given = rivals.weight, rivals.mean, rivals.root
    return estimate_each(information, at, 1.0 / noise, *given)


def expect_errors(
    rivals: Rivals,
    gram: Float[np.ndarray, "outputs params params"],
    population: Population,
    typical: Float[np.ndarray, "outputs params params"],
    left: Float[np.ndarray, " outputs"],
) -> Float[np.ndarray, "ways outputs"]:
    """Squared errors that engines drawn from the population have, calibrated by samples
    of this `gram` by every way.

    With a way's mean m and root R, the sums G = sum_o gram_o / noise_o and
    B = w R (I + w R' G R)^-1 R', an engine v from the population is estimated with the
    error (I - B G)(v - m) - B n, where the noise n has the covariance G times the
    residuals' colour. Errors count over samples of the `typical` mean square, in which
    an engine's own coefficients leave `left`.
    """
    noise, colour = (np.asarray(a) for a in (population.noise, population.colour))
    mean, cov = (np.asarray(a) for a in (population.mean, population.covariance))
    each = gram / noise[:, None, None]
    known, noisy = each.sum(axis=0), np.einsum("o,opq->pq", colour, each)
    found = np.empty((len(rivals), len(left)))
    for n, (w, m, r) in enumerate(
        zip(rivals.weight, rivals.mean, rivals.root, strict=True)
    ):
        inner = np.eye(r.shape[1]) + w * (r.T @ known @ r)
        gain = w * r @ np.linalg.solve(inner, r.T)
        rest = np.eye(len(mean)) - gain @ known
        apart = cov + np.outer(mean - m, mean - m)
        error = rest @ apart @ rest.T + gain @ noisy @ gain.T
        found[n] = np.einsum("opq,qp->o", typical, error)
    return found + left[None]


def judge_by_samples(
    rivals: Rivals,
    parts: Information,
    at: Float[np.ndarray, " params"],
    noise: Float[np.ndarray, " outputs"],
) -> Float[np.ndarray, "rungs ways outputs"]:
    """Squared errors of the last part, calibrated by those before: by the first alone,
    by the first two, and so on."""
    before = Information(*(np.cumsum(np.asarray(a), axis=0)[:-1] for a in parts))
    last = Information(*(np.asarray(a)[-1] for a in parts))
    found = _by_all(rivals, before, at, noise)
    flat = found.reshape(-1, found.shape[2])
    count = np.maximum(last.samples, 1.0)
    errors = np.stack([last.loss(v - at) for v in flat]) / count
    return errors.reshape(*found.shape[:2], -1)


def judge_by_blocks(
    rivals: Rivals,
    blocks: Information,
    at: Float[np.ndarray, " params"],
    noise: Float[np.ndarray, " outputs"],
    count: int,
) -> Float[np.ndarray, "ways outputs"]:
    """Mean squared error of the first so many blocks, each by the others."""
    blocks = Information(*(np.asarray(a)[:count] for a in blocks))
    total = blocks.total()
    pairs = zip(total, blocks, strict=True)
    without = Information(*(np.asarray(t)[None] - np.asarray(a) for t, a in pairs))
    found = _by_all(rivals, without, at, noise)
    losses = [
        [Information(*(a[b] for a in blocks)).loss(v - at) for v in ways]
        for b, ways in enumerate(found)
    ]
    return np.sum(losses, axis=0) / np.maximum(np.asarray(total.samples), 1.0)


def choose(
    rivals: Rivals,
    donors: Float[np.ndarray, "ways outputs"],
    own: Float[np.ndarray, "ways outputs"],
    samples: Float[np.ndarray, " outputs"],
    colour: Float[np.ndarray, " outputs"],
) -> tuple[Int[np.ndarray, " outputs"], Float[np.ndarray, "ways outputs"]]:
    """The way of least expected error for every output, and the scores of all.

    Both are logarithms of errors: what donors say weighs as much as `DONORS_COUNT`
    independent samples of the engine itself.
    """
    independent = samples / colour
    share = independent / (independent + DONORS_COUNT)
    score = (1 - share) * donors + share * own
    steps = np.abs(np.log(rivals.weight[:, None] * colour)) / np.log(4)
    learnt = np.array(rivals.kinds)[:, None] == "prior"
    doubt = np.where(learnt, WEIGHT_DOUBT * steps, 0.0)
    return np.argmin(score + doubt, axis=0), score


def at_samples(
    rungs: tuple[int, ...],
    table: Float[np.ndarray, "rungs *rest"],
    samples: float | int,
) -> Float[np.ndarray, "*rest"]:
    """A row of a table for any number of samples, between its rungs by the logarithm of
    the number."""
    place = np.interp(
        np.log(max(samples, 1.0)), np.log(rungs), np.arange(float(len(rungs)))
    )
    low = min(int(place), len(rungs) - 1)
    high = min(low + 1, len(rungs) - 1)
    part = place - low
    return (1 - part) * table[low] + part * table[high]
