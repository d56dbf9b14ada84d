"""Inputs of the data that judge beside those of the training."""

import numpy as np
import pytest
from problems import data, fitted, records

import jaxnarx as jnx
from jaxnarx.evaluation import Chart, Curve, FreeRun
from jaxnarx.evaluation._input_densities import BINS, input_densities


def run_of(u, training) -> FreeRun:
    """A free run over inputs `u`, beside a training."""
    judged = records("tiny", u, np.zeros(len(u)))
    return FreeRun(None, "test", judged, (), [], training)


def test_table_is_ranges_share_outside_and_overlap():
    training = records(
        "tiny", np.c_[np.linspace(0, 1, 500), np.arange(500)], np.zeros(500)
    )
    u = np.c_[np.linspace(0.5, 1.5, 400), np.linspace(0, 499, 400)]
    section = input_densities(run_of(u, training))
    assert section is not None
    moved, same = section.rows
    assert moved[:5] == ("u1", 0.0, 1.0, 0.5, 1.5)
    assert moved[5] == pytest.approx(100 * np.mean(u[:, 0] > 1))
    assert moved[6] == pytest.approx(0.5, abs=0.03)  # half of each is common
    share, overlap = same[5:]
    assert share == 0.0 and isinstance(overlap, float) and overlap > 0.9
    assert section.sentences == (
        "Values of u1 are spread differently in test data than in training.",
    )
    (chart,) = section.charts
    assert isinstance(chart, Chart)
    curves = [mark for mark in chart.marks if isinstance(mark, Curve)]
    assert [curve.name for curve in curves] == ["training", "test"]
    for curve in curves:
        assert isinstance(curve.x, np.ndarray)
        assert len(curve.x) == 2 * BINS
        assert np.sum(np.asarray(curve.points[1])) == pytest.approx(
            200.0
        )  # every bin has two points


def test_inputs_that_never_move_and_values_that_are_missing():
    u = np.c_[np.full(50, 2.0), np.where(np.arange(50) < 25, 0.0, np.nan)]
    training = records("tiny", u, np.zeros(50), missing="mask")
    section = input_densities(run_of(np.full((30, 2), 2.0), training))
    assert section is not None
    resting, gone = section.rows
    assert resting == ("u1", 2.0, 2.0, 2.0, 2.0, 0.0, 1.0)
    assert gone == ("u2", 0.0, 0.0, 2.0, 2.0, 100.0, 0.0)
    assert len(section.charts) == 1


def test_without_training_or_with_the_training_alone_there_is_none():
    u = np.random.default_rng(0).normal(size=(40, 2))
    assert input_densities(run_of(u, None)) is None
    run = run_of(u, None)
    own = FreeRun(None, "train", run.data, (), [], run.data)
    assert input_densities(own) is None


def test_a_report_shows_them(tmp_path):
    network, train = fitted("tiny", "global").value, data()
    far = records("tiny", np.asarray(next(iter(train)).u) + 0.5, next(iter(train)).y)
    parts = {"train": train, "test": far}
    report = jnx.report(network, parts, stability=False, diagnostics=False)
    assert list(report.sections) == ["inputs"]
    assert "Inputs beside the training" in str(report)
    table = report.to_dict()["sections"]["inputs"]["table"]
    assert [row["input"] for row in table] == ["u1", "u2"]
    assert all(row["outside %"] > 0 for row in table)
