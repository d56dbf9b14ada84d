"""Lag windows against a loop over samples, records and lags."""

import jax.numpy as jnp
import numpy as np
import oracles
import pytest

from jaxnarx.arrays.windows import lag_signals, usable

ROWS = ((0, 0), (2, 3), (1, 1), (2, 1), (0, 3))


def records(time: int = 12, count: int = 3) -> np.ndarray:
    return np.random.default_rng(4).normal(size=(count, time, 3))


def test_lagged_variables_equal_the_loop():
    signals = records(count=1)[0]
    found = lag_signals(jnp.asarray(signals), jnp.arange(12), ROWS)
    expected, good = oracles.lagged(signals, ROWS)
    assert found.shape == (len(ROWS), 12)
    np.testing.assert_array_equal(np.asarray(found)[:, good], expected[good].T)


def test_several_records_behind_one_another():
    signals = records()
    at = np.array([3, 11, 15, 23, 30])
    found = lag_signals(jnp.asarray(signals.reshape(-1, 3)), jnp.asarray(at), ROWS)
    for column, n in enumerate(at):
        record, t = divmod(int(n), 12)
        expected = [signals[record, t - lag, signal] for signal, lag in ROWS]
        np.testing.assert_array_equal(found[:, column], expected)


def test_no_variables_give_no_rows():
    found = lag_signals(jnp.asarray(records(count=1)[0]), jnp.arange(12), ())
    assert found.shape == (0, 12)
    assert found.dtype == jnp.float64


def test_float32_stays_float32():
    signals = jnp.asarray(records(count=1)[0], jnp.float32)
    assert lag_signals(signals, jnp.arange(12), ROWS).dtype == jnp.float32


@pytest.mark.parametrize("history", [3, 5])
def test_usable_equals_the_loop(history):
    valid = np.random.default_rng(1).random((4, 30, 3)) > 0.08
    found = usable(valid, ROWS, history)
    for n in range(4):
        for t in range(30):
            seen = t >= history and all(valid[n, t - lag, s] for s, lag in ROWS)
            assert found[n, t] == seen, (n, t)
    # Both answers occur, or the loop above shows nothing.
    assert 0 < found.sum() < found[:, history:].size


def test_a_window_never_reaches_into_the_record_before():
    valid = np.ones((2, 8, 3), bool)
    found = usable(valid, ROWS, 3)
    np.testing.assert_array_equal(found, np.tile(np.arange(8) >= 3, (2, 1)))


def test_padding_is_never_usable():
    valid = np.ones((2, 8, 3), bool)
    valid[1, 5:] = False
    assert not usable(valid, ROWS, 3)[1, 5:].any()


@pytest.mark.parametrize("time", [1, 2, 3, 4, 5, 6])
def test_records_shorter_than_the_longest_lag_have_no_usable_sample(time):
    found = usable(np.ones((2, time, 1), bool), ((0, 6), (0, 1)), 6)
    assert found.shape == (2, time) and not found.any()
