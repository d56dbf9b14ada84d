"""CSV as test benches write it: the layout is found out, and reads the file."""

import numpy as np
import pyarrow as pa
import pytest

from jaxnarx.data import Channel, Channels, read_files
from jaxnarx.data.readers.columns import CsvLayout, seconds
from jaxnarx.data.readers.csv_layout import find_layout
from jaxnarx.data.record import RowSource

ROWS = np.array([[0.0, 1000, 3.5], [0.1, 1001, 3.25], [0.2, 1002, 3.75], [0.3, 999, 4]])


def rows(delimiter: str, decimal: str) -> str:
    lines = (delimiter.join(f"{x:g}" for x in row) for row in ROWS)
    return "".join(f"{line.replace('.', decimal)}\n" for line in lines)


FILES = {
    "inca": (
        "ETASAsciiItemFile\trecord\nsampleCount\t4\n\ntime\tN\tNOx\ns\t1/min\tppm\n"
        + rows("\t", "."),
        "utf-8",
        CsvLayout(delimiter="\t", skip_rows=3, unit_row=True),
    ),
    "avl": (
        "Prüfstand 7;Motor A\nDatum;24.11.2026\n\ntime;N;NOx\ns;1/min;ppm\n"
        + rows(";", ","),
        "cp1252",
        CsvLayout((), ",", ";", "cp1252", 3, True),
    ),
    "canape": (
        "# written by a logger\ntime,N,NOx\n" + rows(",", "."),
        "utf-8",
        CsvLayout(delimiter=",", skip_rows=1),
    ),
    "plain": (
        "time,N,NOx\n" + rows(",", "."),
        "utf-8-sig",
        CsvLayout(delimiter=","),
    ),
    "wide characters": (
        "time\tN\tNOx\n" + rows("\t", "."),
        "utf-16",
        CsvLayout(delimiter="\t", encoding="utf-16"),
    ),
    "with gaps": (
        "time;N;NOx\n0;1000;\n0,1;1001;3,25\n0,2;;3,75\n0,3;999;4\n",
        "utf-8",
        CsvLayout(decimal=",", delimiter=";"),
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_the_layout_is_found_and_reads_the_file(tmp_path, name):
    text, encoding, layout = FILES[name]
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    assert find_layout(tmp_path / "a.csv") == layout
    channels = Channels((Channel("N", "rpm"),), (Channel("NOx", "ppm"),))
    data = read_files([tmp_path / "a.csv"], channels, sample_time=0.1, missing="mask")
    (record,) = data.records
    known = record.valid
    np.testing.assert_array_equal(record.signals[known], ROWS[:, 1:][known])
    assert known.all() == (name != "with gaps") and known.sum() >= 6


@pytest.mark.parametrize(
    "text", ["", "hello\nworld\n", "1,2\n3,4\n5,6\n", "a;a\n1;2\n3;4\n5;6\n", "a\n1\n"]
)
def test_where_none_is_found_none_is_told(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    assert find_layout(tmp_path / "a.csv") is None


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["24.11.2026 23:59:59,9", "25.11.2026 00:00:00,0"], [0.0, 0.1]),
        (["11/24/2026 13:00:00", "11/24/2026 13:00:01"], [0.0, 1.0]),
        (["23:59:59.90", "00:00:00.15", None], [0.0, 0.25, np.nan]),
    ],
)
def test_moments_as_text_are_seconds(texts, expected):
    t, unit = seconds(pa.array(texts), name="t", place=RowSource())
    # days since 1970 and their fractions are kept apart: exact to the clock's digits
    np.testing.assert_allclose(t, expected, atol=1e-9)
    assert unit == "s"
