"""Damaged files of all other formats: only own errors, in bounds of time and memory."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from battery import mutate
from scipy.io import savemat

from jaxnarx.data.readers import contents, read_table
from jaxnarx.data.readers.columns import Asked, numbers
from jaxnarx.errors import JaxnarxError

ROWS = 60
WANTED = "t", "N", "NOx"


def columns() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    x = rng.standard_normal((2, ROWS))
    return {"t": 0.1 * np.arange(ROWS), "N": x[0], "NOx": x[1]}


def sheet(path) -> None:
    engine: Any = "odf" if path.suffix == ".ods" else "openpyxl"
    pd.DataFrame(columns()).to_excel(path, index=False, engine=engine)


def mdf(path) -> None:
    from asammdf import MDF, Signal

    found = columns()
    with MDF(version="4.10") as file:
        names = ("N", "NOx")
        file.append([Signal(found[n], found["t"], name=n, unit="x") for n in names])
        file.append([Signal(found["t"], found["t"], name="t")])
        file.save(path, overwrite=True, compression=2)


def mat(path) -> None:
    savemat(path, {"run": columns()}, do_compression=True)


def hdf5(path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, x in columns().items():
            file.create_dataset(f"run/{name}", data=x, compression="gzip")


def npz(path) -> None:
    found: dict[str, Any] = {**columns()}
    np.savez_compressed(path, **found)


WRITERS = {"xlsx": sheet, "ods": sheet, "mf4": mdf, "mat": mat, "h5": hdf5}
WRITERS |= {"npz": npz}


@pytest.mark.parametrize("kind", WRITERS)
def test_damaged_files(kind, tmp_path, battery):
    path = tmp_path / f"a.{kind}"
    WRITERS[kind](path)
    raw = path.read_bytes()

    def attempt(rng):
        path.write_bytes(mutate(raw, rng))
        try:
            asked = Asked(sample_time=0.1)
            for column in contents(path, asked):
                assert isinstance(column.name, str)
            table = read_table(path, WANTED, asked)
            for name in WANTED:
                x = numbers(table.columns[name], channel=name, place=table.place)
                assert x.ndim == 1 and len(x) == len(table)
        except JaxnarxError as error:
            assert "a." in str(error) and len(str(error)) < 3000
            raise

    ends = battery.run(attempt)
    assert battery.cases < 100 or {"done", "DataFileError"} <= set(ends)
