"""Measurement files of the ASAM standard, MDF 3 and 4, by asammdf.

They are read in a process of their own (`jaxnarx.data.readers.sandbox`). A channel that
several groups hold is asked for as `"n_mot @ group 3"`; the device behind a name
(`n_mot\\XCP:1`) may be left out where that is clear.
"""

from collections.abc import Sequence
from pathlib import Path

from jaxnarx.data.readers.columns import Asked, Column, Table
from jaxnarx.data.readers.sandbox import ask, read_isolated_table


def contents(path: Path, asked: Asked) -> list[Column]:
    """Every channel of every group with a time."""
    return [Column(**one) for one in ask("mdf_groups", "contents", path)]


def read(path: Path, wanted: Sequence[str], asked: Asked) -> Table:
    """The `wanted` channels on one raster."""
    return read_isolated_table("mdf_groups", path, wanted, asked)
