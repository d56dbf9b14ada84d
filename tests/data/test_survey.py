"""What a folder of measurements is taken for."""

from pathlib import Path

import numpy as np
import pytest

from jaxnarx.data._survey import measurement_files, survey
from jaxnarx.errors import DataFileError, SpecError

ROWS = 400


def columns(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.uniform(1000, 3000, ROWS // 20), 20)
    pedal = np.repeat(rng.uniform(0, 1, ROWS // 10), 10)
    nox = np.convolve(speed * (1 + pedal), np.full(9, 1 / 9), "same")
    return {
        "time": 0.1 * np.arange(ROWS),
        "speed": speed,
        "x_12": pedal,
        "speed_b": 60 * speed + 1,
        "NOx": nox,
        "T_oil": 80 + 0.01 * rng.normal(size=ROWS).cumsum(),
        "still": np.full(ROWS, 3.0),
        "mostly": np.where(np.arange(ROWS) % 4, np.nan, 1.0 * np.arange(ROWS)),
    }


def write(path: Path, table: dict[str, np.ndarray], units: str = "") -> None:
    lines = [",".join(table)] + ([units] if units else [])
    for row in zip(*table.values(), strict=True):
        lines.append(",".join("" if x != x else repr(float(x)) for x in row))
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def folder(tmp_path) -> Path:
    """Three cycles; the third is driven twice."""
    for n, seed in enumerate((1, 2, 3, 3)):
        table = columns(seed)
        if n == 3:
            noise = np.random.default_rng(9).normal(size=ROWS)
            table["NOx"] = table["NOx"] + noise
            table["extra"] = noise
        write(tmp_path / f"run{n}.csv", table)
    (tmp_path / "LICENSE.txt").write_text("Do with it what you like.\n")
    return tmp_path


def test_channels_are_told_by_name_and_course(folder):
    files = measurement_files([folder])
    assert [f.name for f in files] == [f"run{n}.csv" for n in range(4)]
    found = survey(files)
    role = {c.name: c.role for c in found.channels}
    assert role == {
        "speed": "input",
        "x_12": "input",
        "NOx": "output",
        "T_oil": "output",
        "speed_b": "left out",
        "still": "left out",
        "mostly": "left out",
    }
    why = {c.name: c.reason for c in found.channels}
    assert "moves in steps (9" in why["x_12"] and "same as speed" in why["speed_b"]
    assert "constant at 3" in why["still"] and "75% of the sam" in why["mostly"]
    assert (found.time, found.sample_time) == ("time", None)
    assert found.only_in == {"extra": 1}
    low = min(columns(s)["speed"].min() for s in (1, 2, 3))
    (speed,) = [c for c in found.channels if c.name == "speed"]
    assert speed.low == pytest.approx(low) and speed.missing == 0


def test_records_of_one_cycle_stay_together(folder):
    found = survey(measurement_files([folder]))
    names = [{f.name for f in own} for own in found.cycles]
    assert {"run2.csv", "run3.csv"} in names and len(names) == 3
    train, test = ({f.name for f in found.parts[p]} for p in ("train", "test"))
    assert train | test == {f"run{n}.csv" for n in range(4)}
    assert {"run2.csv", "run3.csv"} <= train or {"run2.csv", "run3.csv"} <= test


def test_what_is_asked_for_is_not_guessed(folder):
    found = survey(measurement_files([folder]), outputs=["T_oil"])
    assert [c.name for c in found.of("output")] == ["T_oil"]
    assert {c.name for c in found.of("input")} == {"speed", "x_12", "NOx"}
    why = {c.name: c.reason for c in found.channels}
    assert why["NOx"] == "not asked for as output"
    both = survey(measurement_files([folder]), outputs=["NOx"], inputs=["x_12"])
    assert [c.name for c in both.of("input")] == ["x_12"]
    with pytest.raises(SpecError, match="no channel 'NO' in all files.*NOx"):
        survey(measurement_files([folder]), outputs=["NO"])


def test_names_of_files_say_what_they_are_for(folder):
    for n, name in enumerate(("train_a", "train_b", "validation", "Test")):
        (folder / f"run{n}.csv").rename(folder / f"{name}.csv")
    parts = survey(measurement_files([folder])).parts
    told = {part: [f.file.stem for f in runs] for part, runs in parts.items()}
    assert told == {
        "train": ["train_a", "train_b"],
        "validate": ["validation"],
        "test": ["Test"],
    }


@pytest.mark.parametrize(
    ("stamps", "told"),
    [
        (100.0 * np.arange(ROWS), ("time", "ms", None)),
        (np.round(0.1 * np.arange(ROWS) + 3, 1), ("time", "", None)),
        (None, ("", "", 0.1)),
    ],
)
def test_time_is_found_in_its_unit_or_asked_for(tmp_path, stamps, told):
    table = columns(1)
    if stamps is None:
        table = {"row": 1.0 * np.arange(ROWS)} | {
            k: v for k, v in table.items() if k != "time"
        }
        write(tmp_path / "a.csv", table)
        with pytest.raises(DataFileError, match="Give --sample-time"):
            survey([tmp_path / "a.csv"])
        found = survey([tmp_path / "a.csv"], sample_time=0.1)
        (row,) = [c for c in found.channels if c.name == "row"]
        assert row.reason == "counts its rows"
    else:
        write(tmp_path / "a.csv", table | {"time": stamps})
        found = survey([tmp_path / "a.csv"])
    assert (found.time, found.time_unit, found.sample_time) == told
    told = {p: [run.name for run in runs] for p, runs in found.parts.items()}
    assert told == {"train": ["a.csv @ 0:28"], "test": ["a.csv @ 30:"]}


def test_a_folder_without_measurements_is_told(tmp_path):
    with pytest.raises(DataFileError, match="no file that can be read"):
        measurement_files([tmp_path])
    with pytest.raises(DataFileError, match="there is no such file"):
        measurement_files([tmp_path / "a.csv"])
