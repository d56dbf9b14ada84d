"""Records that files make: which repeat each other, which train and test, and which
have a channel in another unit."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxnarx.data.channels import Channel, Channels
from jaxnarx.data.compare_records import other_units
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.families import NUMBER_MARK, read_member
from jaxnarx.data.missing import Source, assemble, unify_types
from jaxnarx.data.readers.columns import Asked, Table
from jaxnarx.data.repeated_cycles import cycles
from jaxnarx.data.roles import ChannelGuess
from jaxnarx.errors import DataError

CYCLES_PER_TEST = 5
"""One cycle in so many tests."""
DIVIDED_SAMPLES = 200
"""Samples from which one record alone is divided."""
TRAINING_SHARE, PAUSE_SHARE = 0.7, 0.05
"""Shares of it: what trains, and what lies between that and what tests."""
_PART_WORDS = {"train": "train|est(?![a-z])", "validate": "val", "test": "test"}
"""Words in names that state a record's purpose."""

Looked = Sequence[tuple[Mapping[str, Float[np.ndarray, " rows"]], Mapping[str, str]]]
"""Samples by channel, and why others have none, of every record."""


@dataclasses.dataclass(frozen=True)
class Run:
    """A part of a file, or all of it, that becomes one record.

    `member` stands for the `#` in the names of numbered columns, `span` is a part of
    the time, as in a description.
    """

    file: Path
    member: str = ""
    span: str = ""

    @property
    def name(self) -> str:
        """The file, and what of it."""
        return f"{self.file.name}{self.behind}"

    @property
    def behind(self) -> str:
        """The text behind the file's name in a description."""
        cut = f"{NUMBER_MARK}{self.member}" if self.member else self.span
        return f" @ {cut}" if cut else ""

    @property
    def label(self) -> str:
        """The text that may tell its part: the member's name, else the file's."""
        if not self.member:
            return self.file.stem
        return "" if self.member.isdigit() else self.member

    def place(self) -> tuple:
        """The place of the run in order."""
        number = int(self.member) if self.member.isdigit() else -1
        return (self.file, number, self.member)

    def read(self, names: Sequence[str], asked: Asked) -> Table:
        """Some columns."""
        return read_member(self.file, names, asked, self.member)


def _dataset(
    channels: Sequence[ChannelGuess],
    looked: Looked,
    names: Sequence[str],
    outputs: int = 0,
) -> Dataset | None:
    """The samples that were looked at as records of some channels, the last of them
    outputs; None where a record has none of a channel."""
    columns = [Channel(c.name, c.unit) for c in channels]
    split = len(columns) - outputs
    own = Channels(tuple(columns[:split]), tuple(columns[split:]))
    if not outputs:
        own = Channels(own.inputs, (Channel("every sample"),))
    sources = []
    for name, (values, _) in zip(names, looked, strict=True):
        rows = min(len(values[c.name]) for c in channels)
        x = [values[c.name][:rows] for c in channels]
        x += [] if outputs else [np.ones(rows)]
        sources.append(Source(name, np.stack(x, axis=1)))
    try:
        return Dataset(assemble(unify_types(sources), own, 1.0, "mask"), own, 1.0)
    except DataError:
        return None


def find_odd(
    runs: Sequence[Run], channels: Sequence[ChannelGuess], looked: Looked
) -> dict[Run, str]:
    """Find what seems wrong with the unit of a channel of some record."""
    used = [c for r in ("input", "output") for c in channels if c.role == r]
    outputs = sum(c.role == "output" for c in used)
    names = {run.name: run for run in runs}
    if not outputs or outputs == len(used) or len(names) < len(runs):
        return {}
    data = _dataset(used, looked, list(names), outputs)
    found = () if data is None else other_units(data)
    return {names[f.record]: f.message for f in found if f.record}


def find_cycles(
    runs: Sequence[Run], channels: Sequence[ChannelGuess], looked: Looked
) -> tuple[tuple[Run, ...], ...]:
    """Records whose inputs repeat each other; every record is in one."""
    inputs = [c for c in channels if c.role == "input"]
    alone = tuple((run,) for run in runs)
    if not inputs or len(runs) < 2:
        return alone
    data = _dataset(inputs, looked, [str(n) for n in range(len(runs))])
    if data is None:
        return alone
    found = cycles(data)
    return tuple(tuple(runs[r] for r in sorted(c.records)) for c in found)


def propose_parts(
    tied: Sequence[Sequence[Run]], rows: Sequence[int], step: float
) -> dict[str, tuple[Run, ...]]:
    """Whole cycles train or test, one in five the latter; of one alone the end does.

    Records that say in their names what they are for are taken at their word.
    """
    runs = tuple(sorted((run for own in tied for run in own), key=Run.place))
    said = {
        part: tuple(
            r for r in runs if re.search(rf"(?<![a-z])({words})", r.label, re.I)
        )
        for part, words in _PART_WORDS.items()
    }
    if said["train"] and sum(map(len, said.values())) == len(runs) > 1:
        if not said["test"]:
            said = said | {"test": said["validate"], "validate": ()}
        return {part: own for part, own in said.items() if own}
    if len(runs) == 1 and not runs[0].member:
        return _divide_record(runs[0], rows[0], step)
    if len(tied) < 2:
        return {"files": runs}
    order = sorted(tied, key=lambda own: runs.index(own[0]))
    last = min(CYCLES_PER_TEST, len(order)) - 1
    testing = {run for own in order[last::CYCLES_PER_TEST] for run in own}
    return {
        "train": tuple(r for r in runs if r not in testing),
        "test": tuple(r for r in runs if r in testing),
    }


def _divide_record(run: Run, rows: int, step: float) -> dict[str, tuple[Run, ...]]:
    """The beginning of a long record trains, and its end tests, a pause between them;
    a short one is not divided."""
    if rows < DIVIDED_SAMPLES or not step > 0:
        return {"files": (run,)}
    end, begin = (
        _round_time(share * rows * step)
        for share in (TRAINING_SHARE, TRAINING_SHARE + PAUSE_SHARE)
    )
    return {
        "train": (dataclasses.replace(run, span=f"0:{end:g}"),),
        "test": (dataclasses.replace(run, span=f"{begin:g}:"),),
    }


def _round_time(time: float) -> float:
    return float(f"{time:.3g}")
