"""Columns of a table, as numbers; text and dates are refused with what they hold."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data.channels import Channels
from jaxnarx.data.missing import Source
from jaxnarx.data.record import RowSource
from jaxnarx.data.sampling import TIME_UNITS, find_sampling, time_unit_in
from jaxnarx.errors import DataError, DataFileError


@dataclasses.dataclass(frozen=True)
class CsvLayout:
    """The layout of the CSV files of a description; `None` and "" are found out.

    `columns` names the columns of files without a header line; `skip_rows` lines stand
    before the header; `unit_row` says that a line of units follows it.
    """

    columns: tuple[str, ...] = ()
    decimal: str = "."
    delimiter: str = ""
    encoding: str = "utf-8"
    skip_rows: int = 0
    unit_row: bool = False


@dataclasses.dataclass(frozen=True)
class Asked:
    """The part of a description that every reader needs.

    `table` names the sheet, variable or group of files that hold several; `sample_time`
    [s] is wanted of files whose channels have rasters of their own.
    """

    layout: CsvLayout = CsvLayout()
    table: str = ""
    sample_time: float | None = None
    max_bytes: float = 4e9


@dataclasses.dataclass(frozen=True)
class Column:
    """One column or channel of a file, before it is read.

    `table` is where in the file it is, `step` [s] its raster where it has one of its
    own; `text` marks columns of labels.
    """

    name: str
    unit: str = ""
    rows: int = 0
    table: str = ""
    step: float | None = None
    text: bool = False


SMALL_BYTES, MOST_TIMES = 64e6, 1000
"""A file that unfolds to more bytes, and by more times, is taken for a bomb."""


def require_size(
    path: Path, expanded: int | float, max_bytes: float, times: int = MOST_TIMES
) -> None:
    """Refuse what takes too much when unfolded, or unfolds like no measurement."""
    require_limit(path, expanded, max_bytes)
    if expanded > max(SMALL_BYTES, times * path.stat().st_size):
        raise DataFileError(
            f"{path}: {expanded / 1e9:.3g} GB when read, more than {times:,} times "
            "the size of the file. Measurements are not as uniform as that, so it is "
            "not read; write it as CSV if they are.",
            path=path,
        )


def require_limit(path: Path, expanded: int | float, max_bytes: float) -> None:
    """DataFileError where a file takes more than `max_bytes` when read."""
    if expanded > max_bytes:
        raise DataFileError(
            f"{path}: about {expanded / 1e9:.3g} GB when read, over the limit of "
            f"{max_bytes / 1e9:.3g} GB. Read fewer files or channels, or raise "
            "max_bytes.",
            path=path,
        )


DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*")


@dataclasses.dataclass(frozen=True, eq=False)
class Table:
    """Wanted columns of one source: arrow arrays by name, and units if it states any.

    `time` [s] is that of the rows where the source has one without a column for it;
    `notes` tell what was done to the columns to bring them there. Every reader ends
    here.
    """

    columns: Mapping[str, Any]
    place: RowSource
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    time: Float[np.ndarray, " time"] | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))


def table_source(
    table: Table,
    channels: Channels,
    columns: Mapping[str, str],
    *,
    name: str,
    time: str | None,
    time_unit: str | None,
    sample_time: float | None,
    split: bool,
) -> tuple[Source, float]:
    """One record from a table, and its sample time [s].

    `columns` maps channel names to column names (the same name where absent). At least
    one of `time` (a column), `sample_time` and `table.time` is given.
    """
    parts = [
        numbers(table.columns[columns.get(n, n)], channel=n, place=table.place)
        for n in channels.names
    ]
    cuts: Sequence[int] = ()
    t, unit = table.time, "s"
    if time is not None:
        unit = time_unit or time_unit_in(table.units.get(time, ""), time)
        t, unit = seconds(table.columns[time], name=time, place=table.place, unit=unit)
    if t is not None:
        sample_time, cuts = find_sampling(
            t,
            column=time or "of the file",
            place=table.place,
            sample_time=sample_time,
            split=split,
            unit=unit,
        )
    assert sample_time is not None
    return Source(name, np.stack(parts, axis=1), table.place, cuts), sample_time


def numbers(
    column: Any, *, channel: str, place: RowSource
) -> Float[np.ndarray, " time"]:
    """An arrow column as float32 (if it is) or float64, with NaN for nulls.

    Text is read where all of it are numbers. Labels, dates and nested values raise
    DataError naming what was found.
    """
    import pyarrow as pa
    import pyarrow.types as kinds

    column = _flatten_column(column)
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
    if is_text(kind):
        return _numbers_in_text(column, channel, place)
    raise DataError(
        f"{place.lead}channel {channel} holds {kind} values, not numbers. Leave it "
        "out, or convert it to numbers first.",
        channel=channel,
    )


def seconds(
    column: Any, *, name: str, place: RowSource, unit: str | None = None
) -> tuple[Float[np.ndarray, " time"], str | None]:
    """A time column in seconds, and the unit it is in if that is known.

    Dates and durations count from their first row and know theirs; numbers are taken
    to be in `unit`, or else in seconds.
    """
    import pyarrow as pa
    import pyarrow.types as kinds

    column = _flatten_column(column)
    kind = column.type
    if kinds.is_date(kind):
        column = column.cast(pa.timestamp("ms"))
        kind = column.type
    if kinds.is_timestamp(kind) or kinds.is_duration(kind) or kinds.is_time(kind):
        ticks = column.cast(pa.int32()) if kinds.is_time32(kind) else column
        ticks = ticks.cast(pa.int64())
        scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
        missing = column.is_null().to_numpy(zero_copy_only=False)
        ticks = ticks.fill_null(0).to_numpy(zero_copy_only=False)
        origin = ticks[~missing][:1]
        since = (ticks - origin) * scale if origin.size else ticks * scale
        return np.where(missing, np.nan, since), kind.unit
    if is_text(kind):
        moments = _moments(column)
        if moments is not None:
            return moments, "s"
    try:
        t = numbers(column, channel=name, place=place).astype(np.float64)
        return t * TIME_UNITS[unit or "s"], unit
    except DataError as error:
        raise DataError(
            f"{error} The time column must hold seconds, dates like "
            "2024-05-31 12:00:00.1, or durations.",
            channel=name,
            row=error.row,
        ) from None


_DATE_FORMATS = (
    "%d.%m.%Y %H:%M:%S",
    "%m/%d/%Y %H:%M:%S",
    "%Y/%m/%d %H:%M:%S",
    "%H:%M:%S",
)
"""How dates and times of day are written that pyarrow does not take by itself."""


def _moments(column) -> Float[np.ndarray, " time"] | None:
    """Seconds from the first row of texts that are all moments in one of these ways,
    with fractions of a second behind a point or a comma."""
    import pyarrow as pa
    import pyarrow.compute

    pc: Any = pyarrow.compute  # made when it is loaded: no checker knows what is there
    text = pc.utf8_trim_whitespace(column.cast(pa.string()))
    parts = pc.extract_regex(text, r"^(?P<whole>.*:\d{2})(?:[.,](?P<part>\d+))?$")
    if parts.null_count > text.null_count or text.null_count == len(text):
        return None
    whole, part = (pc.struct_field(parts, k) for k in ("whole", "part"))
    fraction = pc.if_else(pc.equal(part, ""), "0", part)
    fraction = pc.cast(pc.binary_join_element_wise("0", fraction, "."), pa.float64())
    for form in _DATE_FORMATS:
        ticks = pc.strptime(whole, format=form, unit="s", error_is_null=True)
        if ticks.null_count > text.null_count:
            continue
        t = ticks.cast(pa.int64()).to_numpy(zero_copy_only=False).astype(np.float64)
        t = t - t[np.isfinite(t)][0] + fraction.to_numpy(zero_copy_only=False)
        if form == "%H:%M:%S":  # midnight begins the day anew
            t = t + 86_400 * np.cumsum(np.diff(t, prepend=t[:1]) < -43_200)
        first = t[np.isfinite(t)][:1]
        return t - first
    return None


def _flatten_column(column):
    """One undivided array, without dictionary coding."""
    import pyarrow as pa
    import pyarrow.types as kinds

    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks)
    if kinds.is_dictionary(column.type) and not is_text(column.type):
        column = column.dictionary_decode()
    return column


def is_text(kind: Any) -> bool:
    """Whether an arrow type holds text, also where every text is kept once."""
    import pyarrow.types as kinds

    if kinds.is_dictionary(kind):
        kind = kind.value_type
    # a CSV column that is not UTF-8 arrives as binary
    return (
        kinds.is_string(kind)
        or kinds.is_large_string(kind)
        or kinds.is_string_view(kind)
        or kinds.is_binary(kind)
        or kinds.is_large_binary(kind)
    )


def is_readable(kind: Any) -> bool:
    """Whether an arrow type may hold one number, time or text a row."""
    import pyarrow.types as kinds

    if kinds.is_dictionary(kind):
        return is_readable(kind.value_type)
    return (
        is_text(kind)
        or kinds.is_null(kind)
        or kinds.is_boolean(kind)
        or kinds.is_floating(kind)
        or kinds.is_integer(kind)
        or kinds.is_decimal(kind)
        or kinds.is_temporal(kind)
    )


def _numbers_in_text(column, channel: str, place: RowSource) -> np.ndarray:
    """Text as numbers; DataError with the labels found where it is anything else."""
    import pyarrow as pa
    import pyarrow.types as kinds

    if kinds.is_string_view(column.type):
        column = column.cast(pa.large_string())
    if not kinds.is_dictionary(column.type):
        column = column.dictionary_encode()
    values = [
        v.decode("cp1252", "replace") if isinstance(v, bytes) else v
        for v in column.dictionary.to_pylist()
    ]
    # a null has the last place
    at = column.indices.fill_null(len(values)).to_numpy(zero_copy_only=False)
    good = np.array([v is None or is_number(v) for v in values] + [True])
    if not good[at].all():
        raise _text(values, at, good, channel, place)
    known = [float(v) if v and is_number(v) else np.nan for v in values]
    return np.array([*known, np.nan])[at]


def _text(values, at, good, channel: str, place: RowSource) -> DataError:
    row = int(np.argmin(good[at]))
    odd, labels = values[at[row]], sorted(values[i] for i in set(at[~good[at]]))
    shown = ", ".join(repr(v[:40]) for v in labels[:8]) + (
        ", ..." if labels[8:] else ""
    )
    if labels and all(DECIMAL_COMMA.fullmatch(v) for v in labels):
        advice = 'These are numbers with a decimal comma: state decimal = ",".'
    elif good[at[at < len(values)]].mean() > 0.5:
        advice = "Correct these cells, or empty them where the sample is missing."
    else:
        advice = "Choose a numeric channel, or replace the labels by numbers."
    return DataError(
        f"{place.lead}channel {channel} holds text: {shown}; first {odd[:40]!r} at "
        f"{place.row(row)}. {advice}",
        channel=channel,
        row=row,
    )


def is_number(text: str, decimal: str = ".") -> bool:
    """Whether `text` is a number as files write it (Python also takes 1_000)."""
    try:
        float(text.replace(decimal, "."))
    except ValueError:
        return False
    return "_" not in text
