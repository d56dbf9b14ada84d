"""One folder for every format: the same records, and the same model, from each."""

from pathlib import Path
from typing import Any

import h5py
import jax
import numpy as np
import openpyxl
import pandas as pd
import polars as pl
import pytest
from scipy.io import savemat

import jaxnarx as jnx
from jaxnarx.data import read

mf4_rs = pytest.importorskip("mf4_rs")
pytest.importorskip("python_calamine")

NAMES = ("cold_1", "cold_2", "warm")
Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def engine():
    """Three records of the virtual engine of Crossley and Cook."""
    key = jax.random.key(7)
    bed = jnx.engines.CrossleyCook()
    return jnx.engines.records(bed, key, (220, 190, 260), names=NAMES)


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


@pytest.fixture(scope="module")
def found(engine, tmp_path_factory):
    """What is read of every format."""
    channels = engine.channels
    units = {c.name: c.unit for c in channels.inputs + channels.outputs}
    units |= {"time": "s"}
    every = {}
    for kind, write in WRITERS.items():
        folder = tmp_path_factory.mktemp(kind)
        for record in engine.records:
            x = np.concatenate([record.u, record.y], axis=1)
            time = engine.sample_time * np.arange(len(x))
            columns = {"time": time, **dict(zip(channels.names, x.T, strict=True))}
            write(folder / f"{record.name}.{kind}", columns, units)
        told = ["[data]", *([] if kind in NO_TIME_COLUMN else ['time = "time"'])]
        told += ["unit_row = true"] if kind == "csv" else []
        for what, names in (
            ("inputs", channels.input_names),
            ("outputs", channels.output_names),
        ):
            told.append(f"[channels.{what}]")
            told += [f'"{name}" = "{units[name]}"' for name in names]
        told.append(f'[records]\nfiles = ["*.{kind}"]')
        (folder / "d.toml").write_text("\n".join(told), "utf-8")
        every[kind] = read(folder / "d.toml", root=folder)
    return every


@pytest.mark.parametrize("kind", WRITERS)
def test_records_names_and_units_are_the_same(engine, found, kind):
    data = found[kind]
    assert data.channels == engine.channels
    assert data.sample_time == pytest.approx(engine.sample_time, rel=1e-9)
    assert [record.name for record in data.records] == list(NAMES)
    for own, record in zip(data.records, engine.records, strict=True):
        # a sheet holds fifteen digits
        np.testing.assert_allclose(own.u, record.u, rtol=1e-12)
        np.testing.assert_allclose(own.y, record.y, rtol=1e-12)


def test_the_model_is_the_same(engine, found):
    def chosen(data):
        own = jnx.polynomial_pool(
            data.channels, input_lags=(0, 1, 2), output_lags=(1, 2), degree=1
        )
        return jnx.select(own, data, jnx.ForwardOLS(max_terms=6)).value

    expected = chosen(engine)
    for kind, data in found.items():
        own = chosen(data)
        np.testing.assert_array_equal(own.index, expected.index, err_msg=kind)
        np.testing.assert_allclose(
            *(own.coefficient, expected.coefficient), rtol=1e-8, err_msg=kind
        )
