"""Steps fitted one after another to training data, and what they did to records."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from jaxnarx.checks import require_known
from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.check_samples import spans
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.preparation.codec import decode, decode_fields, decode_step
from jaxnarx.data.preparation.crank_angle import AtCrankAngle, ToTime
from jaxnarx.data.preparation.levels import OffsetRemoved, Scaled
from jaxnarx.data.preparation.step import AbstractFitted, AbstractStep
from jaxnarx.data.record import Record
from jaxnarx.data.sampling import positive_sample_time
from jaxnarx.data.units import same_unit
from jaxnarx.deprecation import old_method
from jaxnarx.errors import SpecError
from jaxnarx.formatting import page


@dataclasses.dataclass(frozen=True)
class Change:
    """The change that one step made to one record.

    `step` is the step's place in the preparation, from 0. `masked` counts by channel
    the samples that became invalid, or, where the raster changed, all that are invalid
    now; channels without any are left out. `rows` names the spans (first, last) of such
    samples as the record's source counts rows, cut at 20, where the raster stayed.
    """

    step: int
    record: str
    before: int
    after: int
    masked: Mapping[str, int]
    rows: Mapping[str, tuple[tuple[int, int], ...]]


@dataclasses.dataclass(frozen=True)
class Changes:
    """The changes that every step made to every record; `steps` are their
    descriptions."""

    steps: tuple[str, ...] = ()
    items: tuple[Change, ...] = ()

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Change]:
        return iter(self.items)

    def of(self, step: int) -> tuple[Change, ...]:
        """The changes of one step."""
        return tuple(c for c in self.items if c.step == step)

    def count_masked(self, step: int) -> dict[str, int]:
        """Samples that a step masked, by channel, over all records."""
        out: dict[str, int] = {}
        for change in self.of(step):
            for name, n in change.masked.items():
                out[name] = out.get(name, 0) + n
        return out

    masked = old_method("masked", "count_masked")

    def to_dict(self) -> dict[str, Any]:
        """Plain types for JSON."""
        items = [
            dataclasses.asdict(c)
            | {"masked": dict(c.masked)}
            | {"rows": {k: [list(r) for r in v] for k, v in c.rows.items()}}
            for c in self.items
        ]
        return {"steps": list(self.steps), "items": items}

    def __str__(self) -> str:
        """Every step, and under it the samples left and masked."""
        lines = []
        for n, step in enumerate(self.steps):
            lines.append(f"{n + 1}. {step}")
            lines += [f"   {text}" for text in self._summary(n)]
        return "\n".join(lines) or "nothing was done"

    _repr_html_ = page

    def _summary(self, step: int) -> Iterator[str]:
        own = self.of(step)
        before, after = sum(c.before for c in own), sum(c.after for c in own)
        if after < before:
            yield f"{after} of {before} samples left in {len(own)} record(s)"
        if after > before:
            yield (
                f"warning: up-sampled from {before} to {after} samples in {len(own)} "
                "record(s). Those between are interpolated and tell nothing new: "
                "errors one step ahead look smaller than they are"
            )
        for name, n in self.count_masked(step).items():
            share = 100 * n / max(after, 1)
            records = sum(name in c.masked for c in own)
            yield f"{name}: {n} masked ({share:.2g} %) in {records} record(s)"


def changes(before: Dataset, after: Dataset, *, step: int) -> tuple[Change, ...]:
    """The changes of a step, from the data before and after it."""
    same = before.sample_time == after.sample_time
    return tuple(
        _change(a, b, after.channels.names, step, same)
        for a, b in zip(before, after, strict=True)
    )


def _change(a: Record, b: Record, names: list[str], step: int, same: bool) -> Change:
    same = same and len(a) == len(b)
    lost = ~b.valid & (a.valid if same else True)
    counts = {n: int(lost[:, j].sum()) for j, n in enumerate(names)}
    found = {n: k for n, k in counts.items() if k}
    rows = {n: _spans(b, lost[:, names.index(n)]) for n in found} if same else {}
    return Change(step, a.name, len(a), len(b), found, rows)


def _spans(record: Record, lost) -> tuple[tuple[int, int], ...]:
    """Spans of rows, as the record's source counts them."""
    edge = np.diff(np.concatenate([[0], lost.astype(np.int64), [0]]))
    pairs = np.stack([np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)], axis=1)
    return spans(record, pairs)


FORMAT_VERSION = 1


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
        """Prepare as `apply` does, and tells what was done to every record."""
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

    def prepend(self, first: "Preparation") -> "Preparation":
        """One preparation for raw data: `first`, then this one."""
        return Preparation(
            (*first.steps, *self.steps), first.channels, first.sample_time, self.report
        )

    after = old_method("after", "prepend")

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
            "format": FORMAT_VERSION,
            "sample_time": self.sample_time,
            "inputs": [[c.name, c.unit] for c in self.channels.inputs],
            "outputs": [[c.name, c.unit] for c in self.channels.outputs],
            "steps": [step.to_dict() for step in self.steps],
        }

    @classmethod
    def from_dict(cls, table: Any) -> "Preparation":
        """Read what `to_dict` wrote, from JSON; anything else is a SpecError."""
        table = decode(table, dict[str, Any], "preparation")
        version = table.get("format")
        if version != FORMAT_VERSION:
            raise SpecError(
                f"the preparation has format {version!r}; this program reads "
                f"{FORMAT_VERSION}",
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
            require_known(
                channel.name,
                known,
                channel.name,
                f"the preparation does not know the channel {channel.name!r}",
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
