"""Excel and OpenDocument spreadsheets.

The first sheet that holds numbers is read, or the one that `table` names. Names stand
in the first row behind `skip_rows`, units in the next where it holds text and the one
below numbers. They are read in a process of their own (`jaxnarx.data.readers.sandbox`).
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxnarx.data.readers.columns import Asked, Column, Table
from jaxnarx.data.readers.sandbox import ask, table_file
from jaxnarx.data.record import RowSource


def contents(path: Path, asked: Asked) -> list[Column]:
    """Every named column of every sheet that has any."""
    found = ask("spreadsheet_cells", "contents", path, **_settings_table(asked))
    return [Column(**one) for one in found]


def read(path: Path, wanted: Sequence[str], asked: Asked) -> Table:
    """The `wanted` columns of one sheet; empty cells and errors are missing samples."""
    words = {"wanted": list(wanted), **_settings_table(asked)}
    answer = ask("spreadsheet_cells", "columns", path, **words)
    columns = table_file("cells.arrow", path, asked.max_bytes)
    place = RowSource(
        f"{path}, sheet {answer['sheet']}",
        answer["first"],
        ", as the sheet counts them",
    )
    return Table(columns, place, answer["units"])


def _settings_table(asked: Asked) -> dict[str, Any]:
    return dataclasses.asdict(asked)
