"""What preparation did to every record: samples left, samples masked."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jaxnarx.data.check_samples import spans
from jaxnarx.data.dataset import Dataset, Record


@dataclasses.dataclass(frozen=True)
class Change:
    """What one step did to one record.

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
    """What every step did to every record; `steps` are their descriptions."""

    steps: tuple[str, ...] = ()
    items: tuple[Change, ...] = ()

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Change]:
        return iter(self.items)

    def of(self, step: int) -> tuple[Change, ...]:
        """What one step did."""
        return tuple(c for c in self.items if c.step == step)

    def masked(self, step: int) -> dict[str, int]:
        """Samples that a step masked, by channel, over all records."""
        out: dict[str, int] = {}
        for change in self.of(step):
            for name, n in change.masked.items():
                out[name] = out.get(name, 0) + n
        return out

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
        for name, n in self.masked(step).items():
            share = 100 * n / max(after, 1)
            records = sum(name in c.masked for c in own)
            yield f"{name}: {n} masked ({share:.2g} %) in {records} record(s)"


def changes(before: Dataset, after: Dataset, *, step: int) -> tuple[Change, ...]:
    """What a step did, from the data before and after it."""
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
