"""Columns over time as a file: CSV, Parquet, MATLAB or MDF4, with their units."""

import csv
import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Shaped

from jaxnarx.errors import DataFileError
from jaxnarx.files import cell, encodable


class Values(NamedTuple):
    """One column and its unit."""

    x: Shaped[np.ndarray, " time"]
    unit: str = ""


def write_columns(
    path: Path, columns: Mapping[str, Values], sample_time: float
) -> None:
    """Write by the suffix of `path`; the first column is the time [s]."""
    writer = {".parquet": _parquet, ".mat": _mat, ".mf4": _mf4}.get(path.suffix)
    if writer is None:
        write_text(
            path, table_csv(list(columns), [c.x.tolist() for c in columns.values()])
        )
    else:
        writer(path, columns, sample_time)


def _parquet(path: Path, columns: Mapping[str, Values], sample_time: float) -> None:
    """Units are in the metadata of the fields."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    arrays = [pa.array(c.x) for c in columns.values()]
    fields = [
        pa.field(name, array.type, metadata={"unit": c.unit})
        for (name, c), array in zip(columns.items(), arrays, strict=True)
    ]
    parquet.write_table(pa.table(arrays, schema=pa.schema(fields)), path)


def plain_names(names: Sequence[str]) -> list[str]:
    """The names as words of up to 50 letters, digits and `_`, no two alike."""
    found: dict[str, None] = {}
    for name in names:
        word = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "x"
        word = (word if word[0].isalpha() else f"x{word}")[:50]
        tries = (f"{word}{n or ''}" for n in range(len(names) + 1))
        found[next(w for w in tries if w not in found)] = None
    return list(found)


def _mat(path: Path, columns: Mapping[str, Values], sample_time: float) -> None:
    """A variable for each column, called as MATLAB allows, and `names` and `units` of
    them as they are."""
    from scipy.io import savemat

    words = plain_names(list(columns))
    found: dict[str, Any] = {
        word: column.x[:, None]
        for word, column in zip(words, columns.values(), strict=True)
    }
    names, units = list(columns), [c.unit for c in columns.values()]
    found["names"] = np.array(names, object)[:, None]
    found["units"] = np.array(units, object)[:, None]
    savemat(path, found | {"sample_time": sample_time}, do_compression=True)


def _mf4(path: Path, columns: Mapping[str, Values], sample_time: float) -> None:
    """One group; the first column is its master."""
    try:
        from asammdf import MDF, Signal
    except ImportError:
        raise DataFileError(
            f"{path}: MDF files are written with the package asammdf, which is not "
            'installed: pip install "jaxnarx[mdf]".',
            path=path,
        ) from None
    time, *rest = columns.values()
    stamps = np.asarray(time.x, float)
    signals = [
        Signal(np.asarray(c.x), stamps, unit=c.unit, name=name)
        for name, c in zip(list(columns)[1:], rest, strict=True)
    ]
    with MDF(version="4.10") as mdf:
        mdf.append(signals, comment="jaxnarx")
        mdf.save(path, overwrite=True, compression=2)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8, with escapes for what it does not have (odd bytes of file names)."""
    path.write_bytes(encodable(text).encode("utf-8"))


def json_text(value: Any) -> str:
    """The file of a value; numbers that are none are null."""
    return json.dumps(_finite(value), allow_nan=False, indent=1) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def table_csv(header: list[str], columns: list[list]) -> str:
    """Columns of equal length as CSV; what is not a number is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([cell(h) for h in header])
    for row in zip(*columns, strict=True):
        writer.writerow([_number(x) for x in row])
    return text.getvalue()


def _number(x: float | int) -> str:
    if isinstance(x, int):
        return str(x)
    return "" if math.isnan(x) else f"{x:.10g}"
