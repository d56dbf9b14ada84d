"""Parts of a long file as records."""

import numpy as np
import pytest

from jaxnarx.data import read, read_split
from jaxnarx.errors import DataError, DataFileError, SpecError

ROWS = 1000


@pytest.fixture
def place(tmp_path):
    """One file of 100 s; `on` is 1 from 20 to 45 s and from 60 to 80 s."""
    t = 0.1 * np.arange(ROWS)
    on = ((t >= 20) & (t < 45)) | ((t >= 60) & (t < 80))
    both = list(zip(t, on, strict=True))
    lines = [f"{x:.1f},{k},{k * k},{int(o)}" for k, (x, o) in enumerate(both)]
    (tmp_path / "long.csv").write_text("\n".join(["t,u,y,on", *lines]) + "\n")
    return tmp_path


def described(place, records: str, more: str = ""):
    text = f'[data]\ntime = "t"\n{more}[channels.inputs]\nu = ""\n[channels.outputs]\n'
    path = place / "d.toml"
    path.write_text(f'{text}y = ""\n[records]\n{records}\n')
    return path


def test_spans_of_one_file_serve_several_parts(place):
    path = described(
        place,
        'train = ["long.csv @ 0:50", "long.csv @ 70:"]\ntest = ["long.csv @ 50:70"]',
    )
    split = read_split(path, root=place)
    assert split.all.names == [f"long @ {s}" for s in ("0:50", "70:", "50:70")]
    assert split.train is not None and split.test is not None
    (test,) = split.test.records
    np.testing.assert_array_equal(test.u[:, 0], np.arange(500, 700))
    assert test.start_row == 2 + 500  # as an editor counts: the header is row 1
    assert [len(r) for r in split.train] == [500, 300]


def test_a_column_says_when(place):
    data = read(described(place, 'files = ["long.csv @ on > 0.5"]'), root=place)
    assert data.names == ["long @ on > 0.5#1", "long @ on > 0.5#2"]
    first, second = (r.u[:, 0] for r in data)
    np.testing.assert_array_equal(first, np.arange(200, 450))
    np.testing.assert_array_equal(second, np.arange(600, 800))
    off = read(described(place, 'files = ["long.csv @ on < 0.5"]'), root=place)
    assert [len(r) for r in off] == [200, 150, 200]


def test_groups_take_all_parts_of_a_file(place):
    records = 'files = ["long.csv @ 0:20", "long.csv @ 20:40"]\n'
    path = described(place, records + 'groups = {one = ["long.csv"]}')
    assert [r.group for r in read(path, root=place)] == ["one", "one"]


@pytest.mark.parametrize(
    ("records", "error", "said"),
    [
        (
            'train = ["long.csv @ 0:50"]\ntest = ["long.csv @ 40:60"]',
            SpecError,
            "long.csv is in train and in test",
        ),
        (
            'train = ["long.csv"]\ntest = ["long.csv @ 40:60"]',
            SpecError,
            "is in train and in test",
        ),
        ('files = ["long.csv @ 0:5", "long.csv @ 4:9"]', SpecError, "overlapping"),
        ('files = ["long.csv @ 5:1"]', SpecError, "a span of seconds, such as"),
        ('files = ["long.csv @ fast"]', SpecError, "got 'fast'"),
        ('files = ["long.csv @ 99.8:"]', DataError, "leaves no stretch of 10 rows"),
        ('files = ["long.csv @ on > 5"]', DataError, "leaves no stretch of 10 rows"),
        ('files = ["long.csv @ onn > 0"]', DataFileError, "no column 'onn'.*'on'"),
    ],
)
def test_what_cannot_be_cut_is_told(place, records, error, said):
    with pytest.raises(error, match=said):
        read(described(place, records), root=place)


def test_rows_are_named_as_in_the_file(place):
    text = (place / "long.csv").read_text().replace("55.0,550,", "55.0,,")
    (place / "long.csv").write_text(text)
    path = described(place, 'files = ["long.csv @ 50:70"]')
    with pytest.raises(DataError, match="row 552"):
        read(path, root=place)
