"""`jaxnarx simulate-engine`: what it writes can be read, and says what it is."""

import shlex
from pathlib import Path
from typing import get_args, get_type_hints

import jax
import numpy as np
import pytest

from jaxnarx.data import read_split
from jaxnarx.engines import BEDS, Pfi
from jaxnarx.shell import commands, simulate_engine
from jaxnarx.shell.cli import run


@pytest.fixture
def simulate(monkeypatch, tmp_path, capsys):
    """Run the command in an empty folder; exit code, output and errors."""
    monkeypatch.chdir(tmp_path)

    def simulate(line: str):
        code = run(["simulate-engine", *shlex.split(line)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return simulate


def test_every_bed_can_be_named():
    hint = get_type_hints(commands.SimulateEngine)["engine"]
    assert set(get_args(hint)) == set(BEDS)


def test_what_is_written_reads_back_as_what_was_simulated(simulate):
    code, out, _ = simulate("pfi --duration 3 --out bed --seed 4")
    assert code == 0
    assert "Next: jaxnarx check bed/engine.toml" in out
    split = read_split("bed/engine.toml")
    parts = (split.train, split.validate, split.test)
    assert [p.names[0] for p in parts if p is not None] == [
        "train",
        "validate",
        "test",
    ]
    keys = jax.random.split(jax.random.key(4), 3)
    inputs = [Pfi().excite(jax.random.fold_in(keys[1], i), 100) for i in range(3)]
    expected = Pfi().simulate(inputs, keys[2])
    assert split.all.channels == expected.channels
    assert split.all.sample_time == expected.sample_time
    for got, record in zip(split.all, expected, strict=True):
        np.testing.assert_array_equal(got.u, record.u)
        np.testing.assert_array_equal(got.y, record.y)
    header = Path("bed/train.csv").read_text().splitlines()[0].split(",")
    assert header == ["event", "duty", "speed", "MAP"]
    assert Path("bed/excitation.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_one_input_moves_and_the_others_stay(simulate):
    line = "pfi-cc --signal prbs --input load --hold 5 --duration 1.5 --records 1"
    code, _, _ = simulate(f"{line} --noise 0 --out bed")
    assert code == 0
    u = read_split("bed/engine.toml").all.records[0].u
    assert len(np.unique(u[:, 0])) == 1
    assert len(np.unique(u[:, 1])) == 2
    holds = np.diff(np.flatnonzero(np.diff(u[:, 1])))
    assert np.all(holds % 5 == 0)


@pytest.mark.parametrize("name", ["random-walk", "multisine", "chirp", "steps"])
def test_signals_stay_in_their_range_and_use_it(simulate_signal, name):
    u = np.asarray(simulate_signal(name))
    assert u.shape == (300,) and np.all(np.isfinite(u))
    assert u.min() >= 2 - 1e-9 and u.max() <= 6 + 1e-9
    # A walk may keep to a part; the others reach (nearly) both ends.
    assert np.ptp(u) > (1.0 if name == "random-walk" else 3.0)


@pytest.fixture
def simulate_signal(key):
    def signal(name):
        command = commands.SimulateEngine(engine="pfi", signal=name, hold=4)
        return simulate_engine._signal(command, key, 300, (2.0, 6.0), 0.1, 0)

    return signal


@pytest.mark.slow
def test_records_can_be_resampled_to_time(simulate):
    code, _, _ = simulate("pfi --duration 6 --records 1 --sample-time 0.05 --out bed")
    assert code == 0
    data = read_split("bed/engine.toml").all
    assert data.sample_time == 0.05
    assert Path("bed/record_1.csv").read_text().startswith("time [s],")
    # 200 events of 180 degrees at 450 to 1900 rpm last 3.2 to 13 s.
    assert 3.2 < len(data.records[0]) * 0.05 < 13.4


@pytest.mark.slow
def test_limits_are_told_and_marked(simulate, monkeypatch):
    def flags(self, inputs):
        broken = np.zeros(len(inputs), bool)
        broken[[7, 9]] = True
        return {"smoke": broken, "surge": ~broken & broken}

    monkeypatch.setattr(Pfi, "flags", flags)
    code, out, _ = simulate("pfi --duration 3 --records 1 --out bed")
    assert code == 0
    assert (
        "record_1: the smoke limit is broken in 2 samples (2 %), first in row 7" in out
    )
    rows = [r.split(",") for r in Path("bed/record_1.csv").read_text().splitlines()]
    assert rows[0][-1] == "smoke limit"
    assert [i for i, row in enumerate(rows[1:]) if row[-1] == "1"] == [7, 9]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("pfi --signal chirp --input dty", "Did you mean 'duty'?"),
        ("pfi --input duty", "aprbs excites all"),
        ("pfi --duration 0.1", "3 samples of 0.03 s; give at least 20"),
        ("pfi --duration nan", "--duration must be a number"),
        ("pfi --records 0", "--records must be at least 1"),
        ("pfi --hold 0 --signal prbs", "--hold must be at least 1"),
        ("pfi --noise -1", "--noise must be a number of at least 0"),
        ("pfi --sample-time 0", "--sample-time must be positive"),
        ("diesel --sample-time 0.01", "samples every 0.1 s"),
    ],
)
def test_wrong_use_is_one_sentence_and_leaves_nothing(simulate, tmp_path, line, words):
    code, _, err = simulate(f"{line} --out bed")
    assert code == 2
    assert words in err and err.count("\n") == 1
    assert not (tmp_path / "bed").exists()


def test_a_stalled_engine_leaves_nothing(simulate, tmp_path, monkeypatch):
    monkeypatch.setattr(
        Pfi, "limits", property(lambda self: {"speed": (1e4, float("inf"))})
    )
    code, _, err = simulate("pfi --duration 3 --out bed")
    assert code == 3
    assert "record 'train': speed is" in err and "at event 0" in err
    assert not (tmp_path / "bed").exists()


def test_files_are_not_overwritten_unless_told(simulate, tmp_path):
    (tmp_path / "bed").mkdir()
    (tmp_path / "bed" / "engine.toml").write_text("mine")
    code, out, err = simulate("pfi --duration 3 --out bed")
    assert code == 2 and "already holds engine.toml" in err
    assert "Simulating" not in out
    assert (tmp_path / "bed" / "engine.toml").read_text() == "mine"
