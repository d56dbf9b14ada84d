"""Columns of a table, as numbers; text and dates are refused with what they hold."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data.channels import Channels
from jaxnarx.data.missing import Source
from jaxnarx.data.place import Place
from jaxnarx.data.sampling import sampling
from jaxnarx.errors import DataError

DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*")


@dataclasses.dataclass(frozen=True, eq=False)
class Table:
    """Wanted columns of one source: arrow arrays by name, and units if it states any.

    Every reader (CSV, Parquet, frames, later MDF) ends here.
    """

    columns: Mapping[str, Any]
    place: Place
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))


def table_source(
    table: Table,
    channels: Channels,
    columns: Mapping[str, str],
    *,
    name: str,
    time: str | None,
    sample_time: float | None,
    split: bool,
) -> tuple[Source, float]:
    """One record from a table, and its sample time [s].

    `columns` maps channel names to column names (the same name where absent). At least
    one of `time` (a column) and `sample_time` is given.
    """
    parts = [
        numbers(table.columns[columns.get(n, n)], channel=n, place=table.place)
        for n in channels.names
    ]
    cuts: Sequence[int] = ()
    if time is not None:
        t = seconds(table.columns[time], name=time, place=table.place)
        sample_time, cuts = sampling(
            t, column=time, place=table.place, sample_time=sample_time, split=split
        )
    assert sample_time is not None
    return Source(name, np.stack(parts, axis=1), table.place, cuts), sample_time


def numbers(column: Any, *, channel: str, place: Place) -> Float[np.ndarray, " time"]:
    """An arrow column as float32 (if it is) or float64, with NaN for nulls.

    Text, labels, dates and nested values raise DataError naming what was found.
    """
    import pyarrow as pa
    import pyarrow.types as kinds

    column = _plain(column)
    kind = column.type
    if kinds.is_null(kind):
        return np.full(len(column), np.nan)
    if kinds.is_boolean(kind):
        column = column.cast(pa.uint8())
        kind = column.type
    if kinds.is_floating(kind) or kinds.is_integer(kind) or kinds.is_decimal(kind):
        if not kinds.is_float32(kind):
            column = column.cast(pa.float64(), safe=False)
        return np.array(column.to_numpy(zero_copy_only=False))
    if any(is_text(kind) for is_text in _text_kinds()):
        raise _text(column, channel, place)
    raise DataError(
        f"{place.lead}channel {channel} holds {kind} values, not numbers. Leave it "
        "out, or convert it to numbers first.",
        channel=channel,
    )


def seconds(column: Any, *, name: str, place: Place) -> Float[np.ndarray, " time"]:
    """A time column in seconds; dates and durations count from their first row."""
    import pyarrow as pa
    import pyarrow.types as kinds

    column = _plain(column)
    kind = column.type
    if kinds.is_date(kind):
        column = column.cast(pa.timestamp("ms"))
        kind = column.type
    if kinds.is_timestamp(kind) or kinds.is_duration(kind) or kinds.is_time(kind):
        ticks = column.cast(pa.int32()) if kinds.is_time32(kind) else column
        ticks = ticks.cast(pa.int64())
        unit = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
        missing = column.is_null().to_numpy(zero_copy_only=False)
        ticks = ticks.fill_null(0).to_numpy(zero_copy_only=False)
        origin = ticks[~missing][:1]
        since = (ticks - origin) * unit if origin.size else ticks * unit
        return np.where(missing, np.nan, since)
    try:
        return numbers(column, channel=name, place=place).astype(np.float64)
    except DataError as error:
        raise DataError(
            f"{error} The time column must hold seconds, dates like "
            "2024-05-31 12:00:00.1, or durations.",
            channel=name,
            row=error.row,
        ) from None


def _plain(column):
    """One undivided array, without dictionary coding."""
    import pyarrow as pa
    import pyarrow.types as kinds

    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks)
    if kinds.is_dictionary(column.type):
        column = column.dictionary_decode()
    return column


def _text_kinds():
    import pyarrow.types as kinds

    # a CSV column that is not UTF-8 arrives as binary
    return (
        kinds.is_string,
        kinds.is_large_string,
        kinds.is_string_view,
        kinds.is_binary,
        kinds.is_large_binary,
    )


def _text(column, channel: str, place: Place) -> DataError:
    values = [
        v.decode("cp1252", "replace") if isinstance(v, bytes) else v
        for v in column.to_pylist()
    ]
    row, odd = next(
        ((i, v) for i, v in enumerate(values) if v is not None and not _is_number(v)),
        (0, values[0]),
    )
    labels = sorted({v for v in values if v is not None and not _is_number(v)})
    shown = ", ".join(repr(v[:40]) for v in labels[:8]) + (
        ", ..." if labels[8:] else ""
    )
    if labels and all(DECIMAL_COMMA.fullmatch(v) for v in labels):
        advice = 'These are numbers with a decimal comma: state decimal = ",".'
    elif len(labels) < len(values) / 2 and any(map(_is_number, filter(None, values))):
        advice = "Correct these cells, or empty them where the sample is missing."
    else:
        advice = "Choose a numeric channel, or replace the labels by numbers."
    return DataError(
        f"{place.lead}channel {channel} holds text: {shown}; first {odd[:40]!r} at "
        f"{place.row(row)}. {advice}",
        channel=channel,
        row=row,
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
