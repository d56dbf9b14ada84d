"""Files of named variables: MATLAB (4 to 7.3), HDF5 and NumPy's npz.

They are read in a process of their own (`jaxnarx.data.readers.sandbox`).
`variable_channels` finds the channels in them. A channel whose name is there several
times is asked for by its place (`"run1.speed"`), or by `table`, the variable it is in.
"""

from collections.abc import Sequence
from pathlib import Path

from jaxnarx.data.readers.columns import Asked, Column, Table
from jaxnarx.data.readers.sandbox import ask, read_isolated_table


def contents(path: Path, asked: Asked) -> list[Column]:
    """Every channel of every variable."""
    found = ask("variable_channels", "contents", path, max_bytes=asked.max_bytes)
    return [Column(**one) for one in found]


def read(path: Path, wanted: Sequence[str], asked: Asked) -> Table:
    """The `wanted` channels; with a time of the file on one raster."""
    return read_isolated_table(
        "variable_channels", path, wanted, asked, table=asked.table
    )
