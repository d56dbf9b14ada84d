"""Which records a page holds, and in what detail, so that it stays small.

All records are there at the whole rate if that fits, in fine or else in coarser steps,
those with the largest errors in finer ones. Otherwise these alone are, as far as they
fit, and of the others their envelope with the stretch where the error is largest.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.evaluation import ShownRecord
from jaxnarx.shell.report.page.codec import (
    COARSE_LEVELS,
    FINE_LEVELS,
    MIDDLE_LEVELS,
    pack,
)

MAX_RECORDS_BYTES = 1_600_000
"""All records together, as they stand in the page."""
ENVELOPE_BINS = 400
"""Of an envelope."""
STRETCHES = (
    (2_000, FINE_LEVELS),
    *((length, MIDDLE_LEVELS) for length in (2_000, 1_000, 500, 250)),
)
"""Samples around the largest error, and their levels: the first that fit."""
WIDTH_LEVELS, INDEX_LEVELS, SWITCH_LEVELS = 250, 1_000, 1
"""Levels of half widths, of the index and of switches."""
MAX_INDEX_SHOWN = 8.0
"""Larger indices are shown as this."""


@dataclasses.dataclass(frozen=True)
class Budget:
    """The records as JSON values, and in words what was done to make them small."""

    records: tuple[dict[str, Any], ...]
    told: str


def choose_records(
    records: Sequence[ShownRecord], limit: int = MAX_RECORDS_BYTES
) -> Budget:
    """Choose as much of the records as fits; the order stays."""
    for levels in (FINE_LEVELS, MIDDLE_LEVELS):
        whole = [_encode_whole(record, levels) for record in records]
        if _sum(whole) <= limit:
            told = f"every sample, rounded to {_share(levels)}"
            return Budget(tuple(whole), told)
    coarse = [_encode_whole(record, COARSE_LEVELS) for record in records]
    if _sum(coarse) <= limit:
        found, kept = _enlarge_worst(coarse, whole, records, limit)
        told = f"every sample, rounded to {_share(COARSE_LEVELS)}"
        if kept:
            told += f", to 1/{MIDDLE_LEVELS:,} in the {kept} of {len(records)} records "
            told += "with the largest errors"
        return Budget(found, told)
    bins = min(ENVELOPE_BINS, max(limit // (40 * max(len(records), 1)), 8))
    length, reduced = 0, []
    for length, levels in STRETCHES:
        reduced = [_reduce(record, bins, length, levels) for record in records]
        if _sum(reduced) <= limit:
            break
    found, kept = _enlarge_worst(reduced, coarse, records, limit)
    told = (
        f"every sample of the {kept} of {len(records)} records with the largest errors,"
        f" rounded to {_share(COARSE_LEVELS)}; of the others the least and largest "
        f"value of {bins} stretches of time, and up to {length:,} samples "
        "around the largest error"
    )
    return Budget(found, told)


def _share(levels: int) -> str:
    return f"1/{levels:,} of each signal's range"


def _enlarge_worst(
    small: Sequence[dict[str, Any]],
    large: Sequence[dict[str, Any]],
    records: Sequence[ShownRecord],
    limit: int,
) -> tuple[tuple[dict[str, Any], ...], int]:
    """Small ones, as many as fit of those with the largest errors large; how many."""
    found, left, kept = list(small), limit - _sum(small), 0
    for n in sorted(range(len(records)), key=lambda n: -_badness(records[n])):
        more = _size(large[n]) - _size(small[n])
        if more > left:
            break
        found[n], left, kept = large[n], left - more, kept + 1
    return tuple(found), kept


def _sum(records: Sequence[dict[str, Any]]) -> int:
    return sum(map(_size, records))


def _size(record: dict[str, Any]) -> int:
    """Characters of its series in the page."""
    blocks = (record["data"], record.get("stretch"))
    return sum(len(block["text"]) for block in blocks if block)


def _badness(record: ShownRecord) -> float:
    """The largest error of any output, in shares of its spread."""
    found = [0.0]
    for o in range(record.simulated.shape[1]):
        error = record.error(o)
        if error is not None:
            found.append(error / _spread(record, o))
    return max(found)


def _spread(record: ShownRecord, o: int) -> float:
    """Standard deviation of the measurement, 1 of what does not move."""
    y = record.measurement(o)
    y = y[np.isfinite(y)]
    with np.errstate(over="ignore", invalid="ignore"):
        spread = float(np.std(y)) if y.size else 0.0
    return spread if spread > 0 and np.isfinite(spread) else 1.0


def _describe_record(record: ShownRecord) -> dict[str, Any]:
    errors = [record.error(o) for o in range(record.simulated.shape[1])]
    begin = record.begin
    return {
        "part": record.part,
        "name": record.name,
        "samples": len(record),
        "start": record.start,
        "begin": None if begin is None else numbers(begin),
        "errors": numbers(errors),
    }


def numbers(value: Any) -> Any:
    """Lists of numbers for JSON; None for what is no number."""
    if value is None:
        return None
    if isinstance(value, list | tuple | np.ndarray):
        return [numbers(item) for item in value]
    return float(value) if np.isfinite(value) else None


def _encode_whole(record: ShownRecord, levels: int) -> dict[str, Any]:
    return _describe_record(record) | {"data": pack(_series(record), levels), "bins": 0}


def _series(
    record: ShownRecord, part: slice = slice(None)
) -> Iterator[tuple[str, int, Float[np.ndarray, " samples"]]]:
    """Every series by its name: a letter, and the number of the channel or output."""
    for s, value in enumerate(record.signals.values()):
        yield f"u{s}", FINE_LEVELS, value[part]
    for o in range(record.simulated.shape[1]):
        yield f"y{o}", FINE_LEVELS, record.simulated[part, o]
        yield f"s{o}", SWITCH_LEVELS, record.scored[part, o].astype(float)
        yield f"l{o}", SWITCH_LEVELS, record.limited[part, o].astype(float)
        if record.lower is not None and record.upper is not None:
            half = 0.5 * record.upper[part, o] - 0.5 * record.lower[part, o]
            yield f"h{o}", WIDTH_LEVELS, half
        for n, run in enumerate(record.others.values()):
            yield f"o{n}.{o}", FINE_LEVELS, run[part, o]
    if record.index is not None:
        yield "i", INDEX_LEVELS, np.minimum(record.index[part], MAX_INDEX_SHOWN)


def _reduce(record: ShownRecord, bins: int, length: int, levels: int) -> dict[str, Any]:
    """Its envelope, residuals among it, and the stretch with the largest error."""
    bins = min(bins, max(len(record) // 2, 1))
    borders = np.linspace(0, len(record), bins + 1).astype(int)[:-1]
    table = []
    for name, own, value in [*_series(record), *_residuals(record)]:
        if name[0] in "sl":
            continue
        low, high = (
            function.reduceat(value, borders) for function in (np.fmin, np.fmax)
        )
        table.append((name, own, np.stack([low, high], axis=1).ravel()))
    at = _stretch(record, length)
    return _describe_record(record) | {
        "data": pack(table, COARSE_LEVELS),
        "bins": bins,
        "first": at.start,
        "stretch": pack(_series(record, at), levels),
        "length": at.stop - at.start,
    }


def _residuals(
    record: ShownRecord,
) -> Iterator[tuple[str, int, Float[np.ndarray, " samples"]]]:
    for o in range(record.simulated.shape[1]):
        yield f"r{o}", FINE_LEVELS, record.residual(o)


def _stretch(record: ShownRecord, length: int) -> slice:
    """Samples around the largest error of any output, in shares of its spread."""
    size = min(length, len(record))
    at, most = 0, -1.0
    for o in range(record.simulated.shape[1]):
        off = np.abs(np.nan_to_num(record.residual(o)))
        scale = _spread(record, o)
        if off.size and off.max() / scale > most:
            at, most = int(np.argmax(off)), float(off.max() / scale)
    first = int(np.clip(at - size // 2, 0, len(record) - size))
    return slice(first, first + size)
