"""The verb `plan`: the next test, which tells most about a network."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import Number, Pair, positive, require, span, whole
from jaxnarx.data import Dataset, Record
from jaxnarx.design.greedy import CANDIDATE_STRETCHES, Maker, Step, margins
from jaxnarx.design.limits import PlanLimits, limits_for
from jaxnarx.design.stretches import Space, stretches
from jaxnarx.design.views import Seen, View, network_view, watch
from jaxnarx.models import Network, input_memory
from jaxnarx.solution import RESULTS, Solution

MakeView = Callable[[Space, Float[np.ndarray, "time inputs"], int, int], View]
"""Makes a view of tests in a space, from stretches of it, the samples before a stretch,
and those of one."""

HOLD_MEMORIES = 0.5, 4.0
"""Shortest and longest hold, in memories of the network: long ones show gains, short
ones dynamics."""
STRETCH_HOLDS, LEAD_MEMORIES = 0.75, 5.0
"""Length of a stretch in longest holds, and what is run before and behind it in
memories."""
REFUSED_SHARE = 0.75
"""Share of stretches refused for limits of outputs from which that is told: there a
record that fills the space told more (`experiments/edge/README.md`)."""


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
        `gain` and `start` [s] of every stretch, its mean `index`; `known`, the
        information about directions of the coefficients that begin with a variance of
        one; `outside`, the share of samples outside of the domain; `refused`, the share
        of the stretches drawn that might have broken a limit of an output; `still`, the
        share of stretches in which limits leave nothing but to stay; `room` by output
        with a limit: the least distance of the predicted output from it. Status
        `stalled` where the test stays still for most of its time. `SpecError` where no
        operating point is allowed.

    Example:
        network = jnx.confidence.fit_domain(network, data)
        found = jnx.design.plan(network, duration=20, seed=1)
        print(found.detail, found.value.inputs.shape)
    """
    kept = limits_for(network, ranges, rates, forbidden, limits)

    def view(space, reference, lead, size):
        del size
        return network_view(network, space, reference, lead)

    return plan_by(network, view, kept, duration, hold, seed)


def plan_by(
    network: Network,
    make_view: MakeView,
    kept: PlanLimits,
    duration: float | int,
    hold: Pair | None,
    seed: int,
    rest: int = 0,
) -> Solution[TestPlan]:
    """The plan that tells most of what a view says is not known, behind so many samples
    at rest."""
    whole(seed, "seed", 0)
    length = round(positive(duration, "duration") / float(network.sample_time))
    held = _holds(network, hold)
    random = np.random.default_rng(seed)
    maker = _make(network, make_view, kept, random, length, held)
    u, steps, information = maker.run(length)
    u = _prepend_first(u, rest)
    return _solution(network, kept, maker, u, steps, rest, information[0])


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
    make_view: MakeView,
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
    reference = drawn[: max(1, 1000 // size)].reshape(-1, len(middle))
    return Maker(
        *(make_view(space, reference, lead, size), network, limits, space, known),
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


def _solution(
    network: Network,
    limits: PlanLimits,
    maker: Maker,
    u: Float[np.ndarray, "time inputs"],
    steps: list[Step],
    rest: int,
    known: Float[np.ndarray, "_ _"],
) -> Solution[TestPlan]:
    """The plan with what is to be told of it."""
    seen = Seen(
        *(
            np.asarray(a)
            for a in watch(
                maker.view, jax.device_put(_prepend_first(u, maker.lead)[None])
            )
        )
    )
    margin = margins(network, seen) if limits.bounds_outputs else np.zeros(seen.y.shape)
    y, margin, index = (a[0][maker.lead :] for a in (seen.y, margin, seen.far))
    names = tuple(network.output_names)
    value = TestPlan(_dataset(network, u, y), y, margin, index, names)
    gain, usual = (np.array([getattr(s, k) for s in steps]) for k in ("gain", "random"))
    room = limits.room(y, margin).min(axis=0)
    starts = rest + np.arange(len(steps)) * maker.size
    stats = {
        "information": float(gain.sum()),
        "known": known,
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


def _prepend_first(u: Float[np.ndarray, "time inputs"], samples: int) -> np.ndarray:
    return np.concatenate([np.repeat(u[:1], samples, axis=0), u])


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
