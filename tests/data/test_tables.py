"""Parquet files and kinds of files that are not read: types, sizes, advice."""

import resource
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as parquet
import pytest
from common import some
from described import refuse, write

from jaxnarx.data import Dataset, read
from jaxnarx.errors import DataError, DataFileError


@pytest.fixture(autouse=True)
def no_environment(monkeypatch):
    monkeypatch.delenv("JAXNARX_DATA", raising=False)


def store(folder, columns, **options):
    """A description of one Parquet file with these columns in place of good ones."""
    good = {name: np.arange(20.0) for name in ("N", "Md", "NOx")}
    parquet.write_table(pa.table(good | columns), folder / "a.parquet", **options)
    return write(folder, None, records='files = ["a.parquet"]')


# kinds of columns -----------------------------------------------------------------


@pytest.mark.parametrize(
    "column",
    [
        pa.array([f"{i}.5" for i in range(20)]),
        pa.array([f"+{i}.5" for i in range(20)], pa.large_string()),
        pa.array([f"{i}.50" for i in range(20)], pa.string_view()),
        pa.array([f"{i}.5".encode() for i in range(20)]),
        pa.array([f"{i % 20}.5" for i in range(20)]).dictionary_encode(),
    ],
    ids=str,
)
def test_numbers_stored_as_text_are_numbers(tmp_path, column):
    frame = pa.table({"N": column, "y": np.arange(20.0)})
    data = Dataset.from_frame(frame, inputs=["N"], outputs=["y"], sample_time=1)
    np.testing.assert_array_equal(data.records[0].u[:, 0], np.arange(20) + 0.5)
    if column.type != pa.string_view():  # which is not written
        record = read(store(tmp_path, {"N": column})).records[0]
        np.testing.assert_array_equal(record.u[:, 0], np.arange(20) + 0.5)


def test_labels_among_numbers_in_text_are_named(tmp_path):
    column = [None, "1.5", "err", "2"] * 5
    said = ["channel N holds text: 'err'; first 'err' at row 3", "Correct these cells"]
    refuse(DataError, store(tmp_path, {"N": column}), *said)
    refuse(
        DataError, store(tmp_path, {"N": ["1_000"] * 20}), "holds text: '1_000'; first"
    )


@pytest.mark.parametrize("kind", [pa.string(), pa.null(), pa.float64(), pa.int32()])
def test_a_column_of_nulls_has_no_valid_sample_whatever_its_type(tmp_path, kind):
    path = store(tmp_path, {"N": pa.nulls(20, kind)})
    error = refuse(DataError, path, "N has no valid sample at all")
    assert error.channel == "N"


@pytest.mark.parametrize(
    "column",
    [
        pa.array([[1.0, 2.0]] * 20),
        pa.array([{"a": 1.0}] * 20),
        pa.array([[1.0, 2.0]] * 20, pa.list_(pa.float64(), 2)),
        pa.array([b"12345678"] * 20, pa.binary(8)),
    ],
    ids=str,
)
def test_nested_columns_are_refused_before_reading(tmp_path, column):
    path = store(tmp_path, {"N": column})
    refuse(DataFileError, path, "a.parquet: column 'N' holds", "not one number a row")
    # only where they are asked for
    path = store(tmp_path, {"other": column})
    assert read(path).samples == 20


def test_a_dot_in_a_name_is_a_part_of_it(tmp_path):
    path = store(tmp_path, {"Md.x": np.arange(20.0)})
    path.write_text(path.read_text().replace('"Md"', '"Md.x"'))
    assert read(path).samples == 20
    error = "GB when read, over the limit"
    refuse(DataFileError, path, error, max_bytes=400.0)


# bombs ----------------------------------------------------------------------------


def bomb(folder, kind):
    """A small file that would take gigabytes, and what is said of it."""
    if kind == "lists":
        column = pa.array([np.zeros(4_000_000)] * 3)
        columns = {"N": column, "Md": [1.0] * 3, "NOx": [1.0] * 3}
        return store(folder, columns), "list<"
    if kind == "equal numbers":
        column = np.zeros(20_000_000)
        columns = {"N": column, "Md": column, "NOx": column}
        return store(folder, columns, compression="zstd"), "times the size of the file"
    text = "x" * 1_000_000
    if kind == "equal texts":
        column = pa.DictionaryArray.from_arrays(np.zeros(3000, np.int32), [text])
        columns = {"N": column, "Md": np.zeros(3000), "NOx": np.zeros(3000)}
        return store(folder, columns, compression="zstd"), "holds text: 'xxx"
    columns = {"N": [text] * 200, "Md": np.zeros(200), "NOx": np.zeros(200)}
    return store(
        folder,
        columns,
        compression="zstd",
        use_dictionary=False,
        column_encoding={"N": "DELTA_BYTE_ARRAY"},
    ), "column 'N' holds text, written as differences"


CHILD = """
import resource, sys
import pyarrow.parquet, numpy
from jaxnarx.data import read
from jaxnarx.errors import JaxnarxError
base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    read(sys.argv[1])
except JaxnarxError as error:
    print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base)
"""


def peak(path) -> tuple[str, float]:
    """What a fresh process says of a description, and its memory for it [MB]."""
    run = subprocess.run(
        [sys.executable, "-c", CHILD, path], capture_output=True, text=True, timeout=300
    )
    assert not run.returncode, run.stderr
    *said, kilobytes = run.stdout.strip().split("\n")
    return "\n".join(said), float(kilobytes) / 1024


BOMBS = "lists", "equal numbers", "equal texts", "deltas"


@pytest.mark.skipif(
    not hasattr(resource, "RUSAGE_SELF") or sys.platform != "linux",
    reason="memory is told in other units",
)
@pytest.mark.parametrize("kind", some(BOMBS, "lists", "equal texts"))
def test_small_files_that_grow_are_refused_in_little_memory(tmp_path, kind):
    path, expected = bomb(tmp_path, kind)
    assert (tmp_path / "a.parquet").stat().st_size < 500_000
    said, used = peak(path)
    assert expected in said
    assert used < 40  # they grow to 96, 480, 3,000 and 200 MB


@pytest.mark.skipif(sys.platform != "linux", reason="memory is told in other units")
@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_reading_takes_at_most_five_times_the_expanded_size(tmp_path, suffix):
    rng = np.random.default_rng(1)
    columns = {name: rng.standard_normal(1_000_000) for name in ("N", "Md", "NOx")}
    path = store(tmp_path, columns)
    if suffix == "csv":
        table = parquet.read_table(tmp_path / "a.parquet")
        csv.write_csv(table, tmp_path / "a.csv")
        path = write(tmp_path, None, records='files = ["a.csv"]')
    said, used = peak(path)
    assert not said
    # 24 MB of numbers, as text 60; 30 MB are pyarrow's
    assert used < 5 * (24 if suffix == "parquet" else 60) + 30


# other kinds ----------------------------------------------------------------------


def test_a_spreadsheet_in_disguise_is_told(tmp_path):
    begin = b"PK\x03\x04" + bytes(26) + b"[Content_Types].xml"
    path = write(tmp_path, begin, name="renamed.csv", records='files = ["renamed.csv"]')
    error = refuse(DataFileError, path, "renamed.csv", "spreadsheet", "Call it .xlsx")
    assert "Unpack" not in str(error)
