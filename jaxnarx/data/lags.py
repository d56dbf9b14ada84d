"""Lags to begin with, from the delays the data show."""

import dataclasses
from collections.abc import Callable

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.response import responses
from jaxnarx.errors import DataError

_LADDER = (0, 1, 2, 4, 8, 16, 32, 64)


@dataclasses.dataclass(frozen=True)
class LagSuggestion:
    """Lags in samples for a first pool of terms, and the delays they come from.

    `dead_time` and `settling` map (input, output) to samples, None where no linear
    response is seen.
    """

    input_lags: tuple[int, ...]
    output_lags: tuple[int, ...]
    dead_time: dict[tuple[str, str], int | None]
    settling: dict[tuple[str, str], int | None]
    sample_time: float

    def __str__(self) -> str:
        lines = [
            f"input lags {self.input_lags}, output lags {self.output_lags} "
            f"(samples of {self.sample_time:.6g} s)"
        ]
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


def suggest_lags(data: Dataset, *, max_lag: int = 64) -> LagSuggestion:
    """Input and output lags for `data`: 0, 1, 2, 4, 8, ... up to the settling time.

    The ladder covers the settling time of the median pair of channels (slower ones
    are left to feedback) and includes the delay after which each input first shows in
    any output, but never exceeds `max_lag` samples or a quarter of the longest record.
    Output lags are 1 and 2.
    """
    if not data.samples:
        raise DataError("suggest_lags needs at least one record with samples")
    top = max(1, min(max_lag, max(len(r) for r in data) // 4))
    found = responses(data, reach=max(100, max_lag))
    dead, settled = {}, {}
    for i, u in enumerate(data.channels.input_names):
        for o, y in enumerate(data.channels.output_names):
            dead[u, y] = found.dead_time(i, o)
            settled[u, y] = found.settling(i, o)
    known = sorted(s for s in settled.values() if s is not None)
    need = min(known[(len(known) - 1) // 2] if known else 1, top)
    below = [lag for lag in _LADDER if lag < need]
    above = [lag for lag in _LADDER if need <= lag <= top][:1] or [need]
    delays = {d for d in map(_delay(dead), data.channels.input_names) if d <= top}
    return LagSuggestion(
        tuple(sorted({0, 1, *below, *above, *delays})),
        (1, 2),
        dead,
        settled,
        data.sample_time,
    )


def _delay(dead) -> Callable[[str], int]:
    """The delay after which an input first shows in any output; 0 where in none."""
    return lambda name: min(
        (d for (u, _), d in dead.items() if u == name and d is not None), default=0
    )
