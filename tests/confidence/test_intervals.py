"""Prediction intervals: what they hold of fresh records, and where they widen."""

import dataclasses

import numpy as np
import pytest
from common import BRIEF
from test_domain import RECORDS, drawn, fitted, plant, same

import jaxnarx as jnx
from jaxnarx.data import groups
from jaxnarx.errors import ModelFileError, SpecError


def noisy(seed: int, records: int = RECORDS, size: float = 1.0):
    """Errors that are larger where u1 is large."""
    data, rng = plant(drawn(seed, records, size)), np.random.default_rng(seed + 50)
    every = []
    for record in data:
        spread = 0.02 * (1 + 4 * np.abs(record.u[:, :1]))
        noise = spread * rng.normal(size=record.y.shape)
        every.append(dataclasses.replace(record, y=record.y + noise))
    return dataclasses.replace(data, records=tuple(every))


@pytest.fixture(scope="module")
def known():
    """Trained on some records, errors learnt from others."""
    network = jnx.confidence.fit_domain(fitted(plant(drawn(0))), plant(drawn(0)))
    return jnx.confidence.fit_error_model(network, noisy(20))


def held(network, data, level):
    """Whether each measurement is held, and half the width, sample by sample."""
    found = jnx.intervals(network, data, level=level).value
    parts = zip(data, found.lower, found.upper, found.scored, strict=True)
    inside, half = [], []
    for r, low, high, s in parts:
        inside.append(((r.y >= low) & (r.y <= high))[s])
        half.append(0.5 * (high - low)[s])
    return np.concatenate(inside), np.concatenate(half)


@pytest.mark.parametrize("level", [0.5, 0.8, 0.9, 0.95])
def test_of_fresh_records_they_hold_what_they_say(known, level):
    every = [held(known, noisy(seed), level)[0] for seed in (40, 47)]
    inside = np.concatenate(every)
    # errors are independent: quantiles of 3,200 are exact to .01, and what is added for
    # few groups, a factor of sqrt(1 + 1/6), is .02 to .06
    assert level - 0.03 < inside.mean() < level + 0.07


def test_they_are_wide_where_errors_are_large(known):
    data = noisy(41, 12)
    inside, half = held(known, data, 0.9)
    scored = jnx.simulate(known, data).value.scored
    u = np.concatenate([r.u[s[:, 0], 0] for r, s in zip(data, scored, strict=True)])
    third = np.digitize(np.abs(u), np.quantile(np.abs(u), [1 / 3, 2 / 3]))
    for k in range(3):
        assert 0.85 < inside[third == k].mean() < 0.97
    small, large = (half[third == k].mean() for k in (0, 2))
    true = (1 + 4 * np.abs(u[third == 2]).mean()) / (
        1 + 4 * np.abs(u[third == 0]).mean()
    )
    assert large / small == pytest.approx(true, rel=0.25)


def test_beyond_the_domain_they_widen_with_the_third_power_of_the_index(known):
    near, far = noisy(42), noisy(42, size=2.0)
    width = [held(known, data, 0.9)[1].mean() for data in (near, far)]
    assert width[1] > 4 * width[0]
    index = jnx.domain(known, far).value.index
    assert max(float(i.max()) for i in index) > 2


def test_errors_of_the_training_count_as_those_of_groups_left_out():
    data = noisy(20)
    network = jnx.confidence.fit_domain(fitted(data), data)
    own = groups(data)
    plain = jnx.confidence.fit_error_model(network, data, groups=own)
    run = jnx.simulate(network, data).value
    rmse = np.full((1, len(own)), np.nan)
    for g in range(len(own)):
        parts = zip(data, run.outputs, run.scored, own.labels, strict=True)
        error = [(r.y - y)[s & (label == g)[:, None]] for r, y, s, label in parts]
        rmse[0, g] = 3 * np.sqrt(np.mean(np.concatenate(error) ** 2))
    larger = jnx.confidence.fit_error_model(network, data, groups=own, left_out=rmse)
    fresh = noisy(43)
    ratio = held(larger, fresh, 0.9)[1] / held(plain, fresh, 0.9)[1]
    # the floor of small errors and the ridge follow the unit of the errors
    np.testing.assert_allclose(ratio, 3.0, rtol=1e-6)
    rmse[0, 0] = np.nan
    unknown = jnx.confidence.fit_error_model(network, data, groups=own, left_out=rmse)
    np.testing.assert_allclose(
        held(unknown, fresh, 0.9)[1], held(larger, fresh, 0.9)[1], rtol=1e-6
    )


def test_sizes_are_those_of_a_loop(known):
    data = noisy(44)
    found = jnx.intervals(known, data, level=0.9).value
    index = jnx.domain(known, data).value.index[0]
    errors, domain = known.errors, known.domain
    pole = np.exp(-data.sample_time / domain.features.filters[-1].time_constant)
    u, y = data.records[0].u[:, :2], found.run.outputs[0][:, 0]
    slow = np.array(u)
    for t in range(1, len(u)):
        slow[t] = pole * slow[t - 1] + (1 - pole) * u[t]
    knots, height = np.asarray(errors.knots[0]), np.asarray(errors.height[0])
    for t in (5, 77, 300):
        z = [*u[t], *slow[t], *np.abs(u[t] - slow[t]), y[t], abs(y[t] - y[t - 1])]
        z.append(index[t])
        total = float(errors.constant[0])
        for j, value in enumerate(z):
            total += np.interp(value, knots[j], height[j])
        half = np.exp(total) * max(index[t], 1.0) ** 3
        half *= float(errors.quantile[0, 5])
        # filters by another recursion
        np.testing.assert_allclose(found.upper[0][t, 0] - y[t], half, rtol=1e-9)
        np.testing.assert_allclose(y[t] - found.lower[0][t, 0], half, rtol=1e-9)


def test_a_search_gives_them_and_a_refinement_takes_them_away():
    data = noisy(20)
    fit = jnx.identify(data, preset="linear", candidates=4)
    inside, _ = held(fit.value, noisy(45), 0.9)
    assert 0.8 < inside.mean() < 0.98
    refined = jnx.refine(fit.value, data, jnx.PredictionError(max_steps=1))
    assert refined.value.errors is None


def test_a_file_keeps_them(known, tmp_path):
    jnx.save(known, tmp_path / "model.safetensors")
    assert same(jnx.load(tmp_path / "model.safetensors"), known)
    falling = known.errors.knots[:, :, ::-1]
    errors = dataclasses.replace(known.errors, knots=falling)
    with pytest.raises(ModelFileError, match="do not rise"):
        jnx.save(dataclasses.replace(known, errors=errors), tmp_path / "damaged")


def test_wrong_calls_are_refused(known):
    data = noisy(20)
    with pytest.raises(SpecError, match=r"level must lie from 0.5 to 0.99, got 0.2"):
        jnx.intervals(known, data, level=0.2)
    bare = dataclasses.replace(known, errors=None)
    with pytest.raises(SpecError, match="has no error model"):
        jnx.intervals(bare, data)
    with pytest.raises(SpecError, match="no domain"):
        jnx.confidence.fit_error_model(dataclasses.replace(bare, domain=None), data)


def test_a_report_measures_what_they_hold_and_draws_them(known, tmp_path):
    data = noisy(46)
    found = jnx.report(known, {"train": noisy(20), "test": data}, **BRIEF)
    inside, half = held(known, data, 0.9)
    train, test = found.coverage
    assert (train.part, test.part, test.level) == ("train", "test", 0.9)
    assert test.samples == len(inside) and test.held == pytest.approx(inside.mean())
    assert test.half == pytest.approx(half.mean())
    row = found.pooled_row(test.output)
    assert test.rmse == pytest.approx(row.rmse) and not test.is_narrow
    shares = [one.mean() for one in np.split(inside, len(data))]
    error = np.std(shares, ddof=1) / np.sqrt(len(data))
    assert 1.7 * error < test.chance < 2.5 * error
    assert found.to_dict()["coverage"][1]["held"] == test.held
    assert any("90 % intervals of the free run hold, on test" in n for n in found.notes)
    for trace in found.traces:
        at = data.names.index(trace.record)
        whole = jnx.intervals(known, data[at : at + 1]).value
        assert trace.upper is not None
        np.testing.assert_allclose(trace.upper, whole.upper[0][:, 0], rtol=1e-12)
    found.to_html(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "90 % interval" in page and "intervals of the free run" in page
    errors = dataclasses.replace(known.errors, constant=known.errors.constant - 2.0)
    short = jnx.report(dataclasses.replace(known, errors=errors), data, **BRIEF)
    assert any("too narrow on data for" in n for n in short.notes)
    assert any(f.remedy == "intervals" for f in short.verdict.findings)
