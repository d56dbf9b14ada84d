"""`identify --partition`: trees, local terms and criteria from the command line."""

import csv
import json
from typing import Any

import numpy as np
import pytest

from jaxnarx.models import SigmoidTree, load
from jaxnarx.settings import Identification, Lolimot, StepwiseF
from jaxnarx.settings import SigmoidTree as TreeOfSigmoids
from jaxnarx.shell.cli import run
from jaxnarx.shell.commands import Identify
from jaxnarx.shell.commands.parse import parse

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
        (["--local-terms", "3"], "--local-terms needs --schedule"),
        (["--feedback", "own"], "--feedback needs --schedule"),
        (["--models", "2"], "--models needs --schedule"),
        (
            ["--local-terms", "-1", "--schedule", "speed[t]"],
            "--local-terms must be at least 1, got -1",
        ),
        (["--set", "grow.k=1"], "there is no setting 'grow.k'"),
        (["--set", "grow.patience"], "--set takes PATH=VALUE"),
        (["--set", "refine.tolerance=-1"], "--set refine.tolerance"),
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


def test_options_settings_and_files_are_one_tree(place):
    def method(*words: str) -> Any:
        command = parse(["identify", "a.toml", *words])
        assert isinstance(command, Identify)
        return command.method

    assert method("--terms", "25") == Identification()
    assert method("--train", "joint").refine.train == "joint"
    regions = ["--schedule", "speed[t]", "--models", "3", "--log", "temp"]
    found = method(*regions, "--set", "grow.patience=4", "refine.tolerance=1e-5")
    assert found.grow == Lolimot(["speed[t]"], max_models=3, patience=4)
    assert found.refine.box_cox == {"temp": 0.0} and found.refine.tolerance == 1e-5
    (place / "method.toml").write_text(
        '[select]\nmethod = "stepwise"\nmax_terms = 9\n[grow]\nmethod = "tree"\n'
        'scheduling = ["load[t]"]\n'
    )
    found = method("--settings", "method.toml", "--models", "5")
    assert found.select == StepwiseF(max_terms=9)
    assert found.grow == TreeOfSigmoids(["load[t]"], max_models=5)
    found = method("--settings", "method.toml", "--partition", "lolimot")
    assert found.grow == Lolimot(["load[t]"])
    assert method("--steps", "0").refine is None
