"""One writer for every file format that is read: columns with their units."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
import pandas as pd
import polars as pl
import pytest
from scipy.io import savemat

mf4_rs = pytest.importorskip("mf4_rs")
pytest.importorskip("python_calamine")

Columns = dict[str, np.ndarray]


def csv(path: Path, columns: Columns, units: dict[str, str]) -> None:
    lines = [",".join(columns), ",".join(units[name] for name in columns)]
    lines += [",".join(map(repr, row)) for row in zip(*lists(columns), strict=True)]
    path.write_text("\n".join(lines) + "\n", "utf-8")


def lists(columns: Columns) -> list[list[float]]:
    return [x.tolist() for x in columns.values()]


def parquet(path: Path, columns: Columns, units: dict[str, str]) -> None:
    pl.DataFrame(columns).write_parquet(path)


def xlsx(path: Path, columns: Columns, units: dict[str, str]) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    sheet.append(list(columns))
    sheet.append([units[name] for name in columns])
    for row in zip(*lists(columns), strict=True):
        sheet.append(row)
    book.save(path)


def ods(path: Path, columns: Columns, units: dict[str, str]) -> None:
    engine: Any = "odf"
    pd.DataFrame(columns).to_excel(path, index=False, engine=engine)


def mf4(path: Path, columns: Columns, units: dict[str, str]) -> None:
    writer = mf4_rs.MdfWriter(str(path))
    writer.init_mdf_file()
    group = writer.add_channel_group("bench")
    writer.add_time_channel(group, "time")
    for name in list(columns)[1:]:
        writer.add_float_channel(group, name)
    writer.start_data_block(group)
    writer.write_columns_f64(group, [np.ascontiguousarray(x) for x in columns.values()])
    writer.finish_data_block(group)
    writer.finalize()


def mat(path: Path, columns: Columns, units: dict[str, str]) -> None:
    names = np.array(list(columns), object)
    told = np.array([units[name] for name in columns], object)
    matrix = np.stack(list(columns.values()), axis=1)
    savemat(path, {"data": matrix, "names": names, "units": told})


def hdf5(path: Path, columns: Columns, units: dict[str, str]) -> None:
    with h5py.File(path, "w") as file:
        for name, x in columns.items():
            data = file.create_dataset(f"run/{name}", data=x, compression="gzip")
            data.attrs["units"] = units[name]


def npz(path: Path, columns: Columns, units: dict[str, str]) -> None:
    found: dict[str, Any] = dict(columns)
    np.savez_compressed(path, **found)


WRITERS = {f.__name__: f for f in (csv, parquet, xlsx, ods, mf4, mat, npz)}
WRITERS["h5"] = hdf5
NO_TIME_COLUMN = ("mf4", "h5")
"""These bring their time themselves."""
