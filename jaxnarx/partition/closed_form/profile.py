"""Facts of the data before anything is fitted: levels, dead times, memory."""

import dataclasses

import numpy as np

from jaxnarx.data import Dataset, dynamics, input_levels, usual_length
from jaxnarx.errors import DataError

COUNTED_SAMPLES = 20_000
"""Samples that judge; of longer data every k-th one counts."""
SHORTEST_REACHES = 15
"""Length of the records, in reaches of the lags."""


HISTORY_SAMPLES = 12
"""Samples of history that some candidate needs, however short the records are: hidden
states are estimated from ten, behind a lag or two."""


@dataclasses.dataclass(frozen=True)
class DataProfile:
    """Facts about one output and its inputs."""

    output: str
    levels: tuple[tuple[float, ...] | None, ...]
    """Values of inputs that take few, sorted; None for the others."""
    dead_time: tuple[int, ...]
    """Samples before the output answers, by input; 0 where no answer is clear."""
    rise: float
    """Samples in which the quickest clear answer has covered 63 % of its way."""
    memory: int
    """Samples until the slowest clear answer is over."""
    reach: int
    """Samples that lags may reach back: records and blocks keep most of theirs."""
    every: int
    """Every so many samples one counts."""
    begin: int = 0
    """Samples at the begin of every record that judge no candidate: all of a search are
    compared on the same samples, whatever history they need."""
    skewness: float = 0.0
    """Third moment of the output over the cube of its standard deviation."""

    def to_dict(self, inputs: list[str]) -> dict:
        """The facts as plain values, for people."""
        binary = [n for n, own in zip(inputs, self.levels, strict=True) if own]
        return {
            "dead_time": dict(zip(inputs, self.dead_time, strict=True)),
            "rise": round(self.rise, 1),
            "memory": self.memory,
            "few_levels": binary,
            "every": self.every,
        }


def profile_data(data: Dataset, output: str) -> DataProfile:
    """Facts about one output; a few seconds for a million rows."""
    _require_seen(data)
    o = data.channels.output_names.index(output)
    inputs = len(data.channels.inputs)
    found = dynamics(data)
    pairs = [found[i, o] for i in range(inputs)]
    clear = [p for p in pairs if p is not None and p.clear]
    longest = max(len(r) for r in data)
    memory = max((p.settling or 0 for p in clear), default=longest // 20)
    dead = [0 if p is None or not p.clear else int(p.dead_time or 0) for p in pairs]
    usual = usual_length(map(len, data))
    reach = usual // SHORTEST_REACHES
    return DataProfile(
        output,
        tuple(input_levels(data, i) for i in range(inputs)),
        tuple(dead),
        float(min((p.rise for p in clear), default=1.0)),
        int(min(max(memory, 4), longest // 4)),
        reach,
        max(1, data.samples // COUNTED_SAMPLES),
        min(max(max(dead) + reach, HISTORY_SAMPLES), usual // 4),
        _skewness(data, inputs + o),
    )


def _skewness(data: Dataset, place: int) -> float:
    """The skewness of a channel where it is valid; zero of a constant."""
    o = place - len(data.channels.inputs)
    y = np.concatenate([r.y[r.valid[:, place], o] for r in data])
    size = float(np.abs(y).max(initial=0.0))
    far = (y - y.mean()) / size if size > 0 else y
    spread = float(far.std())
    return float(np.mean((far / spread) ** 3)) if spread > 1e-12 else 0.0


def _require_seen(data: Dataset) -> None:
    """DataError where there is no input, or a channel that is measured nowhere."""
    if not data.channels.inputs:
        raise DataError("there are no inputs: a search needs at least one")
    seen = np.any([r.valid.any(axis=0) for r in data], axis=0)
    for name, there in zip(data.channels.names, seen.tolist(), strict=True):
        if not there:
            raise DataError(f"{name} is measured nowhere; leave it out")
