"""Records, or blocks of them, that are left out together: the base of cross-validation.

A model is judged on what took no part in its training only where nothing that repeats
the judged samples did. Groups are stated (`group` of the records, as `[records] groups`
of a description sets it) or found: records that repeat each other's inputs belong
together. Where too few records are independent, all are cut into blocks.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Int

from jaxnarx.checks import require, require_known
from jaxnarx.checks import whole as whole_number
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.missing import hold
from jaxnarx.data.record import Record
from jaxnarx.data.repeated_cycles import Cycle, cycles
from jaxnarx.deprecation import old_method
from jaxnarx.errors import DataError, SpecError

FEWEST_RECORDS = 3
"""With fewer independent records than this blocks are left out, not records."""
MAX_GAP_SHARE = 0.1
"""Share of a record that gaps may take: runs go on through them, so that they only part
what is correlated beyond the model. With half of a record, models of single records of
virtual engines were a fifth worse on other records."""
SHORTEST_BLOCK = 10
"""Rows of the shortest block worth leaving out."""


@dataclasses.dataclass(frozen=True)
class Fold:
    """The training data without one group, and the samples that judge then."""

    name: str
    train: Dataset
    left: Dataset


@dataclasses.dataclass(frozen=True, eq=False)
class Groups:
    """Groups of a dataset that are left out together.

    `names` says it to people, one for each group: `"day1_a, day1_b"`, `"rows 0 to 204
    of r0"`. `labels` holds the group of every sample of every record, -1 in the gap
    between two blocks, which is in no group. `whole` tells whether no record is cut.
    """

    names: tuple[str, ...]
    labels: tuple[Int[np.ndarray, " _"], ...]
    whole: bool

    def __len__(self) -> int:
        return len(self.names)

    def parts(
        self,
    ) -> tuple[tuple[Int[np.ndarray, " _"], ...], Bool[np.ndarray, "groups parts"]]:
        """Samples by what they are left out with, and which parts that are.

        The first parts are the groups. Each of the others is a gap, which is left out
        with the blocks beside it and trains whenever both of them do.
        """
        out = np.stack(
            [np.concatenate(self.held_out_samples(g)) for g in range(len(self))]
        )
        every, edges = np.concatenate(self.labels), np.cumsum([*map(len, self.labels)])
        gap = every < 0
        kinds, own = np.unique(out[:, gap], axis=1, return_inverse=True)
        every = every.copy()
        every[gap] = len(self) + own.ravel()
        apart = np.concatenate([np.eye(len(self), dtype=bool), kinds], axis=1)
        return tuple(np.split(every, edges[:-1])), apart

    def held_out_samples(self, g: int) -> tuple[Bool[np.ndarray, " _"], ...]:
        """The samples of every record that train nothing while group `g` is left out:
        its own, and the gaps beside them."""
        return tuple(_held_out_samples(label, g) for label in self.labels)

    left_out = old_method("left_out", "held_out_samples")

    def fold(self, data: Dataset, g: int, *, whole: bool = False) -> Fold:
        """Training records without group `g`, and those that judge it.

        `data` are the records that the groups were made of, perhaps with other
        channels. Whole records go to one side. A record of which a block is left out
        goes to both: in `train` the outputs of the block and of its gaps are missing,
        while inputs stay, so that runs go on through it; in `left` everything is as
        measured, but only the block counts (`Record.scored`). So a free run of `left`
        begins at the record's measured start, whatever the model's memory, and is
        scored on the block alone.

        With `whole`, records that train nothing stay in `train`, not one sample of them
        valid: programs are made for a number of records and the longest, so that all
        folds, and a training on everything, are served by the same.
        """
        lengths = [len(label) for label in self.labels]
        require(
            lengths == [len(r) for r in data],
            "data",
            f"the groups are those of records with {lengths} samples, the data have "
            f"{[len(r) for r in data]}; make groups of these data",
        )
        pairs = zip(data, self.held_out_samples(g), strict=True)
        train = [_mask_outputs(record, out) for record, out in pairs]
        seen = [r.valid[:, r.u.shape[1] :].any() for r in train]
        if whole:
            train = [
                r if s else _empty_record(r) for r, s in zip(train, seen, strict=True)
            ]
        else:
            train = [r for r, s in zip(train, seen, strict=True) if s]
        pairs = zip(data, self.labels, strict=True)
        left = [_score_only(r, label == g) for r, label in pairs if (label == g).any()]
        sides = (dataclasses.replace(data, records=tuple(s)) for s in (train, left))
        return Fold(self.names[g], *sides)

    def without(self, data: Dataset, g: int) -> tuple[Dataset, "Groups"]:
        """The training records of fold `g`, and the other groups in them.

        So nested cross-validation makes all choices again without the group. A block
        that is left out is in no group, as the gaps beside it.
        """
        train = self.fold(data, g).train
        kept = [n for n, record in enumerate(data) if record.name in train.names]
        labels = (self.labels[n] for n in kept)
        names = (*self.names[:g], *self.names[g + 1 :])
        left = (np.where(v == g, -1, v - (v > g)) for v in labels)
        return train, Groups(names, tuple(left), self.whole)

    def exclude_group(self, data: Dataset, g: int | None = None) -> Dataset:
        """Training records without group `g`, of runs that end where it begins.

        Every record comes twice, valid up to the block that is left out, and behind it:
        a run that went on through a stretch on which nothing holds it would be trained
        to leave that as it likes. Without a block the second has no valid sample, so
        that all programs are for one number of records; so it is with None, where
        nothing is left out. Groups of whole records are left out as `fold` does.
        """
        if self.whole:
            return data if g is None else self.fold(data, g, whole=True).train
        out = (
            tuple(np.zeros(len(r), bool) for r in data)
            if g is None
            else self.held_out_samples(g)
        )
        pairs = list(zip(data, out, strict=True))
        parts = [_end_before(r, o) for r, o in pairs] + [
            _begin_behind(r, o) for r, o in pairs
        ]
        return dataclasses.replace(data, records=tuple(parts))

    parted = old_method("parted", "exclude_group")

    def folds(self, data: Dataset, *, whole: bool = False) -> Iterator[Fold]:
        """Every group left out in turn, see `fold`."""
        return (self.fold(data, g, whole=whole) for g in range(len(self)))


def groups(
    data: Dataset,
    *,
    named: Mapping[str, Sequence[str]] | None = None,
    folds: int = 5,
    gap: int = 0,
) -> Groups:
    """Find the groups of `data` that are left out together.

    Named groups stay as they are, and records that none names are put into others.
    Without names, records that repeat each other's inputs
    (`jaxnarx.data.repeated_cycles`) are tied together and dealt, largest first, into up
    to `folds` groups of about equal size. With fewer than three such parts, or one that
    holds over half of the samples, every record is cut into `folds` blocks of equal
    length, of which group k holds the k-th; records that repeat each other are cut at
    the same places of their cycle. A record too short to be cut is put into one of
    these groups. The same data always give the same groups.

    Args:
        data: Records to be divided.
        named: Record names by group; default what the records say (`Record.group`).
        folds: Most groups that are found.
        gap: Samples between two blocks that are in neither, as many as the memory of
            the models, but all gaps a tenth of a record at most.

    Returns:
        At least two groups. A DataError tells where the records are too short for
        that, a SpecError where a name is unknown or used twice.
    """
    folds, gap = whole_number(folds, "folds", 2), whole_number(gap, "gap", 0)
    require(len(data) > 0, "data", "the dataset has no records")
    named = _own(data) if named is None else named
    if named:
        return _groups_by_name(data, named, folds)
    found = cycles(data)
    return _deal_records(data, found, folds) or _blocks(data, found, folds, gap)


def whole_groups(data: Dataset, folds: int) -> Groups | None:
    """Groups of whole records, None where `groups` would cut them into blocks."""
    named = _own(data)
    return (
        _groups_by_name(data, named, folds)
        if named
        else _deal_records(data, cycles(data), folds)
    )


def _held_out_samples(
    label: Int[np.ndarray, " time"], g: int
) -> Bool[np.ndarray, " time"]:
    at = np.arange(len(label))
    before = np.maximum.accumulate(np.where(label >= 0, at, 0))
    after = np.minimum.accumulate(np.where(label >= 0, at, len(label) - 1)[::-1])[::-1]
    return (label[before] == g) | (label[after] == g)


def _mask_outputs(record: Record, out: Bool[np.ndarray, " time"]) -> Record:
    """The record with missing outputs where they are left `out`."""
    if not out.any():
        return record
    valid, inputs = record.valid.copy(), record.u.shape[1]
    valid[out, inputs:] = False
    y = hold(record.y, valid[:, inputs:])
    return dataclasses.replace(record, y=y, valid=valid)


def _end_before(record: Record, out: Bool[np.ndarray, " time"]) -> Record:
    """The record, not valid from the first row that is left out on."""
    return _valid_in(record, 0, int(np.argmax(out)) if out.any() else len(record))


def _begin_behind(record: Record, out: Bool[np.ndarray, " time"]) -> Record:
    """The record, not valid up to the last row that is left out."""
    last = int(np.flatnonzero(out)[-1]) if out.any() else len(record)
    part = _valid_in(record, last + 1, len(record))
    return dataclasses.replace(part, name=f"{record.name} (behind)")


def _valid_in(record: Record, first: int, stop: int) -> Record:
    """The record with valid samples in these rows alone."""
    rows = np.arange(len(record))
    inside = (rows >= first) & (rows < stop)
    return dataclasses.replace(record, valid=record.valid & inside[:, None])


def _empty_record(record: Record) -> Record:
    """The record with nothing that counts."""
    return dataclasses.replace(record, valid=np.zeros_like(record.valid))


def _score_only(record: Record, own: Bool[np.ndarray, " time"]) -> Record:
    """The record with its `own` samples scored alone."""
    scored = own if record.scored is None else own & record.scored
    return record if own.all() else dataclasses.replace(record, scored=scored)


# whole records ----------------------------------------------------------------------


def _own(data: Dataset) -> dict[str, list[str]]:
    """Record names by the groups that the records state."""
    found: dict[str, list[str]] = {}
    for record in data:
        if record.group:
            found.setdefault(record.group, []).append(record.name)
    return found


def _groups_by_name(
    data: Dataset, named: Mapping[str, Sequence[str]], folds: int
) -> Groups:
    of: dict[str, str] = {}
    for group, names in named.items():
        require(len(names) > 0, "named", f"the group {group!r} names no record")
        for name in names:
            require_known(
                name, data.names, "named", f"the group {group!r} names {name!r}"
            )
            if of.setdefault(name, group) != group:
                raise SpecError(
                    f"{name} is in the groups {of[name]!r} and {group!r}. A record is "
                    "left out with one group only.",
                    field="named",
                )
    members = [[n for n, r in enumerate(data) if of.get(r.name) == g] for g in named]
    told = list(named)
    rest = [n for n, r in enumerate(data) if r.name not in of]
    if rest:
        count = max(folds - len(named), 1)
        for part in _deal(
            [[rest[n] for n in p] for p in _tie_repeats(data[rest])], data, count
        ):
            members.append(part)
            told.append(_describe(data, part))
    if len(members) < 2:
        raise SpecError(
            f"the group {told[0]!r} holds every record, so that nothing is left to "
            "train on. Name two groups or more, or not all records.",
            field="named",
        )
    return _label_records(data, members, told)


def _deal_records(data: Dataset, found: list[Cycle], folds: int) -> Groups | None:
    """Groups of whole records, where enough are independent."""
    parts = [list(cycle.records) for cycle in found]
    if (
        len(parts) < FEWEST_RECORDS
        or 2 * max(_rows(data, p) for p in parts) > data.samples
    ):
        return None
    members = _deal(parts, data, folds)
    return _label_records(data, members, [_describe(data, part) for part in members])


def _tie_repeats(data: Dataset) -> list[list[int]]:
    return [list(cycle.records) for cycle in cycles(data)]


def _rows(data: Dataset, part: Sequence[int]) -> int:
    return sum(len(data.records[n]) for n in part)


def _deal(parts: list[list[int]], data: Dataset, count: int) -> list[list[int]]:
    """Up to `count` groups of whole parts: the largest goes where there is least."""
    dealt: list[list[int]] = [[] for _ in range(min(count, len(parts)))]
    for part in sorted(parts, key=lambda p: -_rows(data, p)):
        min(dealt, key=lambda g: _rows(data, g)).extend(part)
    return sorted(map(sorted, dealt))


def _describe(data: Dataset, part: Sequence[int]) -> str:
    return ", ".join(data.records[n].name for n in part)


def _label_records(data: Dataset, members: list[list[int]], names: list[str]) -> Groups:
    of = {n: g for g, part in enumerate(members) for n in part}
    labels = tuple(np.full(len(r), of[n]) for n, r in enumerate(data))
    return Groups(tuple(names), labels, True)


# blocks -----------------------------------------------------------------------------


def block_labels(rows: int, folds: int, gap: int) -> Int[np.ndarray, " rows"]:
    """Numbers of `folds` equal blocks of `rows` samples, -1 in the gaps between."""
    gap = min(gap, int(MAX_GAP_SHARE * rows) // (folds - 1))
    edges = np.arange(folds + 1) * (rows - (folds - 1) * gap) // folds
    labels = np.full(rows, -1)
    for k in range(folds):
        labels[edges[k] + k * gap : edges[k + 1] + k * gap] = k
    return labels


def _blocks(data: Dataset, found: list[Cycle], folds: int, gap: int) -> Groups:
    labels: dict[int, np.ndarray] = {}
    short = []
    for cycle in found:
        rows = max(len(data.records[n]) for n in cycle.records)
        if rows < folds * SHORTEST_BLOCK:
            short.append(list(cycle.records))
            continue
        own = block_labels(rows, folds, gap)
        for n, begin in zip(cycle.records, cycle.begins, strict=True):
            at = begin + np.arange(len(data.records[n]))
            labels[n] = own[np.clip(at, 0, rows - 1)]
    if not labels:
        longest = max(data, key=len)
        raise DataError(
            f"{longest.name}, the longest record, has {len(longest)} rows, too few for "
            f"{folds} blocks of {SHORTEST_BLOCK} rows to be left out in turn. Take "
            "fewer folds, or give longer records, or at least three that do not "
            "repeat each other.",
        )
    sizes = sum(np.bincount(v[v >= 0], minlength=folds) for v in labels.values())
    sizes = np.asarray(sizes)
    for part in sorted(short, key=lambda p: -_rows(data, p)):
        g = int(np.argmin(sizes))
        sizes[g] += _rows(data, part)
        labels |= {n: np.full(len(data.records[n]), g) for n in part}
    ordered = tuple(labels[n] for n in range(len(data)))
    names = tuple(_describe_blocks(data, ordered, g) for g in range(folds))
    return Groups(names, ordered, False)


def _describe_blocks(data: Dataset, labels: tuple[np.ndarray, ...], g: int) -> str:
    told = []
    for record, label in zip(data, labels, strict=True):
        at = np.flatnonzero(label == g)
        if len(at) == len(record):
            told.append(record.name)
        elif len(at):
            first, last = (record.start_row + int(at[k]) for k in (0, -1))
            told.append(f"rows {first} to {last} of {record.name}")
    return ", ".join(told)
