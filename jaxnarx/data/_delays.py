"""Delays from every input to every output."""

import dataclasses
from typing import Any

from jaxnarx.checks import whole
from jaxnarx.data._dynamics import Answer, dynamics
from jaxnarx.data.dataset import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.formatting import page


@dataclasses.dataclass(frozen=True)
class Delay:
    """The dead time of the response of one output to one input.

    `samples` and `seconds` are None where nothing is clear. `correlation` is that of
    the fitted response with what other inputs leave of the output; its sign is that of
    the static gain.
    """

    input: str
    output: str
    samples: int | None
    seconds: float | None
    correlation: float


@dataclasses.dataclass(frozen=True)
class Delays:
    """Delays between every pair of an input and an output.

    `reach` is the largest dead time looked at, in samples of `sample_time` [s].
    """

    pairs: tuple[Delay, ...]
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
        lines.append(f"dead times up to {self.reach} samples were looked at")
        return "\n".join(lines)

    _repr_html_ = page


def delays(data: Dataset, *, reach: int = 100) -> Delays:
    """Delays that the data show, up to `reach` samples.

    `reach` is cut to a quarter of the usual length of the records. The delay is the
    dead time of the system of low order that best explains the output in free run
    beside those of the other inputs (`dynamics`). The delay of an input that acts
    nonlinearly may come out too long, or not at all. Masked samples count with the
    value they are held at.
    """
    whole(reach, "reach")
    if not data.samples:
        raise DataError("delays needs at least one record with samples")
    found = dynamics(data, reach=reach)
    pairs = [
        _delay(data, u, y, found[i, o])
        for i, u in enumerate(data.channels.input_names)
        for o, y in enumerate(data.channels.output_names)
    ]
    return Delays(tuple(pairs), found.reach, data.sample_time)


def _delay(data: Dataset, u: str, y: str, answer: Answer | None) -> Delay:
    samples = None if answer is None else answer.dead_time
    return Delay(
        u,
        y,
        samples,
        None if samples is None else samples * data.sample_time,
        0.0 if answer is None else answer.correlation,
    )
