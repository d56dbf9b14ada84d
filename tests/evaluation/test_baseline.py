"""The linear model beside a network, and how far data leave the trained range."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from common import BRIEF, Part, from_rows, network

from jaxnarx.data import Dataset
from jaxnarx.evaluation import report
from jaxnarx.evaluation.baseline import BASELINE_NAME
from jaxnarx.evaluation.extrapolation import find_outside, held_notes, range_notes
from jaxnarx.evaluation.rows import Row
from jaxnarx.models import hold_to_range
from jaxnarx.simulation import simulate


def record(seed, slope=0.5, extent=1.0, samples=150):
    """y(t) = slope y(t-1) + 0.4 a(t) + 3 without noise; b and w play no part."""
    rng = np.random.default_rng(seed)
    u = extent * rng.uniform(-20, 20, (samples, 2)) * [1.0, 0.25]
    y = np.zeros((samples, 2))
    for t in range(1, samples):
        y[t, 0] = slope * y[t - 1, 0] + 0.4 * u[t, 0] + 3
    return u, y + [0, 1] * rng.normal(size=(samples, 2))


def dataset(*records) -> Dataset:
    return from_rows([np.hstack(pair) for pair in records])


# Poor on purpose: what it predicts must not matter to the linear model.
POOR = network([Part([[((0, 1), 0.5), ((0, 3), 0.1)]])])


def beside(train, test, net=POOR):
    parts = {"train": train, "test": test}
    found = report(net, parts, **BRIEF)
    (row,) = found.beside[BASELINE_NAME]
    return found, row


def test_it_is_exact_on_a_linear_system_and_only_scores_what_the_network_does():
    train, test = dataset(record(1), record(2)), dataset(record(3))
    valid = test.records[0].valid.copy()
    valid[60:70, 2] = False
    masked = dataclasses.replace(test.records[0], valid=valid)
    found, row = beside(train, dataclasses.replace(test, records=(masked,)))
    # Rounding of least squares and of a stable recursion.
    assert row.nrmse == pytest.approx(0, abs=1e-9)
    assert row.samples == found.pooled_row("y").samples
    assert found.verdict.findings and "linear model" in str(found.verdict.findings)
    assert BASELINE_NAME in found.table


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
    assert found.beside["other"] == (own.pooled_row("y"),)
    assert BASELINE_NAME not in found.beside  # nothing to fit it to


def row(part, extrapolated, **more) -> Row:
    figures = dict.fromkeys(("rmse", "nrmse", "r2", "fit", "nmse"), 0.1)
    counts = dict(samples=200, limited=0, extrapolated=extrapolated, status="ok")
    place = dict(part=part, output="y", unit="", mode="free run", record="pooled")
    return Row(**(place | figures | counts | more))  # pyright: ignore


def test_data_outside_the_trained_range_are_told_once_a_part_and_how_far():
    rows = [row("train", 0), row("test", 30), row("test", 40, output="w")]
    rows += [row("test", 200, record="r1"), row("train", 99, mode="one step")]
    found = find_outside(
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
    (note,) = range_notes(rows, found, outside="hold")
    assert "at whose edge the model's limits hold its inputs" in note


def test_records_held_at_their_range_are_told_most_of_it_first():
    rows = [row("test", 0, held=10), row("test", 0, record="r0", held=4)]
    rows += [row("test", 0, record=f"r{n}", held=n, samples=20) for n in range(1, 7)]
    rows += [row("test", 0, record="r9", held=1, samples=101)]
    rows += [row("train", 0), row("train", 0, record="r7", held=1, mode="one step")]
    (note,) = held_notes(rows)
    assert note == (
        "y, test, free run: 30 % of the samples of record r6, 25 % of the samples of "
        "record r5, 20 % of the samples of record r4, 15 % of the samples of record r3 "
        "and 3 more records were held at the edge of the trained range (5 % of all)."
    )
    assert held_notes([row("test", 0)]) == []


def test_a_report_tells_what_the_limits_of_a_model_hold():
    low, high = jnp.array([-20.0, -20, 5, -150]), jnp.array([20.0, 20, 15, 150])
    narrow = dataclasses.replace(POOR, low=low, high=high)
    data = dataset(record(3))
    found, free = (
        report(hold_to_range(net, margin), data, stability=False, diagnostics=False)
        for net, margin in ((narrow, 0.1), (narrow, None))
    )
    run = simulate(hold_to_range(narrow, 0.1, outside="hold"), data)
    own = found.pooled_row("y")
    assert own.held == run.stats["held"].sum() > 0 == free.pooled_row("y").held
    assert found.limits == pytest.approx(0.1) and free.limits is None
    share = f"{100 * own.held / own.samples:.3g} %"
    notes = [n for n in found.notes if "held at the edge" in n]
    assert len(notes) == 1 and f"{share} of the samples of record" in notes[0]
    assert not any("held at the edge" in n for n in free.notes)
    assert found.to_dict()["rows"][0]["held"] >= 0
