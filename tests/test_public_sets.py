"""The public sets: official starts, what is chosen, and the run at a small size."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from smoke import ROOT, experiment

import jaxnarx as jnx

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
for folder in ("benchmarks", "open_sets", "public"):
    sys.path.insert(0, str(EXPERIMENTS / folder))
from gru import run as run_gru  # noqa: E402 # pyright: ignore
from gru import start  # noqa: E402 # pyright: ignore
from ours import best_of, losses, taken, window  # noqa: E402 # pyright: ignore
from published import PUBLISHED  # noqa: E402 # pyright: ignore
from score import held_back, started  # noqa: E402 # pyright: ignore
from sets import READERS, Part  # noqa: E402 # pyright: ignore
from show import lines, with_best  # noqa: E402 # pyright: ignore
from structures import IN_REGIONS, SHARE, STRUCTURES, methods  # noqa: E402 # pyright: ignore


@pytest.fixture(scope="module")
def data() -> jnx.Dataset:
    """A first-order lag, measured without noise."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.normal(size=(40, 1)), 5, axis=0)
    y, x = np.zeros_like(u), 0.7
    for t in range(len(u)):
        y[t] = x = 0.9 * x + 0.1 * u[t, 0]
    return jnx.Dataset.from_arrays(
        [u], [y], inputs=["u"], outputs=["y"], sample_time=1.0
    )


@pytest.fixture(scope="module")
def network(data) -> jnx.Network:
    """With one hidden state."""
    method = jnx.settings.HiddenStates(states=1, degree=1, shrink=(0.1,), window=30)
    return jnx.linear.fit_states(data, method).value


@pytest.mark.slow
def test_hidden_states_start_from_the_official_window_alone(data, network):
    part = Part(data, 50, window=10)
    begun = started(network, part)
    assert begun.before == 10
    run = jnx.simulate(begun, held_back(begun, part)).value
    assert run.scored[0][50:].all() and not run.scored[0][:49].any()
    # What was measured before the window changes nothing, what is in it does.
    for rows, same in ((slice(0, 40), True), (slice(40, 50), False)):
        (record,) = data.records
        y = record.y.copy()
        y[rows] += 0.3
        other = jnx.Dataset.from_arrays(
            [record.u], [y], inputs=["u"], outputs=["y"], sample_time=1.0
        )
        moved = jnx.simulate(begun, held_back(begun, Part(other, 50, window=10)))
        moved = moved.value.outputs[0][50:]
        assert np.array_equal(moved, run.outputs[0][50:]) == same


def test_windows_of_the_sets(measured):
    expected = {"ced_coupled_drives": 10}
    for name, read in READERS.items():
        if not (measured / name).is_dir():
            pytest.skip(f"{name} is not there")
        found = read(measured)
        assert window(found) == expected.get(name, 50) - 1


def test_structures_have_enough_samples(data):
    for name in STRUCTURES:
        found = list(methods(name, data, "y", 9))
        assert sum(m.regions == 1 for m in found) < len(STRUCTURES[name])
        for method in found:
            terms = math.comb(method.states + 1 + method.degree, method.degree)
            size = (method.states + 1) * terms * method.regions
            assert size * SHARE <= data.samples
            assert (method.regions > 1) <= (name in IN_REGIONS and method.degree == 1)
            assert method.window == 9


def test_a_cheap_structure_that_is_as_good_is_trained_on_everything():
    size = {"degree": 2, "groups": [0.2, 0.4]}
    large = size | {"name": "a", "states": 5, "free_run": 0.3}
    small = size | {"name": "b", "states": 2, "free_run": 0.31}
    worse = size | {"name": "c", "states": 1, "free_run": 0.32}
    failed = size | {"name": "d", "states": 1, "failed": "diverges"}
    # Up to 5 % above the best may be given away.
    assert taken([large, small, worse, failed]) is small
    assert taken([large, worse]) is large
    assert taken([failed]) is None


def test_the_best_is_that_of_what_was_left_out():
    board = [
        {"name": "a", "free_run": 0.3, "groups": [0.1, 0.4]},
        {"name": "b", "free_run": 0.2, "groups": [0.2, None]},
        {"name": "c", "failed": "diverges", "groups": [0.1]},
    ]
    assert best_of(board) is board[1]
    assert best_of(board[2:]) is None and losses(board[2:]) is None
    np.testing.assert_allclose(losses(board), [0.04, np.nan], rtol=1e-12)
    test = {"test": {"rmse": 1.0, "nrmse": 0.1}}
    row = {
        "hidden states": {"free_run": 0.2, "test": test},
        "identify": {"free_run": 0.1, "test": test},
    }
    with_best(row)
    assert row["best"] == "identify"


def test_lines_of_the_table():
    tests = {part: {"rmse": 2.0, "nrmse": 0.1} for part in ("multisine", "arrow")}
    row = {
        "set": "silverbox",
        "output": "V2",
        "identify": {"free_run": 0.1, "test": tests, "parameters": 7},
        "GRU": {"test": tests, "parameters": 9, "fit_seconds": 3.0},
    }
    with_best(row)
    found = list(lines(row, PUBLISHED, {}))
    arrow = {name: one for part, name, one in found if part == "arrow"}
    assert arrow["ours, best (identify)"]["parameters"] == 7
    assert arrow["GRU"]["seconds"] == 3.0
    assert arrow["PNLSS (paper)"]["rmse"] == 0.26
    assert not any(n.startswith("PNLSS") for part, n, _ in found if part != "arrow")


def test_published_figures_are_of_parts_that_are_scored(measured):
    assert set(PUBLISHED) == set(READERS)
    for name, figures in PUBLISHED.items():
        if not (measured / name).is_dir():
            pytest.skip(f"{name} is not there")
        parts = set(READERS[name](measured).parts)
        for one in figures:
            assert one["certain"] in {"read", "paper", "quoted", "doubtful"}
            assert set(one["rmse"]) | set(one.get("nrmse", {})) <= parts


def test_the_recurrent_unit_against_its_equations():
    inputs, units = 2, 3
    params = start(inputs, units, 4)
    u = np.random.default_rng(2).normal(size=(6, 1, inputs)).astype(np.float32)

    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    w = np.split(params["from input"], 3, axis=1)
    v = np.split(params["from state"], 3, axis=1)
    h, expected = np.zeros(units), []
    for x in u[:, 0]:
        z = sigmoid(x @ w[0] + h @ v[0])
        r = sigmoid(x @ w[1] + h @ v[1])
        h = z * h + (1 - z) * np.tanh(x @ w[2] + r * (h @ v[2]))
        expected.append(h @ params["state out"] + x @ params["input out"])
    found = np.asarray(run_gru(params, u))[:, 0]
    # float32 on one side.
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.slow
def test_estimates_beside_the_truth(tmp_path):
    experiment("public/choosing.py", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "choosing.json").read_text())["figures"]
    (case,) = figures["cases"].values()
    assert len(case["rows"]) == 5 and all(row["truth"] > 0 for row in case["rows"])
    assert set(figures["medians"]) == {"refitted", "from starts"}


@pytest.mark.slow
def test_kinds_beside_the_truth(tmp_path):
    experiment("public/kinds.py", "--results", str(tmp_path))
    (case,) = json.loads((tmp_path / "kinds.json").read_text())["figures"].values()
    best = case["best"]["closed form"]
    assert best["true"] > 0 and best["promised"] <= case["chosen"]["promised"]


@pytest.mark.slow
def test_the_run_and_going_on(tmp_path, measured):
    if not (measured / "silverbox").is_dir():
        pytest.skip("silverbox is not there")
    command = ("public/run.py", "--results", str(tmp_path))
    done = experiment(*command)
    assert "ours, best" in done.stdout and "PNLSS (paper)" in done.stdout
    path = tmp_path / "public.json"
    text = path.read_text()
    assert str(ROOT) not in text and str(tmp_path) not in text
    figures = json.loads(text)["figures"]
    (row,) = figures["rows"]
    for column in ("hidden states", "identify", "GRU"):
        assert row[column]["test"]["arrow"]["samples"] == 350
        assert [one["column"] for one in row["scored"]].count(column) == 1
    assert (tmp_path / "public.png").stat().st_size > 10_000
    # A second run finds nothing to do, and scores nothing again.
    experiment(*command)
    assert json.loads(path.read_text())["figures"] == figures
