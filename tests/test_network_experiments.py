"""Experiments on multi-model networks run with `--smoke`; see `test_experiments.py`."""

import json
import sys

import equinox as eqx
import jax
import numpy as np
import pytest
from smoke import ROOT, assert_target, experiment, run

import jaxnarx as jnx

PLACES = "benchmarks", "thesis"


@pytest.mark.slow
def test_local_models_of_chapter_6(tmp_path):
    done = experiment("thesis/chapter6_local_models.py", "--results", str(tmp_path))
    assert "thesis: 5" in done.stdout
    figures = json.loads((tmp_path / "chapter6_local_models.json").read_text())[
        "figures"
    ]
    for row in figures["rows"]:
        if row["series"] == "local linear, F":
            # A linear term is one multiplication in each of four local models.
            assert len(row["terms"]) == 4
            assert row["cost"]["multiplications"] == row["cost"]["regressors"]
        if row["series"] == "MLP NOE":
            # 27 variables into two units, two out.
            assert row["cost"]["multiplications"] == 27 * 2 + 2
            assert row["validation"]["one_step"]["r2"] > 0
    assert {row["output"] for row in figures["summary"]} == {"TRQ", "AFR"}
    assert (tmp_path / "chapter6_local_models.png").stat().st_size > 10_000


@pytest.mark.slow
def test_lolimot_of_chapter_6(tmp_path):
    experiment("thesis/chapter6_lolimot.py", "--results", str(tmp_path))
    content = json.loads((tmp_path / "chapter6_lolimot.json").read_text())
    rows = content["figures"]["rows"]
    assert [row["models"] for row in rows] == [1, 1, 2, 2]
    found: dict[str, list[float]] = {}
    for row in rows:
        r2 = row["validation"]["free_run"]["r2"]
        found.setdefault(row["series"], []).append(r2)
    plain, refined = found["NMSE splits"], found["NMSE splits, refined"]
    # The validation record guards the refinement.
    assert all(b >= a - 1e-9 for a, b in zip(plain, refined, strict=True))
    assert (tmp_path / "chapter6_lolimot.png").stat().st_size > 10_000


@pytest.mark.slow
def test_forward_model_of_chapter_7(tmp_path):
    experiment("thesis/chapter7_forward.py", "--results", str(tmp_path))
    content = json.loads((tmp_path / "chapter7_forward.json").read_text())
    rows = content["figures"]["rows"]
    trees = [row for row in rows if "regions" in row]
    assert {row["series"] for row in trees} == {
        *("axis tree, ERR", "axis tree, ERR, refined", "given tree, ERR")
    }
    assert all(len(row["regions"]) == len(row["terms"]) == 3 for row in trees)
    assert {row["series"] for row in rows} > {"MLP NARX", "MLP NOE"}
    assert all(row["validation"]["one_step"]["r2"] > 0 for row in rows)
    assert (tmp_path / "chapter7_forward.png").stat().st_size > 10_000


@pytest.mark.slow
def test_tasks_of_the_thesis_by_identify(tmp_path):
    command = "thesis/by_identify.py", "--tasks", "6.4", "--results", str(tmp_path)
    experiment(*command)
    path = tmp_path / "by_identify.json"
    figures = json.loads(path.read_text())["figures"]
    rows = {row["series"]: row for row in figures["rows"]}
    assert set(rows) == {"identify", "best linear OE", "perceptron"}
    (found,) = figures["summary"]
    assert (found["task"], found["output"], found["thesis"]) == ("6.4", "TRQ", None)
    for series, row in rows.items():
        assert row["scored"]["date"]
        # Both are scored on the same samples: all behind those where nothing counts.
        assert row["test"]["free_run"]["samples"] == 300 - 100
        assert found[series]["r2"]["median"] == row["test"]["free_run"]["r2"]
    ours, theirs = (found[s]["r2"]["median"] for s in ("identify", "perceptron"))
    assert found["ahead_of_both"] == (ours > theirs)
    # A second run scores nothing again.
    experiment(*command)
    assert json.loads(path.read_text())["figures"] == figures


@pytest.mark.slow
def test_perceptrons_in_a_batch_are_those_alone(tmp_path):
    sys.path[:0] = [str(ROOT / "experiments" / place) for place in PLACES]
    from neural import Budget, Lesson, train  # pyright: ignore

    rng = np.random.default_rng(0)
    us = [rng.normal(size=(60, 1)) for _ in range(2)]
    ys = [np.tanh(np.cumsum(u, axis=0) / 5) for u in us]
    data = jnx.Dataset.from_arrays(us, ys, inputs=["u"], outputs=["y"], sample_time=1.0)
    pool = jnx.polynomial_pool(data.channels, input_lags=[1], output_lags=[1], degree=1)
    lessons = [
        Lesson(pool, data[:1], data[1:], width, jax.random.key(width))
        for width in (2, 3)
    ]
    budget = Budget(20, 10, 0, (5,))
    # The optimisers are optax's, whose schedules mix types.
    with jax.numpy_dtype_promotion("standard"):
        batch = train(lessons, budget)
        singles = [train([lesson], budget)[0] for lesson in lessons]
    for lesson, found, alone in zip(lessons, batch, singles, strict=True):
        for kind, model in found.items():
            assert model.net.width_size == lesson.width
            both = (jax.tree.leaves(m.net) for m in (model, alone[kind]))
            for a, b in zip(*both, strict=True):
                if eqx.is_array(a):
                    # Sums of a batch round differently; Adam carries that on.
                    np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_inverse_of_chapter_7(tmp_path):
    done = experiment("thesis/chapter7_inverse.py", "--results", str(tmp_path))
    assert "refined lower by" in done.stdout
    content = json.loads((tmp_path / "chapter7_inverse.json").read_text())
    (row,) = content["figures"]["rows"]
    assert set(row["inverse"]["direct"]["test"]["free_run"]) == {"SA", "THR"}
    # What knows more cannot be told worse: the bound has all but the spark exactly.
    spark = row["spark"]
    assert spark["bound"]["fit"] > spark["bound_with_our_torque_error"]["fit"]
    assert spark["sensitivity"]["far"] > 3 * spark["sensitivity"]["near"]
    # Feedforward by the model is guarded on the model.
    assert row["compensate"]["end"] <= row["compensate"]["start"] * (1 + 1e-9)
    assert set(row["bed"]) == set(row["mismatch"][0])
    assert {one["target"] for one in content["figures"]["diesel"]} == {"W_c", "p_im"}
    for name in ("data", "fits", "spark", "tracking", "unity", "diesel"):
        figure = tmp_path / f"chapter7_inverse_{name}.png"
        assert figure.stat().st_size > 10_000


@pytest.mark.slow
def test_trees_without_peers(tmp_path):
    figures = run("trees.py", results=tmp_path / "results")["trees"]
    (surface,) = figures["surface"]["runs"]
    assert {row["models"] for row in surface.values()} == {6}
    # Cuts across one variable cannot follow the bend, whichever method places them.
    turned = surface["sigmoid tree"]["nrmse"]
    straight = min(surface[r]["nrmse"] for r in ("LOLIMOT", "sigmoid tree, straight"))
    assert surface["sigmoid tree, refined"]["nrmse"] <= turned < 0.040 < straight
    assert figures["fraction"]["models"] == 4
    for row in figures["targets"].values():
        assert_target(row)


@pytest.mark.slow
def test_growth_without_peers(tmp_path, measured):
    figures = run("growth.py", results=tmp_path / "results")["growth"]
    (row,) = figures["growth"].values()
    assert row["ours"]["models"] == 4
    assert_target(row["limit_s"])
    assert {figures["gengine1"][k]["models"] for k in ("LOLIMOT", "sigmoid tree")} == {
        8
    }


@pytest.mark.slow
def test_an_own_loss_and_other_solvers(tmp_path):
    experiment("nelles/own_loss.py", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "own_loss.json").read_text())["figures"]
    (row,) = figures["rows"]
    for kind, solver in (("squares", "optimistix"), ("own loss", "optax")):
        assert row[kind][solver] < row[kind]["start"]


@pytest.mark.slow
def test_refinement_on_virtual_engines(tmp_path):
    experiment("refinement/engines.py", "--results", str(tmp_path))
    figures = json.loads((tmp_path / "engines.json").read_text())["figures"]
    (found,) = figures["summary"].values()
    assert found["seeds"] == 1 and found["validation_worse"] == 0


@pytest.mark.slow
def test_figures_of_single_models(tmp_path):
    done = experiment("thesis/multi_model_figures.py", "--results", str(tmp_path))
    assert "Table 6.1, ERR" in done.stdout
    content = json.loads((tmp_path / "multi_model_figures.json").read_text())
    table = content["figures"]["table_6_1"]
    assert len(table["ERR"]) == 6 >= len(table["F"])  # the constant as well
    assert all(row["ERR"] > 0 for rows in table.values() for row in rows)
    drawn = list(tmp_path.glob("chapter*.png"))
    assert len(drawn) == 12 and all(f.stat().st_size > 10_000 for f in drawn)
