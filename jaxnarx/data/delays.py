"""Delays from every input to every output, by prewhitened cross-correlation."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data.dataset import Dataset, Record
from jaxnarx.data.response import responses
from jaxnarx.errors import DataError, SpecError


@dataclasses.dataclass(frozen=True)
class Delay:
    """From one input to one output: the first lag with a clear response.

    `samples` and `seconds` are None where nothing is clear. `correlation` is that at
    this lag, or the largest in magnitude where none is clear; its sign is that of the
    response.
    """

    input: str
    output: str
    samples: int | None
    seconds: float | None
    correlation: float


@dataclasses.dataclass(frozen=True)
class Delays:
    """A delay for every pair of channels.

    `bound` is the correlation that chance exceeds in one of 16,000 cases; `reach` the
    largest lag looked at, in samples of `sample_time` [s].
    """

    pairs: tuple[Delay, ...]
    bound: float
    reach: int
    sample_time: float

    def __getitem__(self, pair: tuple[str, str]) -> Delay:
        """The delay of (input, output)."""
        for delay in self.pairs:
            if (delay.input, delay.output) == pair:
                return delay
        known = "; ".join(f"{d.input}, {d.output}" for d in self.pairs)
        raise SpecError(
            f"there is no pair {pair!r}. Known pairs: {known}", field="pair"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain types for JSON."""
        return dataclasses.asdict(self) | {
            "pairs": [dataclasses.asdict(d) for d in self.pairs]
        }

    def __str__(self) -> str:
        """A table with a line per pair."""
        width = max((len(f"{d.input} -> {d.output}") for d in self.pairs), default=0)
        lines = [f"{'':{width}s}  samples  seconds  correlation"]
        for d in self.pairs:
            clear = d.samples is not None
            when = f"{d.samples:7d}  {d.seconds:7.4g}" if clear else f"{'unclear':>16s}"
            lines.append(
                f"{f'{d.input} -> {d.output}':{width}s}  {when}  {d.correlation:11.3f}"
            )
        lines.append(f"chance stays below {self.bound:.3f}; lags up to {self.reach}")
        return "\n".join(lines)


def delays(data: Dataset, *, reach: int = 100) -> Delays:
    """Delays that the data show, up to `reach` samples.

    `reach` is cut to a third of the longest record. Input and output are filtered by
    what makes the input white, and correlated; the delay is the first lag above four
    standard deviations of chance and above a fifth of the largest. What answers slowly
    or not linearly may show later than it acts, or not at all. Masked samples count
    with the value they are held at.

    Box and Jenkins 1970, section 11.2.
    """
    if reach < 1:
        raise SpecError(f"reach must be at least 1 sample, got {reach}", field="reach")
    if not data.samples:
        raise DataError("delays needs at least one record with samples")
    eased = tuple(_eased(r) for r in data if len(r))
    found = responses(dataclasses.replace(data, records=eased), reach=reach)
    pairs = [
        _delay(found, data, i, o)
        for i in range(len(data.channels.inputs))
        for o in range(len(data.channels.outputs))
    ]
    return Delays(tuple(pairs), float(found.bound), found.reach, data.sample_time)


def _eased(record: Record) -> Record:
    """The record's deviations from its mean, faded in and out over a tenth each.

    A record that ends elsewhere than at its mean would be cut off by a jump, of inputs
    and outputs at the same instant, and the whitening filter makes jumps large: a
    random walk would show a delay of zero.
    """
    n = len(record)
    edge = np.minimum(np.arange(n) + 0.5, n - 0.5 - np.arange(n)) / max(0.1 * n, 1.0)
    weight = np.sin(0.5 * np.pi * np.minimum(edge, 1.0)) ** 2

    def ease(x: Float[np.ndarray, "time channels"]) -> np.ndarray:
        x = x.astype(np.float64)
        mean = weight @ x / weight.sum()
        return weight[:, None] * (x - mean[None])

    return dataclasses.replace(record, u=ease(record.u), y=ease(record.y))


def _delay(found, data: Dataset, i: int, o: int) -> Delay:
    samples, forward = found.dead_time(i, o), found.forward(i, o)
    at = int(np.argmax(np.abs(forward))) if samples is None else samples
    return Delay(
        data.channels.input_names[i],
        data.channels.output_names[o],
        samples,
        None if samples is None else samples * data.sample_time,
        float(forward[at]),
    )
