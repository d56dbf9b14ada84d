"""The verb `plan`: the next test, which tells most about a network."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import Number, Pair, positive, require, span, whole
from jaxnarx.confidence import error_variables
from jaxnarx.data import Dataset, Record
from jaxnarx.design.limits import PlanLimits, limits_for
from jaxnarx.design.sensitivity import run_sensitivity
from jaxnarx.design.stretches import Space, stretches
from jaxnarx.design.views import (
    Seen,
    View,
    gains,
    make_view,
    watch,
)
from jaxnarx.errors import SpecError
from jaxnarx.models import Network, input_memory
from jaxnarx.solution import RESULTS, Solution

HOLD_MEMORIES = 0.5, 4.0
"""Shortest and longest hold, in memories of the network: long ones show gains, short
ones dynamics."""
STRETCH_HOLDS, LEAD_MEMORIES = 0.75, 5.0
"""Length of a stretch in longest holds, and what is run before and behind it in
memories."""
STRETCH_SAMPLES = 24
"""Samples of a stretch that are asked what they tell."""
CANDIDATE_STRETCHES = 48
"""Stretches to choose the next one from."""
SCREENED_FACTOR = 4
"""Times as many are drawn where there are limits that they may break."""
OUTWARD_SHARE = 0.2
"""Share of the plan in which levels move from the trained ranges to the allowed."""
REFUSED_SHARE = 0.75
"""Share of stretches refused for limits of outputs from which that is told: there a
record that fills the space told more (`experiments/edge/README.md`)."""
LIMIT_PROBABILITY = 0.99
"""Probability of the intervals that keep a limit of an output."""


@dataclasses.dataclass(frozen=True, eq=False)
class TestPlan:
    """A test to be run, and what the network makes of it.

    `data` holds the inputs as one record. Its outputs are those of the run at rest in
    the first samples, from which a free run can begin, and else not valid. `outputs`
    are those of the free run, `margin` how far measurements may lie from it where
    limits of outputs were to be kept (else zero), `index` that of the domain, one at
    its border.
    """

    __test__ = False  # no test of pytest's

    data: Dataset
    outputs: Float[np.ndarray, "time outputs"]
    margin: Float[np.ndarray, "time outputs"]
    index: Float[np.ndarray, " time"]
    output_names: tuple[str, ...]

    @property
    def inputs(self) -> Float[np.ndarray, "time inputs"]:
        """Physical units."""
        return self.data.records[0].u


@guard_arguments
def plan(
    network: Network,
    *,
    duration: float | int,
    ranges: Mapping[str, Pair] | None = None,
    rates: Mapping[str, Number] | None = None,
    forbidden: Sequence[str] = (),
    limits: Mapping[str, Number | Pair] | None = None,
    hold: Pair | None = None,
    seed: int = 0,
) -> Solution[TestPlan]:
    """The test of this length that tells most about the network, chosen greedily.

    Stretch by stretch, the one of many random ones (steps of all inputs) that adds most
    to the information, log det: about the coefficients through the free run, and about
    an error that the network cannot express, larger where the index of its domain is
    (`jaxnarx.design.views`). It begins in the middle of what is known and comes to the
    full ranges within its first fifth.

    Args:
        network: A model with a domain: one of `identify`, or of
            `jnx.confidence.fit_domain`.
        duration: Length of the test [s].
        ranges: (low, high) by input, in its unit; default the trained range.
        rates: Largest change by input, in its unit per second; default the largest of
            the training.
        forbidden: Combinations of inputs that must not be, such as
            "speed > 3000 & load < 5".
        limits: Highest value by output, or (lowest, highest). The free run keeps them
            with the 99 % prediction interval of a network that knows its errors
            (`jnx.intervals`), which widens outside of the domain.
        hold: Shortest and longest time that an input keeps a level [s]; default half
            and four times the network's memory, which may be far from that of parts of
            the engine that it has not seen at work.
        seed: Seed of the random stretches.

    Returns:
        `value` is the `TestPlan`. `stats`: `information` gained, and `random`, what
        stretches drawn at random would have gained on average at the same places;
        `gain` and `start` [s] of every stretch, its mean `index`; `outside`, the share
        of samples outside of the domain; `refused`, the share of the stretches drawn
        that might have broken a limit of an output; `still`, the share of stretches in
        which limits leave nothing but to stay; `room` by output with a limit: the least
        distance of the predicted output from it. Status `stalled` where the test stays
        still for most of its time. `SpecError` where no operating point is allowed.

    Example:
        network = jnx.confidence.fit_domain(network, data)
        found = jnx.design.plan(network, duration=20, seed=1)
        print(found.detail, found.value.inputs.shape)
    """
    kept = limits_for(network, ranges, rates, forbidden, limits)
    whole(seed, "seed", 0)
    length = round(positive(duration, "duration") / float(network.sample_time))
    held = _holds(network, hold)
    maker = _make(network, kept, np.random.default_rng(seed), length, held)
    u, steps = maker.run(length)
    return _solution(network, kept, maker, u, steps)


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

    def run(self, length: int) -> tuple[Float[np.ndarray, "time inputs"], list[Step]]:
        """The plan, and its stretches."""
        u = np.tile(self.begin(), (self.lead, 1))
        unknowns = self.view.directions.shape[1], self.view.terms
        information = tuple(np.eye(n) for n in unknowns)
        steps: list[Step] = []
        while len(u) < self.lead + length:
            share = (len(u) - self.lead) / (OUTWARD_SHARE * length)
            tests, refused = self.candidates(
                u, _interpolate_spaces(self.known, self.space, share)
            )
            k, step, information = self.choose(tests, refused, information)
            steps.append(step)
            u = np.concatenate([u, tests[k, self.lead : self.lead + self.size]])
        return u[self.lead : self.lead + length], steps

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
        at = np.unique(np.linspace(self.lead, last - 1, STRETCH_SAMPLES).astype(int))
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


def _holds(network: Network, asked: Pair | None) -> tuple[int, int]:
    """Shortest and longest hold [samples]."""
    if asked is None:
        pair = tuple(h * input_memory(network) for h in HOLD_MEMORIES)
    else:
        pair = tuple(t / float(network.sample_time) for t in span(asked, "hold"))
        require(pair[0] > 0, "hold", f"hold must be of times above zero, got {asked}")
    shortest, longest = (max(1, round(h)) for h in pair)
    return shortest, longest


def _make(
    network: Network,
    limits: PlanLimits,
    random: np.random.Generator,
    length: int,
    hold: tuple[int, int],
) -> Maker:
    """Sizes, spaces, and what the network is asked through."""
    binary = two_levels(network)
    space = Space(limits.low, limits.high, limits.rate, binary, limits.allows)
    low, high = (np.clip(a, limits.low, limits.high) for a in _training_range(network))
    known = dataclasses.replace(space, low=low, high=high)
    size = min(max(2, round(STRETCH_HOLDS * hold[1])), max(length, 2))
    lead = math.ceil(LEAD_MEMORIES * input_memory(network)) + network.history
    middle = 0.5 * (space.low + space.high)
    drawn = stretches(random, space, middle, CANDIDATE_STRETCHES, size, hold)[1:]
    sensitivity = run_sensitivity(network, lead)
    view = make_view(
        sensitivity, space, drawn[: max(1, 1000 // size)].reshape(-1, len(middle))
    )
    view = eqx.tree_at(lambda v: v.sensitivity, view, run_sensitivity(network, 0))
    return Maker(
        *(view, network, limits, space, known),
        **{"hold": hold, "size": size, "lead": lead, "random": random},
    )


def two_levels(network: Network) -> Bool[np.ndarray, " inputs"]:
    """Inputs that all stored points of the domain have at an end of their range."""
    domain = network.domain
    assert domain is not None
    out = np.zeros(len(network.channels.inputs), bool)
    for n, s in enumerate(domain.inputs):
        if not domain.weight[n] > 0:
            continue
        at = np.asarray(domain.points[:, n] / domain.weight[n] * domain.spread[n])
        share = (at + domain.middle[n] - domain.low[n]) / (
            domain.high[n] - domain.low[n]
        )
        out[s] = len(share) > 2 and np.all(np.abs(share - np.round(share)) < 1e-6)
    return out


def _training_range(network: Network) -> tuple[Float[np.ndarray, " inputs"], ...]:
    """Lowest and highest value of every input in training."""
    inputs = len(network.channels.inputs)
    return tuple(np.asarray(a, float)[:inputs] for a in (network.low, network.high))


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


def _solution(
    network: Network,
    limits: PlanLimits,
    maker: Maker,
    u: Float[np.ndarray, "time inputs"],
    steps: list[Step],
) -> Solution[TestPlan]:
    """The plan with what is to be told of it."""
    seen = Seen(
        *(
            np.asarray(a)
            for a in watch(
                maker.view, jax.device_put(_prepend_history(u, maker.lead)[None])
            )
        )
    )
    margin = margins(network, seen) if limits.bounds_outputs else np.zeros(seen.y.shape)
    y, margin, index = (a[0][maker.lead :] for a in (seen.y, margin, seen.far))
    names = tuple(network.output_names)
    value = TestPlan(_dataset(network, u, y), y, margin, index, names)
    gain, usual = (np.array([getattr(s, k) for s in steps]) for k in ("gain", "random"))
    room = limits.room(y, margin).min(axis=0)
    starts = np.arange(len(steps)) * maker.size
    stats = {
        "information": float(gain.sum()),
        "random": float(usual.sum()),
        "gain": gain,
        "start": starts * float(network.sample_time),
        "index": np.array([index[a : a + maker.size].mean() for a in starts]),
        "outside": float(np.mean(index > 1)),
        "refused": float(np.mean([s.refused for s in steps])),
        "still": float(np.mean([s.still for s in steps])),
        "room": {
            n: float(r) for n, r in zip(names, room, strict=True) if np.isfinite(r)
        },
    }
    status = RESULTS.stalled if stats["still"] > 0.5 else RESULTS.ok
    return Solution(value, status, stats, _describe(stats, maker))


def _prepend_history(u: Float[np.ndarray, "time inputs"], lead: int) -> np.ndarray:
    return np.concatenate([np.repeat(u[:1], lead, axis=0), u])


def _describe(stats: dict, maker: Maker) -> str:
    """One sentence for people."""
    told = (
        f"information {stats['information']:.4g} ({stats['random']:.4g} by random "
        f"stretches), {100 * stats['outside']:.3g} % of the samples outside of the "
        "domain"
    )
    if stats["refused"] > REFUSED_SHARE:
        told += (
            f"; limits of outputs refuse {100 * stats['refused']:.3g} % of all "
            "stretches, with what the network may err so far out: a record that fills "
            "the space under your eyes may tell more"
        )
    if stats["still"] > 0:
        told += (
            f"; {100 * stats['still']:.3g} % of the time at rest, for limits leave "
            "nothing else"
        )
    if stats["room"] and maker.network.errors is None:
        told += "; limits of outputs are kept without a margin: the network does not "
        told += "know its errors"
    return told


def _dataset(
    network: Network,
    u: Float[np.ndarray, "time inputs"],
    y: Float[np.ndarray, "time outputs"],
) -> Dataset:
    """One record; outputs valid where a free run may need them to begin."""
    channels = network.channels.measured
    first = max(network.history + network.window, 1)
    kind = network.gain.dtype
    u = np.asarray(u, kind)
    outputs = np.zeros((len(u), len(channels.outputs)), kind)
    outputs[:, list(network.modelled)] = y[0]
    valid = np.ones((len(u), u.shape[1] + outputs.shape[1]), bool)
    valid[first:, u.shape[1] :] = False
    return Dataset(
        (Record(u=u, y=outputs, valid=valid, name="plan"),),
        channels,
        float(network.sample_time),
    )
