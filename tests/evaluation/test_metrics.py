"""Metrics against plain formulas, limits, invariances and the edges they promise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx import metrics

NAMES = list(metrics.PERFECT_VALUES)
WORST = {"rmse": np.inf, "nrmse": np.inf, "r2": -np.inf, "fit": -np.inf, "nmse": np.inf}


@pytest.fixture
def case():
    rng = np.random.default_rng(3)
    y = rng.normal(size=(60, 2)) * [3.0, 0.2] + [1.0, -4.0]
    return y, y + rng.normal(size=y.shape) * 0.1, rng.random(y.shape) < 0.7


def plain(y, yhat):
    """The printed formulas, one output, no mask."""
    e, sst = y - yhat, np.sum((y - y.mean()) ** 2)
    root = np.sqrt(np.sum(e**2) / sst)
    return {
        "rmse": np.sqrt(np.mean(e**2)),
        "nrmse": root,
        "r2": 1 - np.sum(e**2) / sst,
        "fit": 100 * (1 - root),
        "nmse": np.var(e) / np.var(y),
    }


def column(values):
    return np.asarray(values, float)[:, None]


def test_metrics_equal_the_printed_formulas(case):
    y, yhat, mask = case
    got = metrics.scores(y, yhat, mask)
    for o in range(2):
        chosen = mask[:, o]
        for name, value in plain(y[chosen, o], yhat[chosen, o]).items():
            np.testing.assert_allclose(got[name][o], value, rtol=1e-12)
        assert got["samples"][o] == chosen.sum()


def test_numpy_and_jitted_jax_agree(case):
    host = metrics.scores(*case)
    device = jax.jit(metrics.scores)(*(jnp.asarray(a) for a in case))
    for name, value in host.items():
        np.testing.assert_allclose(device[name], value, rtol=1e-12)


@pytest.mark.parametrize("factor", [1e-150, 1e-3, -7.0, 1e150])
def test_a_change_of_unit_moves_only_rmse(case, factor):
    y, yhat, mask = case
    before = metrics.scores(y, yhat, mask)
    after = metrics.scores(y * factor, yhat * factor, mask)
    np.testing.assert_allclose(after["rmse"], before["rmse"] * abs(factor), rtol=1e-12)
    for name in NAMES[1:]:
        np.testing.assert_allclose(after[name], before[name], rtol=1e-9)


def test_masked_samples_have_no_influence(case):
    y, yhat, mask = case
    spoiled = np.where(mask, yhat, np.nan)
    for name, value in metrics.scores(y, yhat, mask).items():
        np.testing.assert_array_equal(metrics.scores(y, spoiled, mask)[name], value)


def test_limits_are_perfect_and_the_mean(case):
    y, _, _ = case
    every = np.ones(y.shape, bool)
    for name, value in metrics.PERFECT_VALUES.items():
        np.testing.assert_array_equal(metrics.scores(y, y, every)[name], value)
    mean = metrics.scores(y, np.broadcast_to(y.mean(0), y.shape), every)
    np.testing.assert_allclose(mean["nrmse"], 1, rtol=1e-12)
    np.testing.assert_allclose([mean["r2"], mean["fit"]], 0, atol=1e-10)


def test_nmse_is_blind_to_bias_and_the_others_are_not(case):
    y, _, mask = case
    biased = metrics.scores(y, y + 5.0, mask)
    np.testing.assert_allclose(biased["nmse"], 0, atol=1e-25)
    assert np.all(biased["nrmse"] > 1)


def test_pooling_is_concatenation_not_averaging():
    y, yhat = column([0, 1, 10, 11]), column([0, 2, 10, 13])
    whole = metrics.scores(y, yhat, np.ones((4, 1), bool))
    np.testing.assert_allclose(whole["rmse"], np.sqrt(5 / 4))


@pytest.mark.parametrize("rows", [5, 0])
def test_no_samples_is_the_worst_value_never_nan(rows):
    y = np.ones((rows, 1))
    got = metrics.scores(y, y, np.zeros((rows, 1), bool))
    assert got["samples"][0] == 0
    assert {name: got[name][0] for name in NAMES} == {n: WORST[n] for n in NAMES}


def test_constant_output_is_worst_unless_the_error_is_zero():
    y, mask = np.full((7, 1), 0.1), np.ones((7, 1), bool)
    assert metrics.is_constant(y, mask)[0]
    wavy = y + column(np.arange(7))
    for name in NAMES:
        assert metrics.scores(y, y, mask)[name][0] == metrics.PERFECT_VALUES[name]
        if name != "rmse":
            assert metrics.scores(y, wavy, mask)[name][0] == WORST[name]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_prediction_that_is_not_finite_is_the_worst(bad):
    y, mask = column(np.arange(5)), np.ones((5, 1), bool)
    yhat = y.copy()
    yhat[2] = bad
    for name in NAMES:
        assert metrics.scores(y, yhat, mask)[name][0] == WORST[name]
