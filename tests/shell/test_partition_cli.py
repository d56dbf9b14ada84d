"""`identify --partition`: trees, local terms and criteria from the command line."""

import csv
import json

import numpy as np
import pytest

from jaxnarx.methods import Case, SimulationError
from jaxnarx.models import SigmoidTree, load
from jaxnarx.shell.cli import run
from jaxnarx.shell.commands import Identify
from jaxnarx.shell.identify import make_plan

ROWS = 300
NAMES = ("speed", "load", "temp")
QUICK = ["--steps", "2", "--window-steps", "2", "--horizons", "10", "--degree", "1"]


def write(path, seed: int) -> None:
    """temp = 3 + |speed - load| about: two planes with an oblique border."""
    rng = np.random.default_rng(seed)
    speed, load_ = np.repeat(rng.uniform(1, 4, (2, ROWS // 3)), 3, axis=1)
    temp = 3 + np.log(2 * np.cosh(4 * (speed - load_))) / 4
    temp += 0.01 * rng.normal(size=ROWS)
    rows = np.stack([speed, load_, temp], axis=1)
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([NAMES, *(map(repr, r) for r in rows.tolist())])


@pytest.fixture(scope="module")
def place(described):
    return described(write)


def test_an_oblique_tree_with_terms_of_each_region_from_the_command_line(place, capsys):
    words = ["identify", "engine.toml", "--partition", "tree", "--models", "3"]
    words += ["--schedule", "speed[t]", "load[t]", "--input-lags", "0", "--output-lags"]
    words += ["--terms", "3", "--local-terms", "3", "--criterion", "validation"]
    assert run([*words, "--out", "tree", *QUICK, "--require-fit", "80"]) == 0
    assert "local models of 3 terms" in capsys.readouterr().out
    network = load(place / "tree" / "model.safetensors")
    assert isinstance(network.models[0].validity, SigmoidTree)
    # A border along speed = load, however it is scaled.
    direction = np.asarray(network.models[0].validity.unit()[0])
    assert direction[0] * direction[1] < 0
    assert abs(abs(direction[0]) - abs(direction[1])) < 0.2
    report = (place / "tree" / "report.html").read_text()
    assert "load[t]" in report and "above" in report
    assert json.loads((place / "tree" / "report.json").read_text())
    model = str(place / "tree" / "model.safetensors")
    assert run(["simulate", model, "r2.csv", "--out", "out"]) == 0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--local-terms", "3"], "--local-terms needs --models above 1"),
        (["--feedback", "own"], "--feedback needs --models above 1"),
        (["--local-terms", "-1"], "--local-terms must not be negative, got -1"),
        (["--partition", "voronoi"], "invalid choice"),
        (
            ["--models", "2", "--schedule", "speed[t]", "speed[t]"],
            "named twice",
        ),
    ],
)
def test_partitions_that_make_no_sense_are_usage(place, capsys, given, words):
    assert run(["identify", "engine.toml", "--out", "none", *QUICK, *given]) == 2
    assert words in capsys.readouterr().err
    assert not (place / "none").exists()


def test_the_order_of_training_is_one_for_command_verb_and_sweep():
    def trained(command: Identify) -> str:
        return make_plan(command, "").refine.train

    assert trained(Identify("a.toml")) == SimulationError().train == Case().train
    assert trained(Identify("a.toml", train="joint")) == "joint"
