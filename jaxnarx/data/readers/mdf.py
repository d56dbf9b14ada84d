"""Measurement files of the ASAM standard, MDF 3 and 4, by asammdf.

They are read in a process of their own (`jaxnarx.data.readers.apart`). A channel that
several groups hold is asked for as `"n_mot @ group 3"`; the device behind a name
(`n_mot\\XCP:1`) may be left out where that is clear.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxnarx.data.readers.apart import Apart
from jaxnarx.data.readers.columns import Asked, Column, Table
from jaxnarx.data.readers.rasters import Signal, one_raster
from jaxnarx.data.record import RowSource
from jaxnarx.errors import DataFileError

_APART: list[Apart] = []
"""The process that reads, once there is one."""


def contents(path: Path, asked: Asked) -> list[Column]:
    """Every channel of every group with a time."""
    found = _ask(path, "contents")
    return [Column(**one) for one in found]


def read(path: Path, wanted: Sequence[str], asked: Asked) -> Table:
    """The `wanted` channels on one raster."""
    answer = _ask(path, "signals", wanted=list(wanted), max_bytes=asked.max_bytes)
    place = RowSource(str(path), 1, ", counted from 1")
    times: dict[str, Any] = {}
    signals = []
    for k, one in enumerate(answer["signals"]):
        key = one["time"]
        times.setdefault(key, _APART[0].array(key))
        values, valid = (_APART[0].array(f"{what}{k}") for what in ("x", "valid"))
        labels = tuple(one["labels"])
        signals.append(
            Signal(one["name"], times[key], values, valid, one["unit"], labels)
        )
    table = one_raster(signals, place, asked.sample_time)
    notes = tuple(answer["notes"])
    return Table(table.columns, place, table.units, table.time, notes + table.notes)


def _ask(path: Path, function: str, **given: Any) -> Any:
    with path.open("rb") as file:
        begin = file.read(8)
    if not begin.startswith((b"MDF", b"UnFinMF")):
        raise DataFileError(
            f"{path}: this is no MDF file, it does not begin like one. Call it what it "
            "is, or export it anew.",
            path=path,
        )
    if not _APART:
        _APART.append(Apart())
    return _APART[0].ask("mdf_groups", function, path, **given)
