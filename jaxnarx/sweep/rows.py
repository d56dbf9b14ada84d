"""Rows of a chunk, whatever happens: a member that fails is a row that says so."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

from jaxnarx.errors import SpecError
from jaxnarx.sweep.work import Work

Row = dict[str, Any]
LEADING_COLUMNS = ("status", "message", "seconds")
"""Columns between the labels and the scores."""

LONGEST_MESSAGE = 500
"""Characters of an error message that a row keeps."""


def compute_rows(
    work: Work,
    indices: Sequence[int],
    labels: Sequence[Mapping[str, Any]],
    size: int,
    whole: int,
) -> tuple[list[Row], int]:
    """Rows of some members, in their order, and the piece size that memory allowed.

    Members are computed in pieces of at most `size`. A piece that fails is halved until
    the members that fail are alone; they get the status `crashed` and the message. If
    it was the memory that did not suffice, later pieces are as small as the first that
    succeeded, and rows from pieces smaller than `whole` say so. Every row has the
    member's index and labels, `seconds`, its share of the time its chunk took, and
    `message`.
    """
    begin = time.perf_counter()
    found: list[Row] = []
    pieces = _pieces(indices, size)
    while pieces:
        piece = pieces.pop(0)
        rows, error = _attempt(work, piece)
        if rows is not None:
            note = _note(size) if size < whole else ""
            found += [{**row, "message": row.get("message") or note} for row in rows]
        elif len(piece) == 1:
            found.append({"status": "crashed", "message": error})
        else:
            half = -(-len(piece) // 2)
            size = half if is_memory(error) else size
            rest = [small for large in pieces for small in _pieces(large, size)]
            pieces = [*_pieces(piece, half), *rest]
    share = (time.perf_counter() - begin) / max(len(indices), 1)
    _require_apart(found, labels)
    return [
        {"index": i, **label, **dict.fromkeys(LEADING_COLUMNS), "seconds": share, **row}
        for i, label, row in zip(indices, labels, found, strict=True)
    ], size


def is_memory(error: str) -> bool:
    """Whether a message tells of memory that did not suffice, the device's or ours."""
    return any(word in error for word in ("MemoryError", "RESOURCE_EXHAUSTED"))


def _attempt(work: Work, piece: Sequence[int]) -> tuple[list[Row] | None, str]:
    """Rows, or what went wrong as text: the exception itself would hold the arrays."""
    try:
        rows = work.run(piece)
    except Exception as error:
        return None, f"{type(error).__name__}: {error}"[:LONGEST_MESSAGE]
    if len(rows) != len(piece) or any("status" not in row for row in rows):
        raise SpecError(
            f"work.run must return a row with a status for each of {len(piece)} "
            f"members; it returned {len(rows)} rows",
            field="work",
        )
    return rows, ""


def _require_apart(rows: Sequence[Row], labels: Sequence[Mapping[str, Any]]) -> None:
    """SpecError where a row has a key of the labels, or of the folder."""
    taken = {"index", *(name for label in labels for name in label)}
    if both := sorted(taken & {name for row in rows for name in row}):
        raise SpecError(
            f"rows of a sweep must not have a key of the labels, as {both[0]!r} is",
            field="work",
        )


def _pieces(indices: Sequence[int], size: int) -> list[list[int]]:
    return [list(indices[i : i + size]) for i in range(0, len(indices), size)]


def _note(size: int) -> str:
    return f"computed in pieces of {size} for want of memory"
