"""Excitation signals keep their promises on hold times, levels and keys."""

import jax
import numpy as np
import pytest

from jaxnarx.data.excitation import aprbs, steps
from jaxnarx.errors import SpecError

HOLD = (20, 120)
AMPLITUDE = (0.38, 0.41)


@pytest.fixture
def signal(key):
    return np.asarray(aprbs(key, 8000, hold=HOLD, amplitude=AMPLITUDE))


def runs(signal: np.ndarray) -> np.ndarray:
    """Lengths of the stretches of equal value."""
    borders = np.flatnonzero(np.diff(signal)) + 1
    return np.diff(np.concatenate([[0], borders, [signal.size]]))


def test_hold_times_lie_in_their_range(signal):
    holds = runs(signal)
    assert holds.sum() == 8000
    assert holds[:-1].min() >= HOLD[0] and holds.max() <= HOLD[1]


def test_hold_times_cover_their_range(key):
    holds = runs(np.asarray(aprbs(key, 4000, hold=(2, 4), amplitude=(-1.0, 1.0))))
    assert set(holds[:-1]) == {2, 3, 4}


def test_levels_lie_in_and_cover_their_range(signal):
    low, high = AMPLITUDE
    assert low <= signal.min() and signal.max() <= high
    levels = np.unique(signal)
    # Over a hundred uniform levels: a gap of a tenth of the range has odds of 1e-3.
    assert levels.size > 60
    gaps = np.diff(np.concatenate([[low], levels, [high]]))
    assert gaps.max() < 0.1 * (high - low)


def test_the_key_decides(key, signal):
    again = aprbs(key, 8000, hold=HOLD, amplitude=AMPLITUDE)
    other = aprbs(jax.random.key(1), 8000, hold=HOLD, amplitude=AMPLITUDE)
    np.testing.assert_array_equal(signal, again)
    assert not np.array_equal(signal, other)


def test_limits(key):
    np.testing.assert_array_equal(aprbs(key, 5, hold=(9, 9), amplitude=(2.0, 2.0)), 2.0)
    assert np.all(
        runs(np.asarray(aprbs(key, 60, hold=(6, 6), amplitude=(0.0, 1.0)))) == 6
    )
    assert aprbs(key, 1, hold=(1, 1), amplitude=(0.0, 1.0)).shape == (1,)


def test_steps_hold_each_level():
    np.testing.assert_array_equal(steps([1.0, 3.0], hold=2), [1.0, 1.0, 3.0, 3.0])


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"hold": (0, 5)}, "hold"),
        ({"hold": (6, 5)}, "hold"),
        ({"amplitude": (1.0, 0.0)}, "amplitude"),
        ({"length": 0}, "length"),
    ],
)
def test_wrong_requests_are_refused(key, wrong, field):
    request = {"length": 10, "hold": (1, 5), "amplitude": (0.0, 1.0)} | wrong
    with pytest.raises(SpecError) as caught:
        aprbs(key, **request)
    assert caught.value.field == field


def test_steps_need_a_hold():
    with pytest.raises(SpecError):
        steps([1.0], hold=0)
