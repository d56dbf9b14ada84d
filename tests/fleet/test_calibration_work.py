"""Calibrations as work of a sweep: rows beside `calibrate`, folders that go on."""

import dataclasses
import pickle

import numpy as np
import pytest
from fleet_problems import coefficients, engine, learnt

import jaxnarx as jnx
from jaxnarx.data import join
from jaxnarx.errors import DataError, SpecError
from jaxnarx.fleet import CalibrationWork
from jaxnarx.sweep import run_sweep

NUMBERS = 10, 40


@pytest.fixture(scope="module")
def engines():
    """One with a second record, one without files, one too short to be judged."""
    theta = coefficients(3, 5)
    second = engine(theta[0], 90, 8)
    second = dataclasses.replace(
        second, records=(dataclasses.replace(second.records[0], name="second"),)
    )
    return {
        "two": join([engine(theta[0], 120, 7), second]),
        "none": DataError("there is no such file"),
        "short": engine(theta[2], 42, 9),
    }


@pytest.fixture(scope="module")
def work(engines):
    return CalibrationWork(learnt().value, engines, NUMBERS)


def test_rows_are_calibrations_judged_by_what_calibrated_none(work, engines):
    prior = learnt().value
    assert [tuple(m.values()) for m in work.members[:3]] == [
        ("two", 10),
        ("two", 40),
        ("none", 10),
    ]
    rows = work.run(range(6))
    assert [set(row) for row in rows] == [set(rows[0])] * 6
    one = engines["two"]
    for number, row in zip(NUMBERS, rows, strict=False):
        record = one.records[0]
        few = jnx.Dataset.from_arrays(
            record.u[: 2 + number, 0],
            record.y[: 2 + number, 0],
            inputs="u",
            outputs="y",
            sample_time=one.sample_time,
        )
        known = jnx.fleet.calibrate(prior, few)
        assert row["y_way"] == known.stats["way"]["y"]
        assert row["distance"] == pytest.approx(known.stats["distance"])
        for kind, network in (("free_run", known.value), ("as_is", prior.network)):
            run = jnx.simulate(network, one).value
            begin = 2 + max(NUMBERS), 2
            y = np.concatenate([r.y[b:, 0] for r, b in zip(one, begin, strict=True)])
            pairs = zip(run.outputs, begin, strict=True)
            found = np.concatenate([a[b:, 0] for a, b in pairs])
            error = np.sqrt(np.mean((found - y) ** 2)) / y.std()
            assert row[f"y_{kind}"] == pytest.approx(error, rel=1e-9)
    assert rows[1]["y_free_run"] < 0.5 * rows[1]["y_as_is"]
    for row, said in ((rows[2], "no such file"), (rows[4], "no sample of y is left")):
        assert row["status"] == "nonfinite_data" and said in row["detail"]
        assert row["y_free_run"] is None and row["y_way"] == ""


def test_a_folder_goes_on_with_the_same_engines_alone(work, engines, tmp_path):
    first = run_sweep(pickle.loads(pickle.dumps(work)), tmp_path, chunk=2)
    again = run_sweep(work, tmp_path, chunk=2)
    assert first.value.arrow.equals(again.value.arrow) and len(first.value) == 6
    other = CalibrationWork(work.prior, dict(list(engines.items())[:2]), NUMBERS)
    with pytest.raises(Exception, match="holds another sweep"):
        run_sweep(other, tmp_path)


@pytest.mark.parametrize("samples", [(), (20, 10), (0, 5), (5, 5)])
def test_numbers_of_samples_rise(engines, samples):
    with pytest.raises(SpecError, match="samples must rise"):
        CalibrationWork(learnt().value, engines, samples)
    with pytest.raises(SpecError, match="at least one engine"):
        CalibrationWork(learnt().value, {}, NUMBERS)
