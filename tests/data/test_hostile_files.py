"""Small files that would take all memory, read other files or run their own text."""

import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from jaxnarx.data.readers import contents, read_table, sandbox
from jaxnarx.data.readers.columns import Asked
from jaxnarx.data.readers.mdf_formula import apply_formula
from jaxnarx.data.readers.spreadsheet_size import count_cells
from jaxnarx.errors import DataFileError

h5py = pytest.importorskip("h5py")
openpyxl = pytest.importorskip("openpyxl")


def refused(path: Path, *phrases: str, **asked) -> None:
    with pytest.raises(DataFileError) as caught:
        contents(path, Asked(**asked))
    for phrase in (path.name, *phrases):
        assert phrase in str(caught.value)


# HDF5 ---------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".h5", ".mat"])
def test_hdf5_that_leads_to_other_files_is_refused(tmp_path, suffix):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = np.arange(5.0)
    source = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", shape=(5,))
    layout = h5py.VirtualLayout(shape=(5,), dtype=float)
    layout[:] = source
    begin = b"MATLAB 7.3 MAT-file".ljust(512, b" ") if suffix == ".mat" else b""

    def link(file):
        file["run/x"] = h5py.ExternalLink("other.h5", "x")

    def store(file):
        file.create_dataset("x", (8,), "u1", external=[("/etc/hostname", 0, 8)])

    def combine(file):
        file.create_virtual_dataset("x", layout)

    written = {
        link: "run/x is a link to 'other.h5'",
        store: "stored in",
        combine: "put",
    }
    for write, phrase in written.items():
        path = tmp_path / f"a{suffix}"
        with h5py.File(path, "w", userblock_size=512 if begin else 0) as file:
            write(file)
        if begin:
            with path.open("r+b") as file:
                file.write(begin)
        refused(path, phrase, "is not followed", "Copy its samples")


def test_groups_that_hold_themselves_are_looked_into_once(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("g")
        group["x"] = np.arange(5.0)
        for k in range(12):
            group[f"again{k}"] = group
        file["soft"] = h5py.SoftLink("/g/x")
    assert [one.name for one in contents(path, Asked())] == ["x"]


def test_a_dataset_with_many_names_counts_as_often(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        x = file.create_dataset("x0", data=np.zeros(1000))
        for k in range(1, 50):
            file[f"x{k}"] = x
    refused(path, "over the limit", max_bytes=300e3)


def test_an_answer_over_the_limit_is_refused_here_too(tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    np.savez(path, x=np.arange(1000.0))
    monkeypatch.setattr(
        sandbox.SandboxedReader, "ask", lambda self, *a, **k: answer(self)
    )

    def answer(reader):
        reader.folder.mkdir(exist_ok=True)
        np.save(reader.folder / "x0.npy", np.zeros(10_000))
        one = {"name": "x", "unit": "", "time": None, "valid": True, "labels": []}
        return {"signals": [one], "notes": []}

    with pytest.raises(DataFileError, match="over the limit"):
        read_table(path, ["x"], Asked(max_bytes=50e3))


# Spreadsheets -------------------------------------------------------------------------


def workbook(path: Path, *places: str) -> Path:
    book = openpyxl.Workbook()
    for place in places:
        book.active[place] = 1.0
    book.save(path)
    return path


@pytest.mark.parametrize("place", ["XFD1048576", "BZ1000000"])
def test_a_cell_far_away_is_refused(tmp_path, place):
    refused(workbook(tmp_path / "a.xlsx", "A1", place), "far more", "Delete the cells")


def test_cells_are_counted_across_pieces_of_a_sheet(tmp_path, monkeypatch):
    path = workbook(tmp_path / "a.xlsx", *(f"{c}{r}" for c in "AC" for r in (1, 7)))
    for size in (10, 64, 1000):
        monkeypatch.setattr("jaxnarx.data.readers.spreadsheet_size._CHUNK_BYTES", size)
        assert count_cells(path) == 3 * 7


def test_rows_and_cells_that_tell_no_place_are_counted(tmp_path):
    path = tmp_path / "a.xlsx"
    rows = "<row r='700'><c/><c s=\"r\"/></row><row><c r = 'C701'/><c/></row><row/>"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("xl/worksheets/sheet1.xml", f"<sheetData>{rows}</sheetData>")
    assert count_cells(path) == 701 * 4


def test_repeated_cells_of_opendocument_are_counted(tmp_path, monkeypatch):
    path = tmp_path / "a.ods"
    row = '<table:table-row table:number-rows-repeated="%d">%s</table:table-row>'
    cell = '<table:table-cell%s table:number-columns-repeated="%d"/>'
    filled, empty = cell % (' office:value-type="float"', 50), cell % ("", 16384)
    with zipfile.ZipFile(path, "w") as archive:
        text = row % (200_000, filled) + row % (1_048_576, empty)
        archive.writestr("content.xml", text)
    for size in (10, 1 << 20):
        monkeypatch.setattr("jaxnarx.data.readers.spreadsheet_size._CHUNK_BYTES", size)
        assert count_cells(path) == 200_000 * 50
    refused(path, "far more")


def test_a_cell_behind_empty_ones_of_opendocument_counts_them(tmp_path):
    path, cell = tmp_path / "a.ods", '<table:table-cell office:value-type="float"/>'
    empty = '<table:table-cell table:number-columns-repeated="99"/>'
    behind = '<table:table-row table:number-rows-repeated="7"/>'
    sheet = f"<table:table>{behind}<table:table-row>{empty}{cell}</table:table-row>"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("content.xml", f"{sheet}{behind}</table:table>" * 2)
    assert count_cells(path) == 2 * 8 * 100


# MDF ----------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["4.10", "3.30"])
def test_formulas_of_mdf_files_are_read_or_refused(tmp_path, version):
    asammdf = pytest.importorskip("asammdf")
    t, raw = 0.1 * np.arange(20), np.arange(20, dtype=np.int16)
    x = "X1" if version > "4" else "X"
    formulas = {"good": f"2 * pow({x}, 2) + exp(-{x}/10)", "power": f"{x}^2"}
    formulas |= {"unknown": f"bogus({x})", "code": "__import__('os').getcwd()"}
    with asammdf.MDF(version=version) as mdf:
        mdf.append(
            [
                asammdf.Signal(raw, t, name=name, conversion={"formula": formula})
                for name, formula in formulas.items()
            ]
        )
        path = Path(mdf.save(tmp_path / "a", overwrite=True))
    found = read_table(path, ["good"], Asked(sample_time=0.1)).columns["good"]
    expected = 2.0 * raw.astype(float) ** 2 + np.exp(-raw / 10)
    np.testing.assert_allclose(found.to_numpy(), expected, rtol=1e-14)
    for name in ("power", "unknown", "code"):
        with pytest.raises(DataFileError, match=f"channel {name} .* Leave it out"):
            read_table(path, [name], Asked(sample_time=0.1))


def test_a_formula_has_no_value_where_it_has_no_finite_one():
    x = np.array([-1.0, 0.0, 4.0])
    np.testing.assert_array_equal(apply_formula("sqrt(X)", x), [np.nan, 0.0, 2.0])
    np.testing.assert_array_equal(apply_formula("1/X1", x), [-1.0, np.nan, 0.25])
    np.testing.assert_array_equal(apply_formula("7", x), [7.0] * 3)


@pytest.mark.parametrize(
    "formula",
    ["", "X +", "X.real", "X[0]", "True", "1j", "pow(X)", "9**9**9**9**9 + y"]
    + ["lambda: X", "'a'", "(" * 500 + "X" + ")" * 500, "X+" * 900 + "X"],
)
def test_no_other_formula_is_read(formula):
    with pytest.raises(ValueError):
        apply_formula(formula, np.arange(3.0))


# Limits of memory ---------------------------------------------------------------------

LIMIT = 4 * 10**9
"""Bytes of addresses; libraries reserve many that they never use."""
READ = f"""
import resource
resource.setrlimit(resource.RLIMIT_AS, ({LIMIT}, {LIMIT}))
import numpy as np
from pathlib import Path
from jaxnarx.data.readers import contents
from jaxnarx.data.readers.columns import Asked
print(contents(Path("a.npz"), Asked())[0].rows)
"""


def test_a_hard_limit_of_memory_that_is_there_already_is_kept(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.arange(7.0))
    done = subprocess.run(
        [sys.executable, "-c", READ],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.stdout.strip() == "7", done.stderr
