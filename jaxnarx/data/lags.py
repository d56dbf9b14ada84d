"""Lags and time constants to begin with, from the answers that the data show."""

import dataclasses
from collections.abc import Collection

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require_known
from jaxnarx.data._dynamics import dynamics
from jaxnarx.data.dataset import Dataset
from jaxnarx.errors import DataError
from jaxnarx.formatting import page


def step_times(data: Dataset, output: str) -> dict[str, float]:
    """Seconds that `output` takes for 63 % of its answer to a step of each input.

    The time is that of the system of low order that best explains the output in free
    run (`dynamics`), from the end of the dead time: for a first-order lag its time
    constant. Responses that change sign are counted by magnitude. Inputs without a
    clear response are left out.
    """
    known = data.channels.output_names
    require_known(output, known, "output")
    if not data.samples:
        raise DataError("step times need at least one record with samples")
    found, o = dynamics(data), known.index(output)
    answers = {name: found[i, o] for i, name in enumerate(data.channels.input_names)}
    return {
        name: float(a.rise * data.sample_time)
        for name, a in answers.items()
        if a is not None and a.clear
    }


def bank_times(
    rise_times: Collection[float], count: int, *, sample_time: float
) -> list[float]:
    """Time constants [s] of a bank of lags for answers of `rise_times` [s].

    A geometric series from half the shortest, but not less than the sample time, to
    twice the longest; one alone is the mean of both.
    """
    shortest = max(min(rise_times), sample_time)
    longest = max(*rise_times, shortest)
    if count == 1:
        return [float(np.sqrt(shortest * longest))]
    first = max(shortest / 2, sample_time)
    return np.geomspace(first, 2 * longest, count).tolist()


_LAG_LADDER = (0, 1, 2, 4, 8, 16, 32, 64)

_USUAL_MEMORY = 16
"""Memory [samples] to begin with where none is seen: that of `identify`."""

_MOST_FILTERS = 3


@dataclasses.dataclass(frozen=True)
class LagSuggestion:
    """Lags in samples for a first pool of terms, and the delays they come from.

    `dead_time` and `settling` map (input, output) to samples, None where no linear
    response is seen. `filters` are time constants [s] of first-order lags through which
    the inputs should enter as well, where the memory is longer than lags should be.
    """

    input_lags: tuple[int, ...]
    output_lags: tuple[int, ...]
    dead_time: dict[tuple[str, str], int | None]
    settling: dict[tuple[str, str], int | None]
    sample_time: float
    filters: tuple[float, ...] = ()

    def __str__(self) -> str:
        lines = [
            f"input lags {self.input_lags}, output lags {self.output_lags} "
            f"(samples of {self.sample_time:.6g} s)"
        ]
        if self.filters:
            lines.append(
                "the memory is longer: filters of "
                f"{', '.join(f'{t:g}' for t in self.filters)} s as well"
            )
        for pair, delay in self.dead_time.items():
            what = "no linear response seen"
            if delay is not None:
                settled = (self.settling[pair] or 0) * self.sample_time
                what = (
                    f"dead time {delay * self.sample_time:.6g} s, "
                    f"settled after {settled:.6g} s"
                )
            lines.append(f"  {pair[0]} -> {pair[1]}: {what}")
        return "\n".join(lines)

    _repr_html_ = page


@guard_arguments
def suggest_lags(data: Dataset, *, max_lag: int = 64) -> LagSuggestion:
    """Input and output lags for `data`: 0, 1, 2, 4, 8, ... up to the settling time.

    The ladder covers the longest settling time that is seen, and where none is, 16
    samples; what settles later gets filters. It includes the delay after which each
    input first shows in any output. Output lags are 1 and 2.

    Args:
        data: The records.
        max_lag: The longest lag [samples]; a quarter of the longest record is never
            exceeded either.

    Returns:
        `input_lags` and `output_lags` for a pool, time constants of `filters`, and the
        delays they come from.

    Example:
        print(jnx.data.suggest_lags(data))
    """
    if not data.samples:
        raise DataError("suggest_lags needs at least one record with samples")
    top = max(1, min(max_lag, max(len(r) for r in data) // 4))
    found = dynamics(data)
    dead, settled, slow = {}, {}, []
    for i, u in enumerate(data.channels.input_names):
        for o, y in enumerate(data.channels.output_names):
            answer = found[i, o]
            dead[u, y] = None if answer is None else answer.dead_time
            settled[u, y] = None if answer is None else answer.settling
            if answer is not None and (answer.settling or 0) > max_lag:
                slow.append(answer.rise * data.sample_time)
    need = min(
        max((s for s in settled.values() if s is not None), default=_USUAL_MEMORY), top
    )
    below = [lag for lag in _LAG_LADDER if lag < need]
    above = [lag for lag in _LAG_LADDER if need <= lag <= top][:1] or [need]
    delays = [_delay(dead, u) for u in data.channels.input_names]
    bank = bank_times(slow, _MOST_FILTERS, sample_time=data.sample_time) if slow else []
    return LagSuggestion(
        tuple(sorted({0, 1, *below, *above, *delays})),
        (1, 2),
        dead,
        settled,
        data.sample_time,
        tuple(float(f"{t:.2g}") for t in bank),
    )


def _delay(dead: dict[tuple[str, str], int | None], name: str) -> int:
    """The delay after which an input first shows in any output; 0 where in none."""
    return min(
        (d for (u, _), d in dead.items() if u == name and d is not None), default=0
    )
