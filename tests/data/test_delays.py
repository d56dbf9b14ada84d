"""Delays from records of known systems."""

import json

import numpy as np
import pytest

from jaxnarx.data import Dataset, delays
from jaxnarx.errors import DataError, SpecError


@pytest.fixture(scope="module")
def data() -> Dataset:
    """a -> y after 5 samples, upwards; b -> w after 12, downwards; nothing else."""
    rng = np.random.default_rng(7)
    us, ys = [], []
    for rows in (900, 600):
        u = np.cumsum(rng.standard_normal((rows, 2)), axis=0)
        u -= 0.1 * np.cumsum(u, axis=0) / 30
        y = np.zeros((rows, 2))
        for t in range(12, rows):
            y[t, 0] = 0.6 * y[t - 1, 0] + 2.0 * u[t - 5, 0]
            y[t, 1] = 0.4 * y[t - 1, 1] - 0.5 * u[t - 12, 1]
        us.append(u)
        ys.append(y + 0.1 * rng.standard_normal(y.shape))
    return Dataset.from_arrays(
        us, ys, inputs=["a", "b"], outputs=["y", "w"], sample_time=0.02
    )


def test_known_delays_are_found_with_their_sign(data):
    found = delays(data)
    assert found["a", "y"].samples == 5
    assert found["a", "y"].seconds == pytest.approx(0.1)
    assert found["b", "w"].samples == 12
    # noise of 0.1 beside outputs of several units leaves little unexplained
    assert found["a", "y"].correlation > 0.9
    assert found["b", "w"].correlation < -0.9


def test_pairs_without_a_response_are_unclear(data):
    found = delays(data)
    for pair in (("a", "w"), ("b", "y")):
        delay = found[pair]
        assert delay.samples is None and delay.seconds is None
        assert abs(delay.correlation) < 0.5
    assert str(found).count("unclear") == 2


def test_delays_follow_a_shift_and_no_unit(data):
    """Delaying every output by three samples adds three; units change nothing."""
    moved = Dataset.from_arrays(
        [1e-3 * r.u[3:] for r in data],
        [1e4 * r.y[:-3] + 50 for r in data],
        inputs=["a", "b"],
        outputs=["y", "w"],
        sample_time=0.02,
    )
    assert delays(moved)["a", "y"].samples == 8
    assert delays(moved)["b", "w"].samples == 15


def test_the_table_and_the_dictionary_hold_every_pair(data):
    found = delays(data, reach=30)
    assert found.reach == 30 and len(found.pairs) == 4
    lines = str(found).split("\n")
    assert lines[1].split()[:4] == ["a", "->", "y", "5"]
    read = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert read["pairs"][0]["samples"] == 5 and read["sample_time"] == 0.02


def test_what_makes_no_sense_is_refused(data):
    with pytest.raises(SpecError, match="reach must be at least 1"):
        delays(data, reach=0)
    with pytest.raises(SpecError, match="no pair"):
        delays(data)["a", "z"]
    with pytest.raises(DataError, match="at least one record"):
        delays(data[:0])
