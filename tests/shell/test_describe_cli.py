"""`jaxnarx describe`: a folder of files as it is, described so that it can be read."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jaxnarx.data import read_split
from jaxnarx.shell.cli import run

ROWS = 300


def frame(seed: int) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.uniform(1000, 3000, ROWS // 10), 10)
    return pd.DataFrame(
        {
            "Zeit": 0.1 * np.arange(ROWS),
            "speed": speed,
            "T_öl": np.convolve(speed, np.ones(5), "same"),
        }
    )


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("JAXNARX_DATA", raising=False)
    Path("bench").mkdir()
    return tmp_path


def written(n: int, kind: str) -> None:
    if kind == "xlsx":
        frame(n).to_excel(f"bench/r{n}.xlsx", index=False)
        return
    head = "Prüfstand 7\n\n" + ";".join(frame(n).columns) + "\ns;1/min;°C\n"
    body = frame(n).to_csv(sep=";", decimal=",", header=False, index=False)
    Path(f"bench/r{n}.csv").write_bytes((head + body).encode("cp1252"))


@pytest.mark.parametrize("kind", ["csv", "xlsx"])
def test_what_it_writes_is_read_as_it_was(place, capsys, kind):
    for n in range(3):
        written(n, kind)
    assert run(["describe", "bench"]) == 0
    text = capsys.readouterr().out
    assert "by its name" in text and "Next: jaxnarx check engine.toml" in text
    table = tomllib.loads(Path("engine.toml").read_text("utf-8"))
    assert table["data"]["time"] == "Zeit" and table["data"]["root"] == "bench"
    split = read_split("engine.toml")
    assert split.train is not None and split.test is not None
    assert len(split.train) == 2 and len(split.test) == 1
    found = frame(2)
    (record,) = split.test.records
    # a sheet holds fifteen digits
    np.testing.assert_allclose(record.u[:, 0], found["speed"], rtol=1e-14)
    np.testing.assert_allclose(record.y[:, 0], found["T_öl"], rtol=1e-14)
    if kind == "csv":
        assert split.all.channels.inputs[0].unit == "1/min"
        assert table["data"]["encoding"] == "cp1252" and table["data"]["unit_row"]


def test_nothing_is_overwritten_and_faults_are_one_sentence(place, capsys):
    written(0, "csv")
    assert run(["describe", "bench", "--out", "a.toml"]) == 0
    assert run(["describe", "bench", "--out", "a.toml"]) == 2
    assert "is there already" in capsys.readouterr().err
    for words, code, said in (
        (["bench", "--outputs", "NOx"], 2, "no channel 'NOx'"),
        (["bench", "--out", "a.txt"], 2, "must be a TOML file"),
        (["none"], 3, "there is no such file"),
        (["bench", "--inputs", "T_öl", "--outputs", "T_öl"], 2, "looks like an input"),
    ):
        capsys.readouterr()
        assert run(["describe", *words]) == code
        assert said in capsys.readouterr().err
    assert not Path("engine.toml").exists()


def test_reading_that_takes_long_is_told(place, capsys, monkeypatch):
    import time

    from jaxnarx.data.readers import csv_file
    from jaxnarx.shell import reading

    written(0, "csv")
    whole = csv_file.contents

    def slow(path, asked):
        time.sleep(1.0)
        return whole(path, asked)

    monkeypatch.setattr(csv_file, "contents", slow)
    monkeypatch.setattr(reading, "SILENT_SECONDS", 0.1)
    assert run(["describe", "bench/r0.csv"]) == 0
    told = capsys.readouterr().err.splitlines()
    assert set(told[:-1]) == {"reading bench/r0.csv"}  # one file, opened several times
    assert re.fullmatch(r"read 1 file in \d+ s", told[-1])
