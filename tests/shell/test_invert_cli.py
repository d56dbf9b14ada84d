"""`jaxnarx invert`, and `simulate --through`, from the command line."""

import csv
import json

import numpy as np
import pytest
from inverse_problems import plant, steps

import jaxnarx as jnx
from jaxnarx.data import read_split
from jaxnarx.models import load
from jaxnarx.regressors import polynomial_pool
from jaxnarx.shell.cli import run

ROWS = 300


def write(path, seed: int) -> None:
    """temp follows speed after two samples; load disturbs it. The test record, the
    third, is free of noise: what is followed there can be followed."""
    u, d = steps(ROWS, seed), steps(ROWS, seed + 50)
    y = plant(u, d) + 0.05 * (seed < 2) * np.random.default_rng(seed).normal(size=ROWS)
    rows = np.stack([u, d, y], axis=1)
    with open(path, "w", newline="") as file:
        names = ("speed", "load", "temp")
        csv.writer(file).writerows([names, *(map(repr, r) for r in rows.tolist())])


@pytest.fixture(scope="module")
def place(described):
    folder = described(write)
    data = read_split("engine.toml", root=".").all
    pool = polynomial_pool(data.channels, input_lags=(2,), output_lags=(1,), degree=3)
    jnx.save(jnx.grow(pool, data[:1], jnx.Global()).value, "forward.safetensors")
    return folder


INVERT = ["invert", "forward.safetensors", "engine.toml", "--command", "speed"]
QUICK = ["--input-lags", "0", "1", "--output-lags", "--terms", "10", "--effort", "1e-5"]
QUICK += ["--direct-steps", "0", "--steps", "6"]


@pytest.fixture(scope="module")
def inverse(place):
    assert run([*INVERT, *QUICK, "--out", "inverse"]) == 0
    return place / "inverse"


def test_the_trained_inverse_follows_unseen_references_better(inverse):
    assert load(inverse / "inverse.safetensors").output_names == ["speed"]
    told = json.loads((inverse / "tracking.json").read_text())
    # The model's dead time, found by itself.
    assert told["part"] == "test" and told["lead"] == {"temp": 2}
    direct, trained = (told["tracking"][w]["nrmse"]["temp"] for w in told["tracking"])
    assert trained < 0.8 * direct
    assert (inverse / "tracking.png").stat().st_size > 10_000
    assert "temp_ahead2" in (inverse / "report.html").read_text()


def test_references_in_new_files_need_commands_only_at_the_start(
    place, inverse, capsys
):
    lines = (place / "r2.csv").read_text().splitlines()
    head, rows = lines[:20], [line.split(",", 1) for line in lines[20:]]
    (place / "wanted.csv").write_text("\n".join([*head, *("," + r for _, r in rows)]))
    words = ["simulate", str(inverse / "inverse.safetensors"), "wanted.csv"]
    words += ["--through", "forward.safetensors", "--out", "followed"]
    assert run(words) == 0
    assert "temp follows its reference" in capsys.readouterr().out
    with open(place / "followed" / "wanted.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == ROWS
    wanted = np.array([float(row["temp reference"]) for row in table])
    got = np.array([float(row["temp simulated"]) for row in table])
    error = np.sqrt(np.mean((got - wanted)[20:] ** 2)) / wanted.std()
    told = json.loads((inverse / "tracking.json").read_text())
    # The same records and inverse as in training; only the start was cut.
    assert error < 1.2 * told["tracking"]["trained"]["nrmse"]["temp"]
    (place / "gap.csv").write_text("\n".join([*head, "1,,0.5"]))
    assert run([*words[:2], "gap.csv", *words[3:], "--force"]) == 3
    assert "load has 1 empty or invalid cell" in capsys.readouterr().err


def test_commands_move_within_the_limits_that_are_given(place):
    limits = ["--range", "speed=-0.5:0.5", "--rate", "speed=2"]
    assert run([*INVERT, *QUICK[:-1], "0", *limits, "--out", "limited"]) == 0
    told = json.loads((place / "limited" / "tracking.json").read_text())
    free = json.loads((place / "inverse" / "tracking.json").read_text())
    direct = (t["tracking"]["direct"]["nrmse"]["temp"] for t in (told, free))
    assert next(direct) > 2 * next(direct)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--command", "torque"], "--command: the model has no 'torque'"),
        (["--target", "speed"], "--target: the model has no 'speed'"),
        (["--models", "2"], "needs --schedule"),
        (["--range", "speed=1"], "--range must be NAME=LOW:HIGH, got 'speed=1'"),
        (["--rate", "speed=fast"], "--rate must be NAME=RATE, got 'speed=fast'"),
        (["--range", "spede=0:1"], "range names 'spede', which is no command"),
    ],
)
def test_inverses_that_make_no_sense_are_usage(place, capsys, given, words):
    assert run([*INVERT, *QUICK, "--out", "none", *given]) in (2, 3)
    assert words in capsys.readouterr().err
    assert not (place / "none").exists()
