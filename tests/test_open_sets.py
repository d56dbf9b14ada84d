"""The table of open sets: splits, what is scored and from where a run begins."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from smoke import ROOT, experiment

import jaxnarx as jnx
from jaxnarx.identification import read_search

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments" / "open_sets"))
from own import best_linear, chosen  # noqa: E402 # pyright: ignore
from packed import pack, unpack  # noqa: E402 # pyright: ignore
from peers import history, lags_to  # noqa: E402 # pyright: ignore
from score import (  # noqa: E402 # pyright: ignore
    errors,
    far,
    free_runs,
    held_back,
    part_scores,
    scores,
)
from sets import READERS, OpenSet, Part  # noqa: E402 # pyright: ignore
from table import compared, summary  # noqa: E402 # pyright: ignore

LONG = 30
"""Longest lag of the network of these tests, of an input."""


@pytest.fixture(scope="module")
def data() -> jnx.Dataset:
    """Two records of a slow first-order system, with an output that is not modelled."""
    rng = np.random.default_rng(3)
    us = [rng.normal(size=(n, 1)) for n in (120, 100)]
    ys = [rng.normal(size=(len(u), 2)) for u in us]
    return jnx.Dataset.from_arrays(
        us, ys, inputs=["u"], outputs=["other", "y"], sample_time=0.1
    )


@pytest.fixture(scope="module")
def network(data) -> jnx.Network:
    """Of `y` alone, from y[t-1], y[t-2], u[t-1] and u[t-30]."""
    pool = jnx.polynomial_pool(
        *(data.channels,),
        outputs=["y"],
        input_lags=(1, LONG),
        output_lags=(1, 2),
        degree=1,
    )
    selection = jnx.select(pool, data, jnx.ForwardOLS(max_terms=4)).value
    return jnx.grow(selection, data, jnx.Global()).value


@pytest.fixture(scope="module")
def short(data) -> jnx.Network:
    """Of `y` alone, from y[t-1] and u[t-1]."""
    pool = jnx.polynomial_pool(
        data.channels, outputs=["y"], input_lags=(1,), output_lags=(1,), degree=1
    )
    selection = jnx.select(pool, data, jnx.ForwardOLS(max_terms=3)).value
    return jnx.grow(selection, data, jnx.Global()).value


def scored(networks: list[jnx.Network], part: Part, scale: float = 1.0) -> list[dict]:
    """Errors of `y` on one part."""
    runs = [
        jnx.simulate(network, held_back(network, part)).value for network in networks
    ]
    return part_scores(runs, part, "y", scale)


def oracle(network: jnx.Network, record, first: int) -> np.ndarray:
    """The same recursion, sample by sample, from measurements before `first`."""
    (model,) = network.models
    names = list(network.variable_names)
    coefficient = np.asarray(model.local.dense())[0]
    gain = dict(zip(network.channels.names, np.asarray(network.gain), strict=True))
    y, u = record.y[:, 1].copy(), record.u[:, 0]
    for t in range(first, len(y)):
        value = {"1": 1.0, "u[t-1]": u[t - 1], f"u[t-{LONG}]": u[t - LONG]}
        value |= {"y[t-1]": y[t - 1], "y[t-2]": y[t - 2]}
        total = 0.0
        for term, theta in zip(
            np.asarray(model.local.factor), coefficient, strict=True
        ):
            for i in term[term > 0]:
                name = names[i - 1]
                theta = theta * value[name] / gain[name.partition("[")[0]]
            total += theta
        y[t] = gain["y"] * total
    return y


def test_errors_are_those_of_the_counted_samples():
    rng = np.random.default_rng(0)
    y, run = [rng.normal(size=n) for n in (30, 20)], [np.zeros(30), np.ones(20)]
    counted = [np.arange(n) >= 10 for n in (30, 20)]
    row = errors(y, run, counted, scale=1000.0)
    e = np.concatenate([y[0][10:], y[1][10:] - 1])
    root = np.sqrt(np.mean(e**2))
    spread = np.concatenate([y[0][10:], y[1][10:]]).std()
    # The table keeps five digits.
    assert row["samples"] == 30
    np.testing.assert_allclose(row["rmse"], 1000 * root, rtol=1e-4)
    np.testing.assert_allclose(row["nrmse"], root / spread, rtol=1e-4)
    run[0][5] = np.nan
    assert errors(y, run, counted, scale=1000.0) == row
    run[0][15] = np.inf
    assert errors(y, run, counted)["nrmse"] is None


def test_a_run_far_from_the_training_has_diverged():
    train, run = [np.linspace(0, 1, 5)], np.zeros(8)
    for value, diverged in ((10.9, False), (11.1, True), (np.nan, True)):
        run[6] = value
        assert far(run, train, 3) == diverged
    # What begins the run is not its own.
    assert not far(run, train, 7)


def test_a_run_begins_with_the_last_measurements_before_the_first_score(data, network):
    first = 50
    runs = [oracle(network, record, first) for record in data]
    counted = [np.arange(len(y)) >= first for y in runs]
    expected = errors([r.y[:, 1] for r in data], runs, counted)
    row = scored([network], Part(data, first))[0]
    assert row["late"] == row["diverged"] == 0
    assert row["samples"] == sum(len(r) - first for r in data)
    # Rounded to five digits on both sides.
    np.testing.assert_allclose(row["nrmse"], expected["nrmse"], rtol=2e-5)
    # The system forgets slowly enough for the beginning to be seen in the figure.
    early = [oracle(network, record, LONG) for record in data]
    other = errors([r.y[:, 1] for r in data], early, counted)["nrmse"]
    assert abs(other - expected["nrmse"]) > 1e-4


def test_the_truth_is_scored_instead_of_the_measurement(data, network):
    runs = [oracle(network, record, 50) for record in data]
    truth = tuple(np.stack([np.zeros_like(y), y], axis=1) for y in runs)
    assert scored([network], Part(data, 50, truth))[0]["nrmse"] < 1e-9


def test_models_of_a_row_are_scored_over_the_samples_that_both_predict(
    data, network, short
):
    # Of 90 and 70 samples due, the network lacks the first five each.
    first = LONG - 5
    late, early = scored([network, short], Part(data, first))
    assert (late["late"], early["late"]) == (10, 0)
    for model, row in ((network, late), (short, early)):
        begin = LONG if model is network else first
        runs = [oracle(model, record, begin) for record in data]
        both = [np.arange(len(y)) >= LONG for y in runs]
        expected = errors([r.y[:, 1] for r in data], runs, both)
        assert row["samples"] == expected["samples"] == 90 + 70
        # Rounded to five digits on both sides.
        np.testing.assert_allclose(row["nrmse"], expected["nrmse"], rtol=2e-5)
    # Alone it is scored over all that is due.
    assert scored([short], Part(data, first))[0]["samples"] == 95 + 75


def test_a_model_that_needs_much_more_history_has_no_figure(data, network, short):
    part = Part(data, LONG - 20)
    late, early = scored([network, short], part)
    assert late["late"] == 2 * 20 and late["samples"] == 0
    assert late["nrmse"] is None and late["rmse"] is None
    # It takes no sample from the other.
    assert early == scored([short], part)[0]
    assert early["samples"] == 110 + 90


def test_scores_of_an_output_by_model_and_part(data, network, short):
    parts = {"a": Part(data, 50), "b": Part(data[:1], LONG - 5)}
    whole = OpenSet("one", data, parts, {"other": "-", "y": "V"}, "", "", 1000.0)
    found = scores([free_runs(m, whole) for m in (network, short)], whole, "y")
    for name, part in parts.items():
        expected = scored([network, short], part, 1000.0)
        assert [rows[name] for rows in found] == expected


def test_peers_get_what_we_get(data, tmp_path):
    truth = tuple(record.y + 1 for record in data)
    parts = {"test": Part(data[1], 7), "noise-free": Part(data, 9, truth)}
    whole = OpenSet("one", data, parts, {"other": "-", "y": "V"}, "", "", 1000.0)
    about = pack(whole, tmp_path / "one.npz")
    assert about["train"] == [120, 100] and about["outputs"] == ["other", "y"]
    task = unpack(str(tmp_path / "one.npz"), "y")
    assert task.scale == 1000.0 and [p.first for p in task.parts.values()] == [7, 9]
    np.testing.assert_array_equal(task.train.y[1], data.records[1].y[:, 1])
    np.testing.assert_array_equal(task.parts["test"].u[0], data.records[1].u)
    np.testing.assert_array_equal(task.parts["test"].truth[0], task.train.y[1])
    found = task.parts["noise-free"].truth[0]
    np.testing.assert_array_equal(found, data.records[0].y[:, 1] + 1)


def test_history_of_the_trees():
    u, memory = np.random.default_rng(1).normal(size=(40, 2)), 12
    assert lags_to(memory) == [0, 1, 2, 3, 4, 6, 8, 12]
    found = history(u, memory)
    for t in (0, 5, 39):
        # Before the record its first row is held.
        past = np.stack([u[max(t - lag, 0)] for lag in range(memory + 1)])
        lags = past[lags_to(memory)].ravel()
        means = [past[a : b + 1].mean(axis=0) for a, b in ((4, 6), (6, 8), (8, 12))]
        expected = np.concatenate([lags, *means])
        np.testing.assert_allclose(found[t], expected, atol=1e-12)


SCORED = {
    "cascaded_tanks": {"test": [974]},
    "ced_coupled_drives": {"test": [90, 90], "low amplitude": [90]},
    "bouc_wen_sysidentpy": {"test": [1598]},
    "daisy_cstr": {"test": [3750]},
    "silverbox": {"multisine": [21_638], "arrow": [40_425]},
    "wiener_hammerstein": {"test": [78_750]},
}
"""Scored samples of the records, counted from the official splits."""


@pytest.mark.parametrize("name", list(READERS))
def test_splits(name, measured):
    if not (measured / name).is_dir():
        pytest.skip(f"{name} is not there")
    found = READERS[name](measured)
    for part, lengths in SCORED[name].items():
        one = found.parts[part]
        assert [len(record) - one.first for record in one.data] == lengths
    for part in found.parts.values():
        assert part.first == 50
        for record in part.data:
            scored = record.y[part.first :, 0]
            for train in found.train:
                # Nothing that is scored has been seen: no stretch of it is in training.
                assert not _holds(train.y[:, 0], scored[:20])


def _holds(long: np.ndarray, short: np.ndarray) -> bool:
    windows = np.lib.stride_tricks.sliding_window_view(long, len(short))
    return bool((windows == short[None]).all(axis=1).any())


def test_scored_rows_of_the_files(measured):
    path = measured / "silverbox" / "SNLS80mV.csv"
    if not path.is_file():
        pytest.skip("silverbox is not there")
    lines = path.read_text().splitlines()[1:]
    found = READERS["silverbox"](measured)
    record = found.parts["arrow"].data.records[0]
    for row in (0, 50, 40_474):
        values = [float(text) for text in lines[100 + row].split(",")[:2]]
        assert [record.u[row, 0], record.y[row, 0]] == values
    last = found.train.records[0].y[-1, 0]
    first = found.parts["multisine"].data.records[0].y[0, 0]
    border = 40_650 + 65_062
    assert [last, first] == [
        float(lines[n].split(",")[1]) for n in (border - 1, border)
    ]


def row_of(own: dict, linear: dict, cross_validated: float) -> dict:
    """A row of the table with these errors by part."""

    def tests(errors: dict) -> dict:
        # 0 stands for a model that is too late for a figure.
        return {
            p: {"nrmse": e or None, "diverged": 0, "samples": 0 if e == 0 else 9}
            for p, e in errors.items()
        }

    row = {"set": "s", "output": "y", "best linear": {"test": tests(linear)}}
    row["jaxnarx"] = {"test": tests(own), "free_run": cross_validated}
    return row | {"compared": compared(row)}


def test_what_the_table_aims_at():
    better = row_of({"a": 0.1, "b": 0.51}, {"a": 0.2, "b": 0.5}, 0.08)
    assert better["compared"]["to linear"] == {"a": 0.5, "b": 1.02}
    assert better["compared"]["test over cross-validated"] == 1.25
    worse = row_of({"a": 0.1, "b": 0.52}, {"a": 0.2, "b": 0.5}, 0.2)
    lost = row_of({"a": None, "b": 0.1}, {"a": 0.2, "b": 0.5}, 0.2)
    late = row_of({"a": 0, "b": 0.1}, {"a": 0.2, "b": 0.5}, 0.2)
    for row, *counts in (
        (better, 0, 0, 0),
        (worse, 1, 0, 0),
        (lost, 1, 1, 0),
        (late, 0, 0, 1),
    ):
        found = summary([row], {})
        names = ("worse than linear", "diverged", "late")
        assert [len(found[name]) for name in names] == counts
    assert summary([better], {})["flattered by"] == {"s y": 1.25}
    assert summary([worse], {})["flattered by"] == {}


def test_rows_of_a_leaderboard(network):
    rows = [
        {"rank": 2, "family": "OE", "free_run": {"y": 0.4}, "network": network},
        {"rank": 3, "family": "OE", "free_run": 0.3, "network": lambda: network},
        {"rank": 1, "family": "tree", "free_run": np.float64(0.2), "operations": 12},
        {"rank": 4, "family": "OE", "free_run": np.inf, "network": network},
    ]
    found = best_linear(rows, "y")
    assert found is not None and found[0] is rows[1] and found[1] is network
    assert best_linear(rows[2:], "y") is None
    expected = {"rank": 1, "family": "tree", "free_run": 0.2, "operations": 12}
    assert chosen(rows, "y") == expected
    rows[0]["chosen"] = True
    assert chosen(rows, "y")["free_run"] == 0.4


@pytest.mark.slow
def test_the_table_and_going_on(tmp_path):
    command = ("open_sets/run.py", "--sets", "engine-pfi-cc", "--peers")
    experiment(*command, "--results", str(tmp_path))
    path = tmp_path / "open_sets.json"
    text = path.read_text()
    assert str(ROOT) not in text and str(tmp_path) not in text
    figures = json.loads(text)["figures"]
    assert [row["output"] for row in figures["rows"]] == ["speed", "P"]
    for row in figures["rows"]:
        tests = row["jaxnarx"]["test"]
        assert set(tests) == {"test", "noise-free"}
        assert all(one["samples"] == 2 * 350 for one in tests.values())
        assert [one["column"] for one in row["scored"]].count("jaxnarx") == 1
        assert set(row["scored"][0]) == {"column", "date", "commit", "dirty"}
    assert figures["summary"]["rows"] == 2
    # A second run finds nothing to do, and scores nothing again.
    experiment(*command, "--results", str(tmp_path))
    assert json.loads(path.read_text())["figures"] == figures


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sum", "hidden states"])
def test_what_a_kind_of_candidate_gains(kind, tmp_path):
    more = ("--results", str(tmp_path), "--runs", str(tmp_path / "runs"))
    # The last of these has a hidden state; a sum is tried behind them.
    most = {"sum": "12", "hidden states": "20"}[kind]
    experiment("open_sets/gains.py", kind, "--candidates", most, *more)
    (rows,) = json.loads((tmp_path / "gains.json").read_text())["figures"][
        kind
    ].values()
    assert rows["rows"][0]["others"]["test"] > 0
    (board,) = (tmp_path / "runs").iterdir()
    every = read_search(board).leaderboard.rows
    stand = {row.family for row in every if row.eligible}  # the others diverge
    assert ("kind" in rows["rows"][0]) == (kind in stand)
    tried = {row.family for row in every}
    assert kind in tried or kind == "sum"  # which needs two kinds, and a gain
    assert rows["scored"][0]["outputs"] == [rows["rows"][0]["output"]]


@pytest.mark.slow
def test_promises_stand_beside_the_truth(tmp_path):
    experiment("open_sets/promises.py", "--smoke", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "promises.json").read_text())["figures"]
    assert len(figures["rows"]) == 2
    assert all(row["true"] > 0 and row["promised"] > 0 for row in figures["rows"])
    assert figures["true over promised"]["median"] > 0


def test_the_order_takes_what_lowers_errors_most_for_its_seconds():
    from order import ordered, problems  # pyright: ignore[reportMissingImports]

    def row(output, family, name, error, seconds):
        keys = "output", "family", "name", "free_run", "seconds"
        return dict(zip(keys, (output, family, name, error, seconds), strict=True))

    narx = "polynomial NARX"
    board = [
        row("y", "OE", "order 1", 0.4, 0.1),
        row("y", narx, "slow", 0.1, 100.0),
        row("y", narx, "quick", 0.2, 10.0),
        row("y", "LOLIMOT", "given up", None, 1.0),
        row("z", "ARX", "order 1", 0.1, 0.1),
        row("z", narx, "quick", 0.3, 10.0),
        row("all vetoed", "OE", "order 1", None, 0.1),
    ]
    given = problems({"a": {"leaderboard": board}, "b": {}})
    assert len(given) == 2
    found = ordered(given)
    # ln 2 for 20 s; behind it ln 2 more for 100 s; nothing.
    names = [f"{narx}: quick", f"{narx}: slow", "LOLIMOT: given up"]
    assert [one[0] for one in found] == names
    assert [one[1] for one in found] == [2, 1, 1]
    np.testing.assert_allclose([one[2] for one in found], np.log([2, 2, 1]), rtol=1e-12)
    assert [one[3] for one in found] == [20.0, 100.0, 1.0]


@pytest.mark.slow
def test_networks_at_the_edge(tmp_path):
    experiment("edge/run.py", "--results", str(tmp_path))
    (bed,) = json.loads((tmp_path / "edge.json").read_text())["figures"].values()
    (found,) = bed["outputs"].values()
    for policy in ("flag", "hold", "linear"):
        assert found[policy]["wild"]["not finite"] == 0
        assert len(found[policy]["nrmse"]) == len(found["outside"]) == 5
    # more and more of the samples are outside, the farther the inputs reach
    assert found["outside"] == sorted(found["outside"])
    assert -1 <= bed["pooled"]["spearman"] <= 1
    assert 0.8 < found["intervals"]["held"] <= 1


@pytest.mark.slow
def test_plans_beside_records_that_fill_the_space(tmp_path):
    experiment("edge/plans.py", "--results", str(tmp_path))
    (bed,) = json.loads((tmp_path / "plans.json").read_text())["figures"].values()
    (row,) = bed["seeds"]
    assert 0 < row["plan"] and 0 < row["filling"]
    for record in ("plan", "filling"):
        broke = row[f"{record} broke"]
        assert broke["ranges"] == broke["rates"] == broke["forbidden"] == 0


@pytest.mark.slow
def test_a_measured_engine_at_the_edge(tmp_path, measured):
    if not (measured / "gengine1").is_dir():
        pytest.skip("gengine1 is not there")
    experiment("edge/measured.py", "--results", str(tmp_path))
    path = tmp_path / "edge_measured.json"
    (found,) = json.loads(path.read_text())["figures"].values()
    assert 0.5 < found["test"]["held"] <= 1 and found["certificate"]["sequences"] == 10
    assert found["certificate"]["counterexamples"] == 0
    assert all(w["diverged"] == 0 for w in found["wild"].values())
    assert [set(one) >= {"date"} for one in found["scored"]] == [True]
