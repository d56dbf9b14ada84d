"""Numbered columns as records: Input1, Output1, Input2, Output2, ... of one file.

In the names of columns of a description `#` stands for a number, or for one of a few
words such as Est and Val: every one with which the file has all columns makes a record.
"""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxnarx.data.description import Description
from jaxnarx.data.readers import contents, read_table
from jaxnarx.data.readers.columns import Asked, Column, Table, is_text
from jaxnarx.errors import DataFileError

NUMBER_MARK = "#"
_PART_WORDS = "est|val|train|test|valid|validation"
_CAPITAL_WORDS = "Est|Val|Train|Test|Valid|Validation"
_MEMBER_PATTERN = re.compile(
    rf"\d+|(?<![A-Za-z])(?:{_PART_WORDS})(?![a-z])|(?:{_CAPITAL_WORDS})(?![a-z])"
    rf"|(?<=\b[uyxz])(?:{_PART_WORDS})\b"
)
LEAST_NUMBERS = 5
"""Numbers of equally long columns that make records; fewer may be cylinders."""


@dataclasses.dataclass(frozen=True)
class Family:
    """Columns with `#` for their number, with that of the first, and all numbers."""

    columns: Mapping[str, Column]
    members: tuple[str, ...]


def find_family(columns: Sequence[Column], is_time: re.Pattern) -> Family | None:
    """The family that the columns of a file are; None where they are none.

    At least two kinds of columns have the same numbers, all others are times. Where
    columns of different numbers are equally long there must be five numbers, or words.
    """
    known = [c for c in columns if not c.text]
    places = max((len(_MEMBER_PATTERN.findall(c.name)) for c in known), default=0)
    found = [f for k in range(places) for f in [_family_at(known, k, is_time)] if f]
    return max(found, key=lambda f: len(f.members), default=None)


def _family_at(columns: Sequence[Column], place: int, is_time) -> Family | None:
    kinds: dict[str, dict[str, Column]] = {}
    common: dict[str, Column] = {}
    for column in columns:
        spans = list(_MEMBER_PATTERN.finditer(column.name))
        if place >= len(spans):
            common[column.name] = column
            continue
        a, b = spans[place].span()
        name = f"{column.name[:a]}{NUMBER_MARK}{column.name[b:]}"
        kinds.setdefault(name, {})[column.name[a:b]] = column
    members = list(next(iter(kinds.values()), ()))
    same = all(set(own) == set(members) for own in kinds.values())
    times = all(is_time.fullmatch(name.strip()) for name in common)
    if len(kinds) < 2 or len(members) < 2 or not same or not times:
        return None
    rows = [{own[m].rows for own in kinds.values()} for m in members]
    if any(len(one) > 1 for one in rows):
        return None
    alike = len(set.union(*rows)) == 1
    if alike and members[0].isdigit() and len(members) < LEAST_NUMBERS:
        return None
    first = {
        n: dataclasses.replace(own[members[0]], name=n) for n, own in kinds.items()
    }
    return Family(common | first, tuple(sorted(members, key=_order)))


def _order(member: str) -> tuple[int, str]:
    return (int(member), "") if member.isdigit() else (-1, member)


def plain_name(column: str) -> str:
    """A name for a channel whose column is numbered: `u` of `uEst`, `m_1` of `m3_1`."""
    name = column.replace(NUMBER_MARK, "").replace("()", "").replace("[]", "")
    return re.sub(r"([._ -])\1+", r"\1", name).strip("._ -") or column


def is_numbered(description: Description) -> bool:
    """Whether names of columns have a `#`."""
    return any(NUMBER_MARK in column for column in description.wanted)


def list_members(file: Path, description: Description) -> tuple[str, ...]:
    """Numbers or words with which a file has all columns of a description; none where
    it has columns of just these names."""
    names = {column.name for column in contents(file, description.asked)}
    wanted = [column for column in description.wanted if NUMBER_MARK in column]
    if not wanted or names.issuperset(wanted):
        return ()
    before, _, behind = wanted[0].partition(NUMBER_MARK)
    found = {
        name[len(before) : len(name) - len(behind)]
        for name in names
        if name.startswith(before) and name.endswith(behind)
    }
    there = [
        one
        for one in found
        if _MEMBER_PATTERN.fullmatch(one)
        and names.issuperset(column.replace(NUMBER_MARK, one) for column in wanted)
    ]
    if not there:
        raise DataFileError(
            f"{file}: no number in place of {NUMBER_MARK} makes columns of "
            f"{', '.join(wanted)}. Correct the names of the columns.",
            path=file,
        )
    return tuple(sorted(there, key=_order))


def read_member(
    file: Path, wanted: Sequence[str], asked: Asked, member: str = ""
) -> Table:
    """The columns of one member by their names with `#`; without a member, as they are.

    Columns of one table that are shorter than the longest end in empty cells, which are
    left out.
    """
    if not member:
        return read_table(file, wanted, asked)
    actual = {name: name.replace(NUMBER_MARK, member) for name in wanted}
    table = read_table(file, list(actual.values()), asked)
    own = {n: table.columns[a] for n, a in actual.items()}
    rows = max(
        (_drop_empty_end(c) for n, c in own.items() if NUMBER_MARK in n), default=0
    )
    return dataclasses.replace(
        table,
        columns={n: c[:rows] for n, c in own.items()},
        units={n: table.units.get(a, "") for n, a in actual.items()},
        time=None if table.time is None else table.time[:rows],
    )


def _drop_empty_end(column) -> int:
    """Rows up to the last one that is not empty."""
    empty = np.asarray(column.is_null(nan_is_null=not is_text(column.type)))
    return int(len(empty) - np.argmin(empty[::-1])) if not empty.all() else 0
