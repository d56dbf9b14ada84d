"""Parts of a long file as records: by time, or while a column says so.

A pattern of files may end in one of

    long.csv @ 0:500              from 0 s up to 500 s after its first row
    long.csv @ 700:               from 700 s to the end
    long.csv @ engine_on > 0.5    every uninterrupted stretch of at least ten rows
    runs.mat @ #1,2,5             of numbered columns those with these numbers

"""

import dataclasses
import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.data.missing import Source
from jaxnarx.errors import DataError, SpecError

SHORTEST_RECORD = 10
"""Rows of the shortest record."""
_SPAN_MARK = " @ "
_SPAN_PATTERN = re.compile(r"\s*([0-9.eE+-]*)\s*:\s*([0-9.eE+-]*)\s*")
_MEMBERS_PATTERN = re.compile(r"#\s*(\w+(?:\s*,\s*\w+)*)")
_WHILE_PATTERN = re.compile(r"\s*(.+?)\s*([<>])\s*([-+0-9.eE]+)\s*")


@dataclasses.dataclass(frozen=True)
class Cut:
    """A cut of a record: from `first` up to `stop` seconds, or while `column` is beyond
    `level`."""

    text: str
    first: float = 0.0
    stop: float = math.inf
    column: str = ""
    above: bool = True
    level: float = 0.0
    members: tuple[str, ...] = ()

    def shares(self, other: "Cut | None") -> bool:
        """Whether a record of one may hold rows of the other's, as far as is known."""
        if other is None or self == other or self.column or other.column:
            return True
        if self.members and other.members:
            return not set(self.members).isdisjoint(other.members)
        return self.first < other.stop and other.first < self.stop

    def pieces(
        self, source: Source, step: float, trigger: Float[np.ndarray, " time"] | None
    ) -> list[Source]:
        """The records of one source; `trigger` are the values of the column.

        DataError where nothing is left.
        """
        rows = len(source.x)
        if trigger is None:
            first = math.ceil(self.first / step - 1e-6)
            last = rows if math.isinf(self.stop) else math.ceil(self.stop / step - 1e-6)
            spans = [(min(first, rows), min(last, rows))]
        else:
            spans = _stretches(self._holds(trigger))
        spans = [(a, b) for a, b in spans if b - a >= SHORTEST_RECORD]
        if not spans:
            raise DataError(
                f"{source.place.lead}{self.text!r} leaves no stretch of "
                f"{SHORTEST_RECORD} rows of its {rows} ({rows * step:g} s). Correct it."
            )
        name = f"{source.name} @ {self.text}"
        if trigger is None:
            return [_piece(source, *spans[0], name)]
        return [_piece(source, *s, f"{name}#{k + 1}") for k, s in enumerate(spans)]

    def _holds(self, x: Float[np.ndarray, " time"]) -> Bool[np.ndarray, " time"]:
        return x > self.level if self.above else x < self.level


def _stretches(holds: Bool[np.ndarray, " time"]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(holds.astype(int), prepend=0, append=0))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _piece(source: Source, first: int, stop: int, name: str) -> Source:
    place = dataclasses.replace(source.place, start_row=source.place.start_row + first)
    cuts = [c - first for c in source.cuts if first < c < stop]
    return Source(name, source.x[first:stop], place, cuts)


def parse_cut(pattern: str, field: str) -> tuple[str, Cut | None]:
    """The pattern of files, and what is cut from each; SpecError for what is neither
    a span nor a comparison."""
    files, mark, text = pattern.partition(_SPAN_MARK)
    if not mark:
        return pattern, None
    text = text.strip()
    if members := _MEMBERS_PATTERN.fullmatch(text):
        own = tuple(one.strip() for one in members[1].split(","))
        return files.strip(), Cut(text, members=own)
    span, comparison = _SPAN_PATTERN.fullmatch(text), _WHILE_PATTERN.fullmatch(text)
    try:
        if span:
            first, stop = float(span[1] or 0), float(span[2] or math.inf)
            if 0 <= first < stop:
                return files.strip(), Cut(text, first, stop)
        elif comparison:
            level = float(comparison[3])
            above = comparison[2] == ">"
            return files.strip(), Cut(text, 0.0, math.inf, comparison[1], above, level)
    except ValueError:
        pass
    raise SpecError(
        f"behind {_SPAN_MARK.strip()} stands a span of seconds, such as 0:500 or "
        "700:, a comparison, such as speed > 500, or numbers of numbered columns, "
        f"such as #1,2; got {text!r}",
        field=field,
    )


def trigger_columns(cuts: Iterable[Cut | None]) -> list[str]:
    """The columns that triggers look at."""
    return list(dict.fromkeys(c.column for c in cuts if c is not None and c.column))


def require_apart(chosen: Iterable[tuple[Any, Cut | None, str]], path: Any) -> None:
    """SpecError where two records of one file may hold the same rows.

    `chosen` are file, cut and part.
    """
    seen: dict[Any, list[tuple[Cut | None, str]]] = {}
    for file, cut, part in chosen:
        for other, first in seen.get(file, []):
            both = cut is None or other is None or cut.shares(other)
            if both and not (first == part and cut == other):
                where = f"is in {first} and in {part}"
                if first == part:
                    where = f"has overlapping parts in {part}"
                raise SpecError(
                    f"{path}: {file.name} {where}. A record may serve one part only.",
                    field=f"records.{part}",
                )
        seen.setdefault(file, []).append((cut, part))
