"""Several steps, fitted one after another on training data and kept together."""

import dataclasses
from collections.abc import Iterable
from typing import Any

from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.match import same_unit
from jaxnarx.data.preparation.changes import Change, Changes, changes
from jaxnarx.data.preparation.codec import decode, decode_fields, decode_step
from jaxnarx.data.preparation.crank_angle import AtCrankAngle, ToTime
from jaxnarx.data.preparation.offset import OffsetRemoved
from jaxnarx.data.preparation.scale import Scaled
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep
from jaxnarx.data.sampling import positive_sample_time
from jaxnarx.errors import SpecError, suggest

FORMAT = 1


@dataclasses.dataclass(frozen=True)
class Preparation:
    """Fitted steps in order, and the raw data they are for.

    `channels` and `sample_time` [s] are those of the training data as measured;
    `report` says what became of its records.
    """

    steps: tuple[AbstractFitted, ...]
    channels: Channels
    sample_time: float
    report: Changes = dataclasses.field(default=Changes(), compare=False)

    def apply(self, data: Dataset) -> Dataset:
        """New measurements, prepared as the training data were.

        `data` may lack channels that no step needs. A channel that the training data
        did not have, another unit or another sample time is a SpecError.
        """
        return self.apply_reported(data)[0]

    def apply_reported(self, data: Dataset) -> tuple[Dataset, Changes]:
        """As `apply`, with what was done to every record."""
        self._require_alike(data)
        found: list[Change] = []
        for n, step in enumerate(self.steps):
            after = step.apply(data)
            found += changes(data, after, step=n)
            data = after
        return data, Changes(tuple(s.describe() for s in self.steps), tuple(found))

    def undo(self, data: Dataset) -> Dataset:
        """Raw data from prepared ones; SpecError where a step cannot be undone."""
        for step in reversed(self.steps):
            data = step.undo(data)
        return data

    def physical(self, data: Dataset) -> Dataset:
        """Prepared data with scaling and offset removal undone, and nothing else.

        Filtered, masked and resampled data stay so, but in their physical units.
        """
        for step in reversed(self.steps):
            data = step.undo(data) if isinstance(step, Scaled | OffsetRemoved) else data
        return data

    def after(self, first: "Preparation") -> "Preparation":
        """One preparation for raw data: `first`, then this one."""
        return Preparation(
            (*first.steps, *self.steps), first.channels, first.sample_time, self.report
        )

    @property
    def needs(self) -> tuple[str, ...]:
        """Channels that new data must have whatever else they lack."""
        speeds = [s.speed for s in self.steps if isinstance(s, ToTime | AtCrankAngle)]
        return tuple(dict.fromkeys(speeds))

    def describe(self) -> str:
        """Every step on a line of its own."""
        lines = [f"{n + 1}. {step.describe()}" for n, step in enumerate(self.steps)]
        return "\n".join(lines) or "no preparation"

    def to_dict(self) -> dict[str, Any]:
        """Plain types for JSON; the report is not part of it."""
        return {
            "format": FORMAT,
            "sample_time": self.sample_time,
            "inputs": [[c.name, c.unit] for c in self.channels.inputs],
            "outputs": [[c.name, c.unit] for c in self.channels.outputs],
            "steps": [step.to_dict() for step in self.steps],
        }

    @classmethod
    def from_dict(cls, table: Any) -> "Preparation":
        """What `to_dict` wrote, from JSON; anything else is a SpecError."""
        table = decode(table, dict[str, Any], "preparation")
        version = table.get("format")
        if version != FORMAT:
            raise SpecError(
                f"the preparation has format {version!r}; this program reads {FORMAT}",
                field="format",
            )
        parts = _Parts(**decode_fields(table, _Parts, "preparation"))
        channels = Channels(
            tuple(Channel(*c) for c in parts.inputs),
            tuple(Channel(*c) for c in parts.outputs),
        )
        steps = tuple(decode_step(s) for s in parts.steps)
        return cls(steps, channels, positive_sample_time(parts.sample_time))

    def _require_alike(self, data: Dataset) -> None:
        expected = self.sample_time
        if abs(data.sample_time - expected) > 1e-6 * expected:
            raise SpecError(
                f"the preparation is for samples of {expected:g} s, the data have "
                f"{data.sample_time:g} s. Resample the data first, or fit a "
                "preparation to them.",
                field="sample_time",
            )
        known = {c.name: c.unit for c in self.channels.all}
        for channel in data.channels.all:
            if channel.name not in known:
                raise SpecError(
                    f"the preparation does not know the channel {channel.name!r}. "
                    f"{suggest(channel.name, known)}",
                    field=channel.name,
                )
            unit = known[channel.name]
            if unit and channel.unit and not same_unit(unit, channel.unit):
                raise SpecError(
                    f"{channel.name} is in {channel.unit!r}, but the preparation is "
                    f"for {unit!r}. Convert the data first; data that are prepared "
                    "already need no preparation.",
                    field=channel.name,
                )


@dataclasses.dataclass(frozen=True)
class _Parts:
    """`Preparation.to_dict`, key by key."""

    format: int
    sample_time: float
    inputs: tuple[tuple[str, str], ...]
    outputs: tuple[tuple[str, str], ...]
    steps: tuple[Any, ...]


def prepare(
    data: Dataset, steps: Iterable[AbstractStep]
) -> tuple[Dataset, Preparation]:
    """Fit `steps` one after another to training data; the data prepared, and how.

    Every step is fitted to what the steps before it left. Give training records only,
    and prepare the others with `Preparation.apply`: a test record that has a say in the
    scaling is no test.
    """
    raw, fitted, found = data, [], []
    for n, step in enumerate(steps):
        if not isinstance(step, AbstractStep):
            raise SpecError(
                f"step {n + 1} is {step!r}; expected settings such as "
                "Scale(kind='min-max')",
                field="steps",
            )
        fitted.append(step.fit(data))
        after = fitted[-1].apply(data)
        found += changes(data, after, step=n)
        data = after
    report = Changes(tuple(s.describe() for s in fitted), tuple(found))
    return data, Preparation(tuple(fitted), raw.channels, raw.sample_time, report)
