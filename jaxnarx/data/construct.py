"""Rows of records from arrays in memory."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.data.channels import Channels
from jaxnarx.data.missing import Source, unify_types
from jaxnarx.data.record import RowSource
from jaxnarx.errors import DataError, SpecError


def array_sources(
    u: Any, y: Any, channels: Channels, names: Sequence[str] | None
) -> list[Source]:
    """The rows of every record of `Dataset.from_arrays`, in one type."""
    if u is None and channels.inputs:
        raise SpecError(
            f"u is None, but inputs names {', '.join(channels.input_names)}. Give "
            "their samples as u, or inputs=[] for a series without inputs.",
            field="u",
        )
    ys = _records(y, channels.output_names, "y")
    us = _no_inputs(ys) if u is None else _records(u, channels.input_names, "u")
    if len(us) != len(ys):
        raise SpecError(
            f"u has {len(us)} record(s) and y has {len(ys)}; give one array of each "
            "per record",
            field="u",
        )
    labels = _labels(names, len(us))
    for label, a, b in zip(labels, us, ys, strict=True):
        _require_equal_length(a, b, label, channels, several=len(us) > 1)
    sources = [
        Source(label, np.concatenate(pair, axis=1), RowSource(label if names else ""))
        for label, *pair in zip(labels, us, ys, strict=True)
    ]
    return unify_types(sources)


def _records(data: Any, names: list[str], field: str) -> list[np.ndarray]:
    """One (time, channels) array per record; lists of arrays are several records."""
    if not isinstance(data, list | tuple):
        return [_matrix(data, names, field)]
    if not data:
        raise SpecError(
            f"{field} is an empty list; give at least one record", field=field
        )
    if all(not isinstance(d, list | tuple) and np.ndim(d) == 0 for d in data):
        return [_matrix(np.asarray(data), names, field)]
    if any(isinstance(d, list | tuple) or np.ndim(d) == 0 for d in data):
        raise SpecError(
            f"{field} is a nested list, which could be rows or records. Give "
            f"np.asarray({field}) of shape {_expected_shape(names)} for one record, or "
            "a list of such arrays for several.",
            field=field,
        )
    return [_matrix(d, names, f"{field}[{i}]") for i, d in enumerate(data)]


def _matrix(data: Any, names: list[str], field: str) -> Float[np.ndarray, "time names"]:
    x = _floats(data, names, field)
    n = len(names)
    if x.ndim == 1 and n == 1:
        return x[:, None]
    if x.ndim == 2 and x.shape[1] == n:
        return x
    what = f"{field} has shape {x.shape}, expected {_expected_shape(names)}. "
    if x.ndim == 2 and x.shape[0] == n:
        what += f"It looks transposed: pass {field}.T, rows are time."
    elif x.ndim == 3:
        what += f"For several records pass a list of arrays, list({field})."
    else:
        what += "Name every column, or pick the columns that are named."
    raise SpecError(what, field=field)


def _floats(data: Any, names: list[str], field: str) -> np.ndarray:
    if isinstance(data, np.ma.MaskedArray):
        # np.asarray drops the mask without a word
        plain = np.asarray(data.data)
        plain = plain.astype(np.result_type(plain.dtype, np.float32))
        data = np.where(np.ma.getmaskarray(data), np.nan, plain)
    try:
        x = np.asarray(data)
    except ValueError as error:
        raise SpecError(
            f"{field} is not an array of numbers ({error}); expected shape "
            f"{_expected_shape(names)}",
            field=field,
        ) from error
    if x.dtype.kind not in "fiub":
        raise SpecError(
            f"{field} holds {_REFUSED_KINDS.get(x.dtype.kind, str(x.dtype))}, "
            f"expected real numbers of shape {_expected_shape(names)}. Convert it "
            "first, with NaN where a sample is missing.",
            field=field,
        )
    return x if x.dtype == np.float32 else x.astype(np.float64)


_REFUSED_KINDS = {
    "c": "complex numbers",
    "O": "Python objects",
    "U": "text",
    "S": "bytes",
    "M": "dates",
    "m": "time differences",
}


def _expected_shape(names: list[str]) -> str:
    return f"(time, {len(names)}) for {', '.join(names) or 'no channel'}"


def _no_inputs(ys):
    return [np.zeros((len(y), 0), y.dtype) for y in ys]


def _labels(names: Sequence[str] | None, count: int) -> list[str]:
    if names is None:
        return [f"record {i + 1}" for i in range(count)]
    names = [names] if isinstance(names, str) else [str(n) for n in names]
    if len(names) != count or len(set(names)) != count:
        raise SpecError(
            f"names must hold one different name for each of the {count} record(s), "
            f"got {names}",
            field="names",
        )
    return names


def _require_equal_length(u, y, label, channels, *, several):
    if len(u) != len(y):
        where = f"{label}: " if several else ""
        raise DataError(
            f"{where}{', '.join(channels.input_names)} has {len(u)} rows and "
            f"{', '.join(channels.output_names)} has {len(y)}. Cut both to the same "
            "instants.",
            channel=channels.output_names[0],
        )
