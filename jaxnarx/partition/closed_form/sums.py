"""Sums of candidates: where what they answer on groups left out says that they gain."""

import dataclasses
from collections import Counter
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.models import Network, total

Errors = tuple[Int[np.ndarray, " _"], Float[np.ndarray, " _"]]
"""Places among all samples, and errors there [standard deviations]."""

LEAST_GAIN_ERRORS = 1.0
"""Standard errors by which a sum must be better than the best of its parts alone."""


@dataclasses.dataclass(frozen=True, eq=False)
class Summand:
    """A candidate of which a sum may be made."""

    name: str
    network: Network
    left: Sequence[Errors]
    """Errors of the free run over every group, by the model made without it."""
    ahead: Errors
    """One step ahead, of the model of all groups."""


@dataclasses.dataclass(frozen=True, eq=False)
class Sum:
    """The mean of some candidates, of which one may count several times.

    L. Breiman, "Bagging predictors", 1996, says why a mean gains where its parts err
    in different ways; R. Caruana et al., "Ensemble selection from libraries of models",
    2004, how its parts are chosen: one after the other, each the one that helps most.
    """

    parts: tuple[Summand, ...]
    left: tuple[Float[np.ndarray, " _"], ...]
    """Errors of every group, where all candidates have some."""

    @property
    def name(self) -> str:
        """Its parts and their shares."""
        counts = Counter(part.name for part in self.parts)
        size = len(self.parts)
        return " + ".join(f"{Fraction(n, size)} ({name})" for name, n in counts.items())

    def losses(self) -> Float[np.ndarray, " groups"]:
        """Mean squared error of every group; NaN where no sample of it counts."""
        return np.array([np.mean(e**2) if len(e) else np.nan for e in self.left])

    @property
    def free_run(self) -> float:
        """NRMSE over the groups left out."""
        return root_mean_square(np.concatenate(self.left))

    def one_step(self) -> float:
        """One-step NRMSE of the model of all groups."""
        (ahead,) = zip(
            *align_errors([[part.ahead] for part in self.parts]), strict=True
        )
        return root_mean_square(np.mean(ahead, axis=0))

    def network(self) -> Network:
        """The sum as one network."""
        counts = Counter(map(id, self.parts))
        own = {id(part): part.network for part in self.parts}
        return total([own[n] for n in counts], [float(n) for n in counts.values()])


def best_sum(parts: Sequence[Summand], most: int) -> Sum | None:
    """The mean of up to so many candidates that has the smallest error on groups left
    out; None where none gains more than a standard error on the best alone.

    The standard error is that of the difference, group by group.
    """
    if not parts:
        return None
    errors = align_errors([part.left for part in parts])
    alone = [_losses(own) for own in errors]
    taken = [int(np.argmin([loss.sum() for loss in alone]))]
    first, best = alone[taken[0]], None
    so_far, least = errors[taken[0]], np.inf
    for size in range(2, most + 1):
        means = [
            [(a * (size - 1) + b) / size for a, b in zip(so_far, own, strict=True)]
            for own in errors
        ]
        losses = [_losses(mean) for mean in means]
        one = int(np.argmin([loss.sum() for loss in losses]))
        taken.append(one)
        so_far = means[one]
        counts = np.array([len(e) for e in so_far])
        if losses[one].sum() < least and _gains(first, losses[one], counts):
            least = losses[one].sum()
            best = Sum(tuple(parts[n] for n in taken), tuple(so_far))
    return best


def _losses(errors: Sequence[Float[np.ndarray, " _"]]) -> Float[np.ndarray, " groups"]:
    return np.array([float(np.sum(e**2)) for e in errors])


def _gains(first: np.ndarray, second: np.ndarray, counts: np.ndarray) -> bool:
    """Whether the mean squared error falls by more than its standard error."""
    there = counts > 0
    gain = (first - second)[there] / counts[there]
    if len(gain) < 2:
        return False
    mean = (first - second).sum() / counts.sum()
    return bool(mean > LEAST_GAIN_ERRORS * np.std(gain, ddof=1) / np.sqrt(len(gain)))


def align_errors(
    every: Sequence[Sequence[Errors]],
) -> list[list[Float[np.ndarray, " _"]]]:
    """Errors of every candidate, group by group, at the places that all have."""
    common = []
    for groups in zip(*every, strict=True):
        places, *rest = (at for at, _ in groups)
        for at in rest:
            places = np.intersect1d(places, at, assume_unique=True)
        common.append(np.sort(places))
    return [
        [_errors_at(places, *one) for places, one in zip(common, groups, strict=True)]
        for groups in every
    ]


def _errors_at(places: np.ndarray, at: np.ndarray, error: np.ndarray) -> np.ndarray:
    order = np.argsort(at)
    return error[order[np.searchsorted(at, places, sorter=order)]]


def root_mean_square(errors: Float[np.ndarray, " _"]) -> float:
    """The root mean square of errors; zero of none."""
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else 0.0
