"""The linear model beside a network, and how far data leave the trained range."""

import dataclasses

import numpy as np
import pytest
from common import Part, network

from jaxnarx.data import Dataset
from jaxnarx.evaluation import report
from jaxnarx.evaluation.baseline import NAME
from jaxnarx.evaluation.outside import outside, range_notes
from jaxnarx.evaluation.rows import Row


def record(seed, slope=0.5, extent=1.0, samples=150):
    """y(t) = slope y(t-1) + 0.4 a(t) + 3 without noise; b and w play no part."""
    rng = np.random.default_rng(seed)
    u = extent * rng.uniform(-20, 20, (samples, 2)) * [1.0, 0.25]
    y = np.zeros((samples, 2))
    for t in range(1, samples):
        y[t, 0] = slope * y[t - 1, 0] + 0.4 * u[t, 0] + 3
    return u, y + [0, 1] * rng.normal(size=(samples, 2))


def dataset(*records) -> Dataset:
    u, y = zip(*records, strict=True)
    inputs, outputs = ["a", "b"], ["y", "w"]
    return Dataset.from_arrays(
        list(u), list(y), inputs=inputs, outputs=outputs, sample_time=0.1
    )


# Poor on purpose: what it predicts must not matter to the linear model.
POOR = network([Part([[((0, 1), 0.5), ((0, 3), 0.1)]])])


def beside(train, test, net=POOR):
    parts = {"train": train, "test": test}
    found = report(net, parts, horizons=(1,), stability=False, diagnostics=False)
    (row,) = found.beside[NAME]
    return found, row


def test_it_is_exact_on_a_linear_system_and_only_scores_what_the_network_does():
    train, test = dataset(record(1), record(2)), dataset(record(3))
    valid = test.records[0].valid.copy()
    valid[60:70, 2] = False
    masked = dataclasses.replace(test.records[0], valid=valid)
    found, row = beside(train, dataclasses.replace(test, records=(masked,)))
    # Rounding of least squares and of a stable recursion.
    assert row.nrmse == pytest.approx(0, abs=1e-9)
    assert row.samples == found.pooled("y").samples
    assert found.verdict.findings and "linear model" in str(found.verdict.findings)
    assert NAME in found.table


def test_one_that_runs_away_is_diverged():
    train = dataset(record(1, slope=1.2, samples=25))
    _, row = beside(train, dataset(record(3, samples=100)))
    assert row.diverged and row.nrmse is None


def test_other_networks_may_stand_beside_it():
    data = dataset(record(3))
    other = network([Part([[((0, 1), 0.4), ((0, 3), 0.5)]])])
    found = report(
        POOR, data, stability=False, diagnostics=False, beside={"other": other}
    )
    own = report(other, data, stability=False, diagnostics=False)
    assert found.beside["other"] == (own.pooled("y"),)
    assert NAME not in found.beside  # nothing to fit it to


def row(part, extrapolated, **more) -> Row:
    figures = dict.fromkeys(("rmse", "nrmse", "r2", "fit", "nmse"), 0.1)
    counts = dict(samples=200, limited=0, extrapolated=extrapolated, status="ok")
    place = dict(part=part, output="y", unit="", mode="free run", record="pooled")
    return Row(**(place | figures | counts | more))  # pyright: ignore


def test_data_outside_the_trained_range_are_told_once_a_part_and_how_far():
    rows = [row("train", 0), row("test", 30), row("test", 40, output="w")]
    rows += [row("test", 200, record="r1"), row("train", 99, mode="one step")]
    found = outside(
        POOR, {"train": dataset(record(1)), "test": dataset(record(2, extent=1.5))}
    )
    assert [o.part for o in found] == ["test", "test"]
    one = next(o for o in found if o.channel == "a")
    # Uniform on +-30 where +-20 was trained: a third is outside, a quarter beyond.
    assert one.trained == (-20.0, 20.0)
    assert one.share == pytest.approx(1 / 3, abs=0.1)
    assert one.beyond == pytest.approx(0.25, abs=0.02)
    (note,) = range_notes(rows, found)
    assert note.startswith("20 % of the test samples lie outside the range")
    assert "a -29" in note and "trained on -20 to 20" in note
    assert range_notes([dataclasses.replace(row("test", 0), samples=0)], found) == []
