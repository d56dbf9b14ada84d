"""Fleets: many engines with the same channels, padded and masked into stacked arrays.

Host memory only, so that a fleet can be pickled to workers and hashed.
"""

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.data.align_channels import match_channels
from jaxnarx.data.channels import Channels
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.record import Record
from jaxnarx.deprecation import old_method
from jaxnarx.errors import DataError, SpecError, suggest
from jaxnarx.formatting import align_columns, brief, page, some

Choice = slice | int | str | Sequence[int | str]
"""Choice of the records of every engine that belong to a part: by position or by
name."""

FLEET_PARTS = ("train", "validation", "test")


@dataclasses.dataclass(frozen=True, eq=False)
class Padded:
    """One part of all members: records in physical units, padded with their last row.

    `valid` is False for missing samples and for padding; `length` is zero for records
    that a member does not have; `names` are the names of the records.
    """

    signals: Float[np.ndarray, "members records time signals"]
    valid: Bool[np.ndarray, "members records time signals"]
    length: Int[np.ndarray, "members records"]
    names: tuple[tuple[str, ...], ...]

    def pick(self, indices: Sequence[int]) -> "Padded":
        """The part of some members."""
        at = np.asarray(indices, int)
        names = tuple(self.names[n] for n in at.tolist())
        return Padded(self.signals[at], self.valid[at], self.length[at], names)

    def widen(self, records: int, time: int) -> "Padded":
        """The part with room for more records, and longer ones."""
        more_records = records - self.signals.shape[1]
        more_time = time - self.signals.shape[2]
        wide = ((0, 0), (0, more_records), (0, 0), (0, 0))
        long = ((0, 0), (0, 0), (0, more_time), (0, 0))
        return Padded(
            np.pad(np.pad(self.signals, long, mode="edge"), wide),
            np.pad(np.pad(self.valid, long), wide),
            np.pad(self.length, wide[:2]),
            self.names,
        )

    widened = old_method("widened", "widen")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Fleet:
    """Engines, by name, with records to train on, to judge by and to test with.

    `status` is `"ok"`, or the name of what is wrong with a member's data, `detail` says
    it for people: such a member is a row of a sweep like any other.
    """

    names: tuple[str, ...]
    channels: Channels
    sample_time: float
    train: Padded
    validation: Padded | None
    test: Padded | None
    status: tuple[str, ...]
    detail: tuple[str, ...]

    def __str__(self) -> str:
        """Members with their samples by part, and what is wrong with them."""
        step = float(self.sample_time)
        head = f"Fleet: {len(self)} members at {step:g} s\n{self.channels}"
        rows = [("member", *self.parts, "status")]
        for n, name in enumerate(self.names):
            samples = [str(int(p.length[n].sum())) for p in self.parts.values()]
            wrong = f"{self.status[n]} {self.detail[n]}".strip()
            rows.append((name, *samples, wrong))
        left = [True, *(False,) * len(self.parts), True]
        return "\n".join([head, *some(align_columns(rows, left), 24)])

    __repr__, _repr_html_ = brief, page

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def from_datasets(
        cls,
        datasets: Mapping[str, Dataset | DataError],
        *,
        train: Choice,
        validation: Choice | None = None,
        test: Choice | None = None,
    ) -> "Fleet":
        """A fleet from one dataset per engine; the parts choose records of each.

        Records are chosen by a slice, by positions or by names, the same for all
        engines. Channels are matched by name to those of the first dataset, and the
        sample time [s] must be one. In place of a dataset may stand the `DataError`
        that there is none: that engine has the status `nonfinite_data`, like one whose
        records hold NaN or infinities; one that lacks a part is `too_short`.
        """
        known = [d for d in datasets.values() if isinstance(d, Dataset)]
        if not known:
            raise SpecError("a fleet needs at least one dataset", field="datasets")
        channels, step = known[0].channels, known[0].sample_time
        choices = {"train": train, "validation": validation, "test": test}
        wanted = {k: c for k, c in choices.items() if c is not None}
        found = [_member(d, channels, step, wanted) for d in datasets.values()]
        parts = {k: _stack_part([m.parts[k] for m in found], known[0]) for k in wanted}
        return cls(
            tuple(str(name) for name in datasets),
            channels,
            float(step),
            parts["train"],
            parts.get("validation"),
            parts.get("test"),
            tuple(m.status for m in found),
            tuple(m.detail for m in found),
        )

    @property
    def parts(self) -> dict[str, Padded]:
        """The parts there are, by name."""
        every = {name: getattr(self, name) for name in FLEET_PARTS}
        return {name: part for name, part in every.items() if part is not None}

    def index(self, name: str) -> int:
        """Position of a member."""
        if name not in self.names:
            raise SpecError(
                f"the fleet has no member {name!r}. {suggest(name, self.names)}",
                field="members",
            )
        return self.names.index(name)

    def pick(self, indices: Sequence[int]) -> "Fleet":
        """A fleet of some members."""
        at = [int(n) for n in indices]
        parts = {name: part.pick(at) for name, part in self.parts.items()}
        texts = {
            field: tuple(getattr(self, field)[n] for n in at)
            for field in ("names", "status", "detail")
        }
        return dataclasses.replace(self, **parts, **texts)

    def dataset(self, member: int, part: str = "train") -> Dataset:
        """The records of one member and part, without padding."""
        padded, inputs = self.parts[part], len(self.channels.inputs)
        records = []
        for r, name in enumerate(padded.names[member]):
            length = int(padded.length[member, r])
            rows = padded.signals[member, r, :length]
            valid = padded.valid[member, r, :length]
            records.append(Record(rows[:, :inputs], rows[:, inputs:], valid, name))
        return Dataset(tuple(records), self.channels, self.sample_time)

    def digest(self) -> str:
        """SHA-256 of everything the fleet holds; padding does not count."""
        total = hashlib.sha256()
        head = (self.names, self.channels, self.sample_time, self.status)
        total.update(repr(head).encode())
        for name, part in self.parts.items():
            for member, records in enumerate(part.names):
                total.update(repr((name, member, records)).encode())
                for r in range(len(records)):
                    length = int(part.length[member, r])
                    for rows in (part.signals, part.valid):
                        own = np.ascontiguousarray(rows[member, r, :length])
                        total.update(f"{own.dtype}{own.shape}".encode())
                        total.update(own.tobytes())
        return total.hexdigest()


@dataclasses.dataclass(frozen=True)
class _Member:
    parts: dict[str, list[Record]]
    status: str = "ok"
    detail: str = ""


def _member(data, channels: Channels, step: float, wanted) -> _Member:
    """Records of one engine by part, and what is wrong with them."""
    if isinstance(data, DataError):
        return _Member({k: [] for k in wanted}, "nonfinite_data", str(data))
    data, _ = match_channels(data, channels)
    if abs(data.sample_time - step) > 1e-9 * step:
        raise SpecError(
            f"the engines of a fleet share one sample time, here {step:g} s and "
            f"{data.sample_time:g} s; resample the data",
            field="sample_time",
        )
    parts = {name: _choose_records(data, choice) for name, choice in wanted.items()}
    for name, records in parts.items():
        if not records:
            return _Member(parts, "too_short", f"no record for {name}")
    for record in (r for records in parts.values() for r in records):
        if record.scored is not None:
            raise SpecError(
                f"only a part of {record.name} is scored; a fleet takes whole records",
                field="data",
            )
        for kind, rows in (("inputs", record.u), ("outputs", record.y)):
            if not np.all(np.isfinite(rows)):
                row = int(np.argmin(np.all(np.isfinite(rows), axis=1)))
                detail = (
                    f"the {kind} of record {record.name!r} are not finite, first at "
                    f"row {row + record.start_row}"
                )
                return _Member(parts, "nonfinite_data", detail)
    return _Member(parts)


def _choose_records(data: Dataset, choice: Choice) -> list[Record]:
    if isinstance(choice, slice):
        return list(data.records[choice])
    wanted = [choice] if isinstance(choice, int | str) else list(choice)
    known = {r.name: r for r in data} | dict(enumerate(data.records))
    places = [w % len(data) if isinstance(w, int) and w < 0 else w for w in wanted]
    return [known[w] for w in places if w in known]


def _stack_part(members: list[list[Record]], like: Dataset) -> Padded:
    """Stack all members' records of one part; what is not finite becomes zero."""
    records = max(1, *(len(m) for m in members))
    time = max(1, *(len(r) for m in members for r in m))
    width, inputs = len(like.channels.all), len(like.channels.inputs)
    shape = (len(members), records, time, width)
    signals = np.zeros(shape, like.records[0].u.dtype)
    valid, length = np.zeros(shape, bool), np.zeros(shape[:2], int)
    for m, own in enumerate(members):
        for r, record in enumerate(own):
            n = length[m, r] = len(record)
            signals[m, r, :n, :inputs] = record.u
            signals[m, r, :n, inputs:] = record.y
            signals[m, r, n:] = signals[m, r, n - 1]
            valid[m, r, :n] = record.valid & np.isfinite(signals[m, r, :n])
    names = tuple(tuple(r.name for r in own) for own in members)
    return Padded(np.where(np.isfinite(signals), signals, 0.0), valid, length, names)
