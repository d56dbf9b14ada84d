"""The stretches of a test, chosen one after the other."""

import dataclasses
import math

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.confidence import error_variables
from jaxnarx.design.limits import PlanLimits
from jaxnarx.design.stretches import Space, stretches
from jaxnarx.design.views import Seen, View, gains, watch
from jaxnarx.errors import SpecError
from jaxnarx.models import Network

STRETCH_SAMPLES = 24
"""Samples of a stretch that are asked what they tell."""
CANDIDATE_STRETCHES = 48
"""Stretches to choose the next one from."""
SCREENED_FACTOR = 4
"""Times as many are drawn where there are limits that they may break."""
OUTWARD_SHARE = 0.2
"""Share of the plan in which levels move from the trained ranges to the allowed."""
LIMIT_PROBABILITY = 0.99
"""Probability of the intervals that keep a limit of an output."""


def asked_samples(size: int) -> int:
    """How many samples of a stretch are asked what they tell."""
    return min(size, STRETCH_SAMPLES)


@dataclasses.dataclass(frozen=True)
class Step:
    """One stretch: what it gains, what a random one does, whether it stays, and the
    share of all drawn that limits of outputs refuse."""

    gain: float
    random: float
    still: bool
    refused: float


@dataclasses.dataclass(frozen=True, eq=False)
class Maker:
    """Everything that the choice of stretches needs; lengths in samples."""

    view: View
    network: Network
    limits: PlanLimits
    space: Space
    known: Space
    hold: tuple[int, int]
    size: int
    lead: int
    random: np.random.Generator

    def run(
        self, length: int
    ) -> tuple[
        Float[np.ndarray, "time inputs"],
        list[Step],
        tuple[Float[np.ndarray, "_ _"], ...],
    ]:
        """The plan, its stretches, and the information about all unknowns."""
        u = np.tile(self.begin(), (self.lead, 1))
        information = tuple(np.eye(n) for n in self.view.unknowns)
        steps: list[Step] = []
        while len(u) < self.lead + length:
            share = (len(u) - self.lead) / (OUTWARD_SHARE * length)
            tests, refused = self.candidates(
                u, _interpolate_spaces(self.known, self.space, share)
            )
            k, step, information = self.choose(tests, refused, information)
            steps.append(step)
            u = np.concatenate([u, tests[k, self.lead : self.lead + self.size]])
        return u[self.lead : self.lead + length], steps, information

    def candidates(
        self, u: Float[np.ndarray, "past inputs"], space: Space
    ) -> tuple[Float[np.ndarray, "tests time inputs"], float]:
        """Tests that keep all limits, with what is before and behind them, and the
        share that limits of outputs refuse; the first stays where it is, which is
        allowed always."""
        bounded = bool(self.limits.forbidden) or self.limits.bounds_outputs
        count = CANDIDATE_STRETCHES * (SCREENED_FACTOR if bounded else 1)
        near = count // 2 if bounded else 0
        drawn = stretches(
            *(self.random, space, u[-1], count, self.size, self.hold), near=near
        )
        drawn = drawn[self.limits.allows(drawn).all(axis=1)]
        past = np.tile(u[-self.lead :], (len(drawn), 1, 1))
        behind = np.repeat(drawn[:, -1:], self.behind, axis=1)
        tests = np.concatenate([past, drawn, behind], axis=1)
        good = np.ones(len(tests), bool)
        if self.limits.bounds_outputs:
            good[1:] = self.keeps(tests)[1:]
        return tests[good][:CANDIDATE_STRETCHES], 1.0 - float(good.mean())

    @property
    def behind(self) -> int:
        """Samples behind a stretch in which outputs come to rest."""
        return self.lead if self.limits.bounds_outputs else 0

    def keeps(
        self, tests: Float[np.ndarray, "tests time inputs"]
    ) -> Bool[np.ndarray, " tests"]:
        """Whether predicted outputs keep their limits, with a margin."""
        seen = self.view_tests(tests)
        room = self.limits.room(seen.y, margins(self.network, seen))
        return np.all(room[:, self.lead :] > 0, axis=(1, 2))

    def view_tests(self, tests: Float[np.ndarray, "tests time inputs"]) -> Seen:
        """The view of tests by the network, on the host; always of as many."""
        count = (
            CANDIDATE_STRETCHES * SCREENED_FACTOR
            if len(tests) > CANDIDATE_STRETCHES
            else CANDIDATE_STRETCHES
        )
        seen = watch(self.view, jax.device_put(_fill_up(tests, count)))
        return Seen(*(np.asarray(a)[: len(tests)] for a in seen))

    def choose(
        self,
        tests: Float[np.ndarray, "tests time inputs"],
        refused: float,
        information: tuple[Float[np.ndarray, "_ _"], ...],
    ) -> tuple[int, Step, tuple[Float[np.ndarray, "_ _"], ...]]:
        """The test that adds most, and the information with it."""
        last = self.lead + self.size
        count = asked_samples(self.size)
        at = np.linspace(self.lead, last - 1, count).astype(int)
        lower = tuple(map(np.linalg.cholesky, information))
        u = _fill_up(tests[:, :last], CANDIDATE_STRETCHES)
        added, rows = gains(self.view, *jax.device_put((lower, u, at)))
        gain = np.sum(added, axis=0)[: len(tests)]
        gain = np.where(np.isfinite(gain), gain, -math.inf)
        k = int(np.argmax(gain))
        moving = gain[1:][np.isfinite(gain[1:])]
        usual = float(moving.mean()) if len(moving) else float(gain[0])
        new = tuple(
            m + np.asarray(r[k]).T @ np.asarray(r[k])
            for m, r in zip(information, rows, strict=True)
        )
        return k, Step(float(gain[k]), usual, k == 0, refused), new

    def begin(self) -> Float[np.ndarray, " inputs"]:
        """An operating point that is allowed: in the middle of what is known, or else
        near it, or anywhere."""
        middle = 0.5 * (self.known.low + self.known.high)
        middle = np.where(self.space.binary, self.known.low, middle)
        points = [middle[None]]
        points += [
            space.points(self.random, CANDIDATE_STRETCHES * SCREENED_FACTOR - 1)
            for space in (self.known, self.space)
        ]
        for some in points:
            some = some[self.limits.allows(some)]
            if len(some) and self.limits.bounds_outputs:
                tests = np.repeat(some[:, None], self.lead + self.size, axis=1)
                tests = np.concatenate(
                    [tests, np.repeat(some[:, None], self.behind, axis=1)], axis=1
                )
                some = some[self.keeps(tests)]
            if len(some):
                away = (some - middle) / np.maximum(
                    self.space.high - self.space.low, 1e-300
                )
                return some[int(np.argmin((away**2).sum(axis=1)))]
        raise SpecError(
            "there is no plan: no operating point in the ranges keeps clear of the "
            "forbidden combinations and of the limits of the outputs; widen them",
            field="ranges",
        )


def margins(network: Network, seen: Seen) -> Float[np.ndarray, "tests time outputs"]:
    """Half the prediction interval, zero of a network without an error model."""
    known = network.errors
    half = np.zeros(seen.y.shape)
    if known is None:
        return half
    x = np.moveaxis(seen.x, 1, 0).reshape(seen.x.shape[1], -1)
    for o in range(seen.y.shape[-1]):
        y = seen.y[..., o]
        step = np.abs(np.diff(y, axis=1, prepend=y[:, :1]))
        own = np.stack([y.ravel(), step.ravel()])
        z = error_variables(x, own, seen.far.ravel())
        half[..., o] = (known.reach(o, LIMIT_PROBABILITY) * known.size(o, z)).reshape(
            y.shape
        )
    return half


def _interpolate_spaces(known: Space, space: Space, share: float) -> Space:
    """Move from the first to the second space, by a share up to one."""
    share = min(share, 1.0)
    low, high = (
        a + share * (b - a)
        for a, b in ((known.low, space.low), (known.high, space.high))
    )
    return dataclasses.replace(space, low=low, high=high)


def _fill_up(tests: Float[np.ndarray, "tests time inputs"], count: int) -> np.ndarray:
    """So many tests, the first in the place of those that are missing."""
    return np.concatenate([tests, np.repeat(tests[:1], count - len(tests), axis=0)])
