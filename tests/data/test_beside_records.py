"""Descriptions beside records: signs of gains, operating points at rest."""

from pathlib import Path

import format_writers
import numpy as np
import pytest
from described import grouped, refuse

from jaxnarx.data import read, read_split
from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.settings import Physics


@pytest.fixture(autouse=True)
def no_environment(monkeypatch):
    monkeypatch.delenv("JAXNARX_DATA", raising=False)


# physics --------------------------------------------------------------------------


def with_physics(folder: Path, text: str) -> Path:
    path = grouped(folder, "{}")
    path.write_text(path.read_text() + f"\n[physics]\n{text}\n")
    return path


def test_signs_of_gains_are_with_the_split(tmp_path):
    text = 'NOx = {increases_with = ["TRQ"], decreases_with = ["N"], '
    text += "longest_time_constant = 9}"
    split = read_split(with_physics(tmp_path, text))
    known = Physics(["TRQ"], ["N"], longest_time_constant=9.0)
    assert split.physics == {"NOx": known}
    assert str(split).endswith("rises with TRQ and falls with N, no slower than 9 s")
    assert not read_split(grouped(tmp_path, "{}")).physics


@pytest.mark.parametrize(
    ("text", "field", "said"),
    [
        ('CO = {increases_with = ["TRQ"]}', "physics", "no output 'CO'"),
        ('NOx = {increases_with = ["TRG"]}', "physics.NOx", "Did you mean 'TRQ'"),
        ('NOx = ["TRQ"]', "physics.NOx", "must be a table"),
        ('NOx = {rises = ["TRQ"]}', "physics.NOx.rises", "unknown key 'rises'"),
        (
            "NOx = {longest_time_constant = -1}",
            "physics.NOx.longest_time_constant",
            "positive number of seconds",
        ),
        (
            "NOx = {longest_time_constant = '9 s'}",
            "physics.NOx.longest_time_constant",
            "got '9 s'",
        ),
        ("NOx = {increases_with = 3}", "physics.NOx.increases_with", "got 3"),
        ("NOx = {}", "physics.NOx.increases_with", "says nothing"),
        (
            'NOx = {increases_with = ["TRQ"], decreases_with = ["TRQ", "N"]}',
            "physics.NOx.increases_with",
            "contradict each other: TRQ is in both",
        ),
    ],
)
def test_physics_that_cannot_be_is_refused(tmp_path, text, field, said):
    caught = refuse(SpecError, with_physics(tmp_path, text), "d.toml: ", said)
    assert caught.field == field


# operating points at rest -----------------------------------------------------------


POINTS = "N,Md,NOx\n1500,0.5,20\n3000,2.25,\n1000,1.5,44\n"


def at_rest(folder: Path, text: str = POINTS, named: str = '["steady/*.csv"]') -> Path:
    (folder / "steady").mkdir()
    (folder / "steady" / "bench.csv").write_text(text)
    path = grouped(folder, "{}")
    lines = path.read_text().replace("groups =", f"at_rest = {named}\ngroups =")
    path.write_text(lines)
    return path


def test_operating_points_are_with_the_split_and_among_no_records(tmp_path):
    path = at_rest(tmp_path)
    split = read_split(path)
    points = split.at_rest
    assert points is not None
    (record,) = points
    assert points.channels == split.all.channels and points.names == ["bench"]
    np.testing.assert_array_equal(record.u, [[1500, 0.5], [3000, 2.25], [1000, 1.5]])
    np.testing.assert_array_equal(record.y[[0, 2], 0], [20, 44])
    assert record.valid[:, 2].tolist() == [True, False, True]
    assert str(split).endswith("3 operating points at rest")
    assert read(path).names == split.all.names == ["s1", "s2", "s3", "t1"]
    other = tmp_path / "other"
    other.mkdir()
    assert read_split(grouped(other, "{}")).at_rest is None


def test_operating_points_have_no_time(tmp_path):
    """In any order, and without the column that the records have."""
    path = at_rest(tmp_path)
    path.write_text(path.read_text().replace("[data]", '[data]\ntime = "t"'))
    points = read_split(path).at_rest
    assert points is not None and points.samples == 3


@pytest.mark.parametrize(
    ("text", "named", "error", "said"),
    [
        ("N,Md\n1500,0.5\n1000,1\n", '["steady/*.csv"]', DataFileError, "NOx"),
        (POINTS, '["warm/*.csv"]', DataFileError, "warm/*.csv"),
        (POINTS, '"steady/bench.csv"', SpecError, "records.at_rest must be a list"),
        (POINTS, '["s1.csv"]', SpecError, "s1.csv is among the records and at rest"),
    ],
)
def test_operating_points_that_cannot_be_read_are_refused(
    tmp_path, text, named, error, said
):
    with pytest.raises(error) as caught:
        read_split(at_rest(tmp_path, text, named))
    assert said in str(caught.value)


def test_operating_points_with_times_of_their_own_are_refused(tmp_path):
    path = at_rest(tmp_path, named='["map.mf4"]')
    columns = {"t": [0.0, 60.0], "N": [1e3, 2e3], "Md": [1.0, 2.0], "NOx": [3.0, 4.0]}
    arrays = {name: np.array(values) for name, values in columns.items()}
    format_writers.mf4(tmp_path / "map.mf4", arrays, {})
    with pytest.raises(DataFileError, match="have times of their own"):
        read_split(path)
