"""Random stretches of a test, from where it has come to."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.excitation import AprbsPlan, render

Allows = Callable[[Float[np.ndarray, "*rows inputs"]], Bool[np.ndarray, "*rows"]]
"""Tells whether levels of all inputs are allowed together."""


def all_combinations(u: Float[np.ndarray, "*rows inputs"]) -> Bool[np.ndarray, "*rows"]:
    """All combinations."""
    return np.ones(u.shape[:-1], bool)


MAX_REDRAWS = 20
"""Times that levels which are not allowed are drawn anew."""


@dataclasses.dataclass(frozen=True, eq=False)
class Space:
    """The space of inputs: ranges, slopes by sample, which have two levels alone, and
    which combinations are allowed."""

    low: Float[np.ndarray, " inputs"]
    high: Float[np.ndarray, " inputs"]
    rate: Float[np.ndarray, " inputs"]
    binary: Bool[np.ndarray, " inputs"]
    allows: Allows = all_combinations

    def points(
        self, random: np.random.Generator, *shape: int
    ) -> Float[np.ndarray, "*shape inputs"]:
        """Levels alike everywhere: more of them near the ends, where a polynomial is
        determined worst, served local models worse (`experiments/edge/plans.py`).
        Combinations that are not allowed are drawn again, some times."""
        share = self._draw(random, shape)
        for _ in range(MAX_REDRAWS):
            bad = ~self.allows(share)
            if not bad.any():
                break
            share = np.where(bad[..., None], self._draw(random, shape), share)
        return share

    def _draw(
        self, random: np.random.Generator, shape: tuple[int, ...]
    ) -> Float[np.ndarray, "*shape inputs"]:
        share = random.uniform(size=(*shape, len(self.low)))
        share = np.where(self.binary, np.round(share), share)
        return np.clip(self.low + share * (self.high - self.low), self.low, self.high)


def stretches(
    random: np.random.Generator,
    space: Space,
    begin: Float[np.ndarray, " inputs"],
    count: int,
    length: int,
    hold: tuple[int, int],
    *,
    near: int = 0,
) -> Float[np.ndarray, "tests time inputs"]:
    """`count` tests of `length` samples behind the sample `begin`; the first of them
    stays there, and the last `near` of them do not go all the way.

    Holds, from the shortest to the longest of `hold` [samples], are as many in every
    octave; a test begins in the midst of the first of them. In every second test all
    inputs share them, so that the levels they are drawn at come together; in the others
    each input has its own. Rates hold, at the joint too.
    """
    shortest, longest = hold
    shape = count, 2 + -(-length // shortest), len(begin)
    held = np.exp(random.uniform(np.log(shortest), np.log(longest + 1), shape))
    held = np.maximum(held.astype(int), 1)
    held[::2] = held[::2, :, :1]
    part = random.uniform(size=shape[::2])
    part[::2] = part[::2, :1]
    held[:, 0] = np.ceil(part * held[:, 0])
    level = space.points(random, *shape[:2])
    way = np.ones(count)
    way[count - near :] = random.uniform(size=near)
    part = np.where(space.binary[None], 1.0, way[:, None])[:, None]
    level = np.where(part < 1.0, begin + part * (level - begin), level)
    level[:, 0] = level[0] = begin
    # One sample more: the plan begins with the last of what is there.
    leaves = level, held, space.low, space.high, space.rate
    level, held, low, high, rate = jax.device_put(leaves)
    return np.array(_render(level, held, low, high, rate, length + 1))[:, 1:]


@eqx.filter_jit
def _render(
    level: Float[Array, "tests segments inputs"],
    hold: Int[Array, "tests segments inputs"],
    low: Float[Array, " inputs"],
    high: Float[Array, " inputs"],
    rate: Float[Array, " inputs"],
    length: int,
) -> Float[Array, "tests time inputs"]:
    names = tuple(map(str, range(low.size)))

    def one(level, hold):
        return render(AprbsPlan(level, hold, rate, low, high, length, names))

    return jax.vmap(one)(level, hold)
