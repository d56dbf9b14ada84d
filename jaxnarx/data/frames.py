"""Rows of records from pandas, polars and pyarrow tables."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxnarx.data.channels import Channels
from jaxnarx.data.missing import Source, unify_types
from jaxnarx.data.readers.columns import Table, table_source
from jaxnarx.data.record import RowSource
from jaxnarx.data.sampling import positive_sample_time, require_time_unit
from jaxnarx.errors import DataError, SpecError, suggest


def frame_sources(
    frame: Any,
    channels: Channels,
    *,
    sample_time: float | int | None,
    time: str | None,
    time_unit: str | None,
    split: bool,
    record: str | None,
) -> tuple[list[Source], float]:
    """The rows of every record of `Dataset.from_frame`, and their sample time [s]."""
    if sample_time is None and time is None:
        raise SpecError(
            "give sample_time in seconds, or the name of a time column as time",
            field="sample_time",
        )
    if sample_time is not None:
        sample_time = positive_sample_time(sample_time)
    require_time_unit(time_unit)
    wanted = channels.names + [c for c in (time, record) if c is not None]
    table = _arrow(frame, list(dict.fromkeys(wanted)))
    parts = [
        table_source(
            Table(dict(zip(rows.column_names, rows.columns, strict=True)), place),
            channels,
            {},
            name=name,
            time=time,
            time_unit=time_unit,
            sample_time=sample_time,
            split=split,
        )
        for name, rows, place in _pieces(table, record)
    ]
    step = one_sample_time([(s.name, dt) for s, dt in parts])
    return unify_types([s for s, _ in parts]), step


def one_sample_time(steps: Sequence[tuple[str, float]]) -> float:
    """The sample time [s] that all records share to 0.1 %, else DataError."""
    name, first = steps[0]
    for other, step in steps[1:]:
        if abs(step - first) > 1e-3 * first:
            raise DataError(
                f"{name} is sampled every {first:.6g} s, but {other} every "
                f"{step:.6g} s. Resample them to one sample time, or read them apart."
            )
    return first


def _arrow(frame, wanted: list[str]):
    """The wanted columns as a pyarrow table, by whichever road the frame offers."""
    names = [str(c) for c in _column_names(frame)]
    for name in wanted:
        if names.count(name) != 1:
            raise SpecError(
                f"the frame has {names.count(name)} columns named {name!r}. "
                + (suggest(name, names) if name not in names else "Rename one."),
                field=name,
            )
    return _convert(frame, wanted)


def _column_names(frame):
    for attribute in ("column_names", "columns"):
        names = getattr(frame, attribute, None)
        if names is not None:
            return names
    raise SpecError(
        f"expected a pandas, polars or pyarrow table, got {type(frame).__name__}; for "
        "arrays use Dataset.from_arrays",
        field="frame",
    )


def _convert(frame, wanted):
    import pyarrow as pa

    if isinstance(frame, pa.Table):
        return frame.select(wanted)
    try:
        if hasattr(frame, "to_arrow"):
            return frame.select(wanted).to_arrow()
        return pa.Table.from_pandas(frame[wanted], preserve_index=False)
    except (pa.ArrowException, TypeError, ValueError, OverflowError) as error:
        raise SpecError(
            f"a column of the frame mixes kinds of values ({error}). Convert it to "
            "numbers, with NaN where a sample is missing.",
            field="frame",
        ) from error


def _pieces(table, record: str | None):
    """(name, rows, place) of every record; a record's rows must be together."""
    if record is None:
        return [("record 1", table, RowSource())]
    values = table.column(record).to_pylist()
    bounds = np.cumsum([0] + [len(list(g)) for _, g in itertools.groupby(values)])
    found: dict[str, int] = {}
    pieces = []
    for first, stop in itertools.pairwise(bounds.tolist()):
        name = str(values[first])
        if name in found:
            raise DataError(
                f"record {name!r} ends before row {first} where it begins again (its "
                f"first row is {found[name]}). Sort the frame by {record!r}, or give "
                "the two runs different names.",
                row=first,
            )
        found[name] = first
        pieces.append((name, table.slice(first, stop - first), RowSource(name, first)))
    return pieces
