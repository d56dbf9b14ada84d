"""New engines from few samples; files; folders; bad donors and engines."""

import dataclasses

import numpy as np
import pytest
from fleet_problems import (
    MEAN,
    SAMPLE_TIME,
    coefficients,
    donors,
    engine,
    learnt,
    structure,
)

import jaxnarx as jnx
from jaxnarx.errors import DataError, ModelFileError, SpecError
from jaxnarx.fleet.rivals import at_samples

NEW = coefficients(12, 77)


def error_of(network: jnx.Network, theta: np.ndarray) -> float:
    """NRMSE of the free run on records without noise."""
    truth = engine(theta, 300, 5, noise=0.0)
    runs = jnx.prepare(network, truth)
    y, run = np.asarray(runs.measured)[0], np.asarray(jnx.free_run(network, runs))[0]
    return float(np.sqrt(np.mean((y - run)[5:300] ** 2)) / y[5:300].std())


def test_ten_samples_tell_most_of_a_new_engine():
    prior = learnt().value
    known, alone, mean = [], [], []
    for n, theta in enumerate(NEW):
        few = engine(theta, 12, 900 + n)
        found = jnx.fleet.calibrate(prior, few)
        assert found.is_okay and found.stats["samples"]["y"] == 10
        known.append(error_of(found.value, theta))
        mean.append(error_of(prior.network, theta))
        pool = jnx.Pool(
            *(
                prior.network.variables,
                np.asarray(prior.network.models[0].local.factor),
            ),
            few.channels,
            (0,),
        )
        many = engine(theta, 200, 900 + n)
        alone.append(error_of(jnx.grow(pool, many, jnx.Global()).value, theta))
    assert np.median(known) < 6 * np.median(alone)
    assert np.median(known) < 0.2 * np.median(mean)


def test_a_member_is_near_the_fleet_and_a_stranger_is_not():
    prior = learnt().value
    own = jnx.fleet.calibrate(prior, engine(NEW[0], 60, 3))
    assert own.stats["probability"] > 1e-3
    assert own.stats["distance"] < 2 * own.stats["expected"] + 1
    other = jnx.fleet.calibrate(prior, engine(MEAN * [1, -1, 1, 4], 60, 3))
    assert other.stats["probability"] < 1e-6
    assert "it may be none of it" in other.detail
    # its own samples say what it is, the more of them the better
    many = jnx.fleet.calibrate(prior, engine(MEAN * [1, -1, 1, 4], 400, 3))
    assert many.stats["way"]["y"] == "own fit"
    assert error_of(many.value, MEAN * [1, -1, 1, 4]) < 0.05


def test_more_samples_are_never_much_worse():
    prior = learnt().value
    errors = [
        np.median(
            [
                error_of(jnx.fleet.calibrate(prior, engine(t, n, 900 + k)).value, t)
                for k, t in enumerate(NEW[:6])
            ]
        )
        for n in (8, 30, 120)
    ]
    assert errors[2] < 1.1 * errors[0]


def test_intervals_hold_what_they_promise():
    prior = learnt().value
    inside = []
    for n, theta in enumerate(NEW):
        network = jnx.fleet.calibrate(prior, engine(theta, 25, 900 + n)).value
        data = engine(theta, 300, 40 + n)
        found = jnx.intervals(network, data, level=0.9).value
        y = data.records[0].y[5:]
        inside.append((y >= found.lower[0][5:]) & (y <= found.upper[0][5:]))
    assert 0.8 < np.mean(inside) < 0.99


def test_few_samples_that_say_nothing():
    prior = learnt().value
    none = jnx.fleet.calibrate(prior, engine(NEW[0], 3, 1)[:1])
    assert none.status_name == "ok" and none.stats["samples"] == {"y": 1}
    u = np.zeros(30)
    rest = jnx.Dataset.from_arrays(
        u, np.full(30, 3.0), inputs="u", outputs="y", sample_time=SAMPLE_TIME
    )
    found = jnx.fleet.calibrate(prior, rest)
    assert found.is_okay and np.isfinite(error_of(found.value, NEW[0]))
    with pytest.raises(SpecError, match="sample time"):
        slow = dataclasses.replace(engine(NEW[0], 30, 1), sample_time=1.0)
        jnx.fleet.calibrate(prior, slow)


def test_prior_is_read_as_it_was_written(tmp_path):
    prior = learnt().value
    path = tmp_path / "line.fleet"
    jnx.fleet.save_prior(prior, path)
    again = jnx.fleet.load_prior(path)
    few = engine(NEW[1], 25, 3)
    one, other = (jnx.fleet.calibrate(p, few) for p in (prior, again))
    np.testing.assert_array_equal(
        one.stats["coefficients"], other.stats["coefficients"]
    )
    assert str(prior) == str(again)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ModelFileError, match="damaged"):
        jnx.fleet.load_prior(path)
    with pytest.raises(ModelFileError, match="no such file"):
        jnx.fleet.load_prior(tmp_path / "none.fleet")


def test_a_stopped_call_goes_on_in_its_folder(tmp_path):
    seen = []

    def stop(event):
        seen.append(event["done"])
        if len(seen) == 9:
            raise KeyboardInterrupt

    given = donors(), structure()
    with pytest.raises(KeyboardInterrupt):
        jnx.fleet.learn(*given, folder=tmp_path, progress=stop, rungs=(5, 20))
    asked = []

    class Counted(dict):
        def __getitem__(self, name):
            asked.append(name)
            return super().__getitem__(name)

    counted = Counted(donors())
    found = jnx.fleet.learn(counted, structure(), folder=tmp_path, rungs=(5, 20))
    whole = jnx.fleet.learn(*given, rungs=(5, 20))
    for field in dataclasses.fields(whole.value.population):
        one, other = (getattr(p.value.population, field.name) for p in (found, whole))
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(found.value.ladder, whole.value.ladder)
    with pytest.raises(SpecError, match="other"):
        jnx.fleet.learn(donors(samples=100), structure(True), folder=tmp_path)


def test_donors_that_cannot_be_used_are_named():
    every: dict[str, jnx.Dataset | DataError] = dict(donors())
    odd = donors()["engine 0"]
    every["without u"] = jnx.Dataset.from_arrays(
        *(odd.records[0].u, odd.records[0].y),
        **{"inputs": "w", "outputs": "y", "sample_time": SAMPLE_TIME},
    )
    every["slow"] = dataclasses.replace(odd, sample_time=1.0)
    every["broken file"] = DataError("line 7 cannot be read")
    every["short"] = odd[:1]
    y = 40 * odd.records[0].y
    every["other unit"] = jnx.Dataset.from_arrays(
        odd.records[0].u, y, inputs="u", outputs="y", sample_time=SAMPLE_TIME
    )
    found = jnx.fleet.learn(every, structure(), rungs=(5, 20))
    assert found.is_okay
    broken = found.stats["broken"]
    assert {"without u", "slow", "broken file", "other unit"} == set(broken)
    assert "line 7" in broken["broken file"]
    one, other = learnt().value.population, found.value.population
    np.testing.assert_allclose(other.noise, one.noise, rtol=0.02)


def test_one_donor_says_little_and_none_nothing():
    found = jnx.fleet.learn({"one": donors()["engine 0"]}, structure(), rungs=(5,))
    assert found.status_name == "unidentifiable" and "1 donor" in found.detail
    again = jnx.fleet.calibrate(found.value, engine(NEW[0], 40, 1))
    assert np.isfinite(error_of(again.value, NEW[0]))
    with pytest.raises(SpecError, match="at least one donor"):
        jnx.fleet.learn({}, structure())
    with pytest.raises(SpecError, match="rungs"):
        jnx.fleet.learn(donors(), structure(), rungs=(20, 5))
    with pytest.raises(DataError, match="line 7"):
        jnx.fleet.learn({"a": DataError("line 7")}, structure())


def test_feedback_that_differs_is_linearised_again():
    every = donors(fed=0.5)
    found = jnx.fleet.learn(every, structure(True), feedback=True, rungs=(5, 20))
    assert found.is_okay and found.stats["passes"] > 1
    few = engine(NEW[0], 40, 3, 0.5)
    network = jnx.fleet.calibrate(found.value, few).value
    truth = engine(NEW[0], 300, 5, 0.5, noise=0.0)
    runs = jnx.prepare(network, truth)
    y, run = np.asarray(runs.measured)[0], np.asarray(jnx.free_run(network, runs))[0]
    assert np.sqrt(np.mean((y - run)[:300] ** 2)) / y[:300].std() < 0.1


def test_rows_between_rungs():
    table = np.array([[0.0], [1.0], [2.0]])
    rungs = (10, 100, 1000)
    assert at_samples(rungs, table, 5)[0] == 0.0
    assert at_samples(rungs, table, 100)[0] == 1.0
    assert at_samples(rungs, table, 1e9)[0] == 2.0
    np.testing.assert_allclose(at_samples(rungs, table, np.sqrt(1000.0)), [0.5])
