"""Proposed time constants: those of simulated lags, by either method."""

import numpy as np
import pytest
import scipy.signal

from jaxnarx.data import Dataset
from jaxnarx.data.lags import step_times
from jaxnarx.errors import DataError, SpecError
from jaxnarx.regressors import time_constants

SLOW, QUICK = 4.0, 0.5


def low_pass(u: np.ndarray, time_constant: float) -> np.ndarray:
    a = np.exp(-0.1 / time_constant)
    return np.asarray(scipy.signal.lfilter([1 - a], [1, -a], u))


@pytest.fixture(scope="module")
def data() -> Dataset:
    """z answers u slowly and w, after 0.5 s, quickly; v answers nothing."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.normal(size=(600, 2)), 10, axis=0)
    late = np.concatenate([np.zeros(5), u[:-5, 1]])
    z = 2 * low_pass(u[:, 0], SLOW) - low_pass(late, QUICK)
    noise = 0.01 * rng.normal(size=(6000, 2))
    y = np.stack([z, np.zeros(6000)], axis=1) + noise
    return Dataset.from_arrays(
        u, y, inputs=["u", "w"], outputs=["z", "v"], sample_time=0.1
    )


def test_step_times_are_the_time_constants(data):
    found = step_times(data, "z")
    # the tail below chance is not seen, and white inputs show a lag up to a sample off
    assert found["u"] == pytest.approx(SLOW, rel=0.25)
    assert found["w"] == pytest.approx(QUICK, rel=0.35)


def test_the_series_by_step_covers_both(data):
    found = time_constants(data, "z", count=3)
    assert len(found) == 3 and list(found) == sorted(found)
    assert found[0] < QUICK and found[-1] > SLOW
    # of two digits each: up to 5 % off
    np.testing.assert_allclose(found[1] ** 2, found[0] * found[2], rtol=0.2)
    (middle,) = time_constants(data, "z", count=1)
    assert QUICK < middle < SLOW


def test_the_search_finds_both(data):
    # neighbours on the grid are a factor 1.69 apart; the quick one is late as well,
    # by 0.5 s, which a longer lag stands for
    quick, slow = time_constants(data, "z", count=2, method="search")
    assert SLOW / 1.7 < slow < SLOW * 1.7
    assert QUICK / 1.7 < quick < (QUICK + 0.5) * 1.7


def test_the_search_does_not_mind_how_often_it_is_told(data):
    pair = Dataset.from_arrays(
        [data.records[0].u] * 2,
        [data.records[0].y] * 2,
        inputs=["u", "w"],
        outputs=["z", "v"],
        sample_time=0.1,
    )
    one = time_constants(data, "z", count=2, method="search")
    assert time_constants(pair, "z", count=2, method="search") == one


def test_a_channel_that_answers_nothing_is_said_to(data):
    with pytest.raises(DataError, match="no response of 'v' to any input"):
        time_constants(data, "v")


def test_requests_that_make_no_sense_are_refused(data):
    with pytest.raises(SpecError, match="unknown output 'zz'"):
        time_constants(data, "zz")
    with pytest.raises(SpecError, match="count must be 1 to 16, got 17"):
        time_constants(data, "z", count=17, method="search")
    with pytest.raises(SpecError, match="count must be 1 to 30, got 0"):
        time_constants(data, "z", count=0)
