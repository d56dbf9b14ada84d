"""Pools without feedback for the closed form: lags and filters in one scale."""

import dataclasses
import itertools

import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.formatting import page
from jaxnarx.partition.closed_form.profile import DataProfile
from jaxnarx.regressors import (
    LowPass,
    Pool,
    Variables,
    polynomial_pool,
)

LAG_STEPS = (0, 1, 2, 3, 4, 6, 8)
"""Lags behind the dead time, in steps."""
RECENT_LAG_STEPS = (0, 1, 2)
"""Lags that every input has, in steps, however late it seems to act."""
FEWEST_FILTERS = 4
"""Filters at least: slow parts of an answer are small and easily overlooked."""
FIRST_TIME_CONSTANT, TIME_CONSTANT_FACTOR = 2.5, 4.0
"""Shortest time constant of first-order lags of the inputs, in steps, and the factor
from one to the next."""


@dataclasses.dataclass(frozen=True)
class Memory:
    """The memory of inputs: lags in multiples of `step` samples, and filters."""

    step: int
    lags: tuple[int, ...] = LAG_STEPS
    times: tuple[float, ...] = ()
    """Time constants of filters in steps."""

    @classmethod
    def of(
        cls, step: int, reach: int, memory: int, longest: float = np.inf
    ) -> "Memory":
        """The usual lags, as far as the reach, and filters until a response as long as
        the memory is over behind the slowest [samples]; none slower than `longest`."""
        lags = tuple(lag for lag in LAG_STEPS if lag * step <= max(reach, 2))
        times = [
            FIRST_TIME_CONSTANT * TIME_CONSTANT_FACTOR**k for k in range(FEWEST_FILTERS)
        ]
        while 3 * times[-1] * step < memory:
            times.append(TIME_CONSTANT_FACTOR * times[-1])
        return cls(step, lags, tuple(t for t in times if t * step <= longest))

    def lags_behind(self, dead_time: int) -> list[int]:
        """Lags from one step before the dead time on."""
        begin = max(dead_time - self.step, 0)
        return [begin + self.step * lag for lag in self.lags]

    def choose_lags(self, dead_time: int) -> list[int]:
        """Lags of an input: those behind the dead time, and recent ones, for the dead
        time is an estimate."""
        behind = self.lags_behind(dead_time)
        recent = [
            self.step * lag for lag in RECENT_LAG_STEPS if self.step * lag < behind[0]
        ]
        return recent + behind

    def filters(self, data: Dataset) -> list[LowPass]:
        """The filters that records are long enough for."""
        longest = max(len(r) for r in data) * data.sample_time / 4
        times = [t * self.step * data.sample_time for t in self.times]
        return [LowPass(float(f"{t:.3g}")) for t in times if t <= longest]

    def __str__(self) -> str:
        filters = f", {len(self.times)} filters" if self.times else ""
        return f"lags by {self.step}{filters}"

    _repr_html_ = page


def linear_pool(data: Dataset, profile: DataProfile, memory: Memory) -> Pool:
    """A constant, and every input at the lags and through the filters."""
    names = data.channels.input_names
    return polynomial_pool(
        data.channels,
        outputs=[profile.output],
        input_lags={
            n: memory.choose_lags(d)
            for n, d in zip(names, profile.dead_time, strict=True)
        },
        output_lags=(),
        degree=1,
        filters=memory.filters(data),
    )


def product_pool(
    linear: Pool, profile: DataProfile, memory: Memory, degree: int
) -> Pool:
    """Add products of inputs that have many levels, at two lags behind the dead time,
    and at two recent ones where a dead time is long.

    Products stay within one lag: inputs of engines move slowly, and products of
    neighbours are neighbours of products.
    """
    rows = {
        tuple(sorted(r))
        for r in np.pad(linear.factor, ((0, 0), (0, degree - 1))).tolist()
    }
    for dead, place in itertools.product(_dead_times(profile, memory), (1, 2)):
        free = _variables_at_lag(linear, profile, memory, place, dead)
        for size in range(2, degree + 1):
            rows |= {(0,) * (degree - size) + r for r in _products(free, size)}
    factor = np.array(sorted(rows, key=lambda r: (np.count_nonzero(r), r)), np.int32)
    return Pool(linear.variables, factor, linear.channels, linear.outputs)


def _products(free: list[int], size: int) -> set[tuple[int, ...]]:
    if size == 0:
        return {()}
    return {
        (*r, v) for r in _products(free, size - 1) for v in free if not r or v >= r[-1]
    }


def _dead_times(profile: DataProfile, memory: Memory) -> list[tuple[int, ...]]:
    """The dead times that were seen, and those without the long ones, which may be
    wrong."""
    long = (max(RECENT_LAG_STEPS) + 1) * memory.step
    recent = tuple(0 if d > long else d for d in profile.dead_time)
    return list(dict.fromkeys((profile.dead_time, recent)))


def _variables_at_lag(
    linear: Pool,
    profile: DataProfile,
    memory: Memory,
    place: int,
    dead: tuple[int, ...],
) -> list[int]:
    """Variables of inputs with many levels at their lag number `place`."""
    out = []
    for n, (signal, lag, filter_) in enumerate(linear.variables.entries, 1):
        lags = memory.lags_behind(dead[signal])
        own = filter_ is None and lag == lags[min(place, len(lags) - 1)]
        if own and profile.levels[signal] is None:
            out.append(n)
    return out


def choose_scheduling(data: Dataset, profile: DataProfile, memory: Memory) -> Variables:
    """Every input two steps behind the dead time; few inputs through a filter too."""
    rows = []
    for signal, dead in enumerate(profile.dead_time):
        lags = memory.lags_behind(dead)
        rows.append((signal, lags[min(2, len(lags) - 1)], None))
    many = [s for s, own in enumerate(profile.levels) if own is None]
    if len(many) <= 2:
        slow = memory.filters(data)[1:3]
        rows += [(s, 0, f) for s in many for f in slow]
    return Variables.of(rows)
