"""Sums of candidates of several kinds: where errors on groups left out say they gain.

Candidates of one kind err alike, and their sums gain next to nothing.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.models import Network, total

Errors = tuple[Int[np.ndarray, " _"], Float[np.ndarray, " _"]]
"""Places among all samples, and errors there [standard deviations]."""

LEAST_GAIN_SHARE = 0.03
"""Share of the error of its best part that a sum must gain."""


@dataclasses.dataclass(frozen=True, eq=False)
class Summand:
    """A candidate of which a sum may be made."""

    name: str
    network: Network
    left: Sequence[Errors]
    """Errors of the free run over every group, by the model made without it."""
    ahead: Errors | None = None
    """One step ahead, of the model of all groups, where known."""


@dataclasses.dataclass(frozen=True, eq=False)
class Sum:
    """The mean of some candidates.

    L. Breiman, "Bagging predictors", 1996, says why a mean gains where its parts err
    in different ways; R. Caruana et al., "Ensemble selection from libraries of models",
    2004, how its parts are chosen: one after the other, each the one that helps most.
    """

    parts: tuple[Summand, ...]
    left: tuple[Float[np.ndarray, " _"], ...]
    """Errors of every group, where all candidates have some."""

    @property
    def name(self) -> str:
        """Its parts."""
        return "mean of " + "; ".join(part.name for part in self.parts)

    def losses(self) -> Float[np.ndarray, " groups"]:
        """Mean squared error of every group; NaN where no sample of it counts."""
        return np.array([np.mean(e**2) if len(e) else np.nan for e in self.left])

    @property
    def free_run(self) -> float:
        """NRMSE over the groups left out."""
        return root_mean_square(np.concatenate(self.left))

    def one_step(self) -> float | None:
        """One-step NRMSE of the model of all groups, where all parts tell theirs."""
        known = [[part.ahead] for part in self.parts if part.ahead is not None]
        if len(known) < len(self.parts):
            return None
        (ahead,) = zip(*align_errors(known), strict=True)
        return root_mean_square(np.mean(ahead, axis=0))

    def network(self) -> Network:
        """The sum as one network."""
        return total([part.network for part in self.parts], [1.0] * len(self.parts))


def best_sum(parts: Sequence[Summand], most: int) -> Sum | None:
    """The mean of up to so many candidates that has the smallest error on groups left
    out; None where none gains enough on the best alone.

    Parts join one after the other, each the one that helps most.
    """
    if len(parts) < 2:
        return None
    errors = align_errors([part.left for part in parts])
    alone = [_loss(own) for own in errors]
    taken = [int(np.argmin(alone))]
    least, best = (1 - LEAST_GAIN_SHARE) ** 2 * min(alone), None
    so_far = errors[taken[0]]
    while len(taken) < min(most, len(parts)):
        size = len(taken) + 1
        left = [n for n in range(len(parts)) if n not in taken]
        means = {
            n: [
                (a * (size - 1) + b) / size
                for a, b in zip(so_far, errors[n], strict=True)
            ]
            for n in left
        }
        one = min(left, key=lambda n: _loss(means[n]))
        taken.append(one)
        so_far = means[one]
        if _loss(so_far) < least:
            least = _loss(so_far)
            best = Sum(tuple(parts[n] for n in taken), tuple(so_far))
    return best


def _loss(errors: Sequence[Float[np.ndarray, " _"]]) -> float:
    """Sum of squared errors of all groups."""
    return float(sum(np.sum(np.square(e, dtype=float)) for e in errors))


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
