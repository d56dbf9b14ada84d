"""Datasets from pandas, polars and pyarrow tables."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxnarx.data.channels import Channel
from jaxnarx.data.columns import Table, table_source
from jaxnarx.data.construct import alike, make_channels
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.missing import assemble, require_missing
from jaxnarx.data.place import Place
from jaxnarx.data.sampling import positive_sample_time, require_time_unit
from jaxnarx.errors import DataError, SpecError, suggest


def from_frame(
    frame: Any,
    *,
    inputs: Sequence[str | Channel],
    outputs: Sequence[str | Channel],
    sample_time: float | int | None = None,
    time: str | None = None,
    time_unit: str | None = None,
    units: Mapping[str, str] | None = None,
    missing: str = "refuse",
    record: str | None = None,
) -> Dataset:
    """See `Dataset.from_frame`."""
    require_missing(missing)
    if sample_time is None and time is None:
        raise SpecError(
            "give sample_time in seconds, or the name of a time column as time",
            field="sample_time",
        )
    if sample_time is not None:
        sample_time = positive_sample_time(sample_time)
    require_time_unit(time_unit)
    channels = make_channels(inputs, outputs, units)
    wanted = channels.names + [c for c in (time, record) if c is not None]
    table = _arrow(frame, list(dict.fromkeys(wanted)))
    pieces = _pieces(table, record)
    parts = [
        table_source(
            Table(dict(zip(rows.column_names, rows.columns, strict=True)), place),
            channels,
            {},
            name=name,
            time=time,
            time_unit=time_unit,
            sample_time=sample_time,
            split=missing == "split",
        )
        for name, rows, place in pieces
    ]
    step = one_sample_time([(s.name, dt) for s, dt in parts])
    sources = alike([s for s, _ in parts])
    return assemble(sources, channels, sample_time=step, missing=missing)


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
        return [("record 1", table, Place())]
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
        pieces.append((name, table.slice(first, stop - first), Place(name, first)))
    return pieces
