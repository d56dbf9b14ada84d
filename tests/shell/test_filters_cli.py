"""`identify --filters`: from the command line to the files and back."""

import csv
import json

import numpy as np
import pytest
import scipy.signal

from jaxnarx.models import load
from jaxnarx.shell.cli import run

ROWS = 200
QUICK = ["--steps", "2", "--window-steps", "2", "--horizons", "10", "--terms", "4"]
NAMES = ("speed", "load", "temp")


def low_pass(u: np.ndarray, time_constant: float) -> np.ndarray:
    a = np.exp(-0.1 / time_constant)
    return scipy.signal.lfilter([1 - a], [1, -a], u, zi=[a * u[0]])[0]


def write(path, seed: int) -> np.ndarray:
    """A file of speed, load and temp = 3 + 2 lp(speed, 1 s) + 0.5 lp(load, 0.3 s)."""
    rng = np.random.default_rng(seed)
    speed, load_ = np.repeat(rng.uniform(1, 4, (2, ROWS // 10)), 10, axis=1)
    temp = 3 + 2 * low_pass(speed, 1.0) + 0.5 * low_pass(load_, 0.3)
    rows = np.stack([speed, load_, temp], axis=1)
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([NAMES, *(map(repr, r) for r in rows.tolist())])
    return temp


@pytest.fixture(scope="module")
def place(described):
    return described(write)


def test_a_model_without_any_lag_is_identified_run_and_scored(place, capsys):
    words = ["identify", "engine.toml", "--filters", "0.3", "1", "--input-lags"]
    words += ["--output-lags", "--degree", "1", "--out", "lone", *QUICK]
    words += ["--terms", "100"]
    assert run([*words, "--require-fit", "99.9"]) == 0
    told = capsys.readouterr().out
    assert "Choosing 5 of 5 terms" in told
    assert "100 were asked for; there are no more candidates" in told
    network = load(place / "lone" / "model.safetensors")
    terms = dict(network.equations()[0]["terms"])
    # neither noise nor feedback: the system itself
    assert terms["lp(speed, 1 s)[t]"] == pytest.approx(2.0, rel=1e-6)
    assert terms["lp(load, 0.3 s)[t]"] == pytest.approx(0.5, rel=1e-6)
    expected = write(place / "new.csv", 9)
    model = str(place / "lone" / "model.safetensors")
    assert run(["simulate", model, "new.csv", "--out", "out"]) == 0
    with open(place / "out" / "new.csv", newline="") as file:
        header, *rows = csv.reader(file)
    found = [float(r[header.index("temp simulated")]) for r in rows]
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert run(["report", model, "engine.toml", "--out", "scores"]) == 0
    scores = json.loads((place / "lone" / "report.json").read_text())
    assert "lp(speed, 1 s)[t]" in json.dumps(scores)
    assert "lp(speed, 1 s)" in (place / "scores" / "report.html").read_text()


@pytest.mark.slow
def test_regions_over_a_filtered_input(place, capsys):
    words = ["identify", "engine.toml", "--filters", "0.3", "1", "--input-lags", "1"]
    words += ["--degree", "1", "--models", "2", "--schedule", "lp(speed, 1 s)[t]"]
    assert run([*words, "--out", "regions", *QUICK]) == 0
    del capsys
    network = load(place / "regions" / "model.safetensors")
    assert "lp(speed, 1 s)[t]" in (place / "regions" / "report.html").read_text()
    assert list(network.equations()[0]["region"]) == ["lp(speed, 1 s)[t]"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--filters", "1", "-4"], "--filters must be positive time constants"),
        (["--filters", "nan"], "--filters must be positive time constants"),
        (["--filters", "1e12"], "use a shorter one"),
        (["--filters", "--input-lags", "--output-lags"], "no lagged variables"),
        (
            ["--models", "2", "--schedule", "lp(temp, 1 s)[t-1]"],
            "temp is computed by the model",
        ),
    ],
)
def test_filters_that_make_no_sense_are_usage(place, capsys, given, words):
    assert run(["identify", "engine.toml", "--out", "none", *QUICK, *given]) == 2
    assert words in capsys.readouterr().err
    assert not (place / "none").exists()
