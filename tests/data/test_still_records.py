"""Channels that move between records only, as a test bench's plan often has them."""

import numpy as np
import pytest
from scipy.signal import lfilter

from jaxnarx.data import Dataset, check, delays, step_times, suggest_lags
from jaxnarx.partition.closed_form.profile import profile_data

SECOND = {
    "differs": lambda k, n: np.full(n, (20.0, 30.0, 40.0)[k]),
    "one moves once": lambda k, n: np.where(np.arange(n) < n - 2, 20.0, 20.0 + k),
    "moves at the beginning only": lambda k, n: np.where(np.arange(n) < 2, k, 20.0),
    "rounds": lambda k, n: 20.0 * (k + 1) + 1e-13 * np.sin(np.arange(n)),
}


def records(second, rows=200, count=3, still_output=False):
    """An input that moves, one that is (nearly) still, and their output."""
    rng = np.random.default_rng(0)
    u = [np.stack([rng.normal(size=rows), second(k, rows)], 1) for k in range(count)]
    y = [lfilter([0, 1], [1, -0.8], x[:, 0]) + 0.1 * x[:, 1] for x in u]
    if still_output:
        y = [np.stack([own, np.full(rows, 3.0 + k)], 1) for k, own in enumerate(y)]
    outputs = ["y", "z"] if still_output else ["y"]
    return Dataset.from_arrays(
        u, y, inputs=["u1", "u2"], outputs=outputs, sample_time=0.1
    )


@pytest.mark.parametrize("kind", SECOND)
@pytest.mark.parametrize("still_output", [False, True])
def test_every_look_at_the_data_takes_them(kind, still_output):
    data = records(SECOND[kind], still_output=still_output)
    assert check(data).is_okay
    lags = suggest_lags(data)
    assert lags.dead_time["u1", "y"] == 1 and lags.settling["u1", "y"]
    assert list(step_times(data, "y")) == ["u1"]
    assert "unclear" in str(delays(data))
    assert profile_data(data, "y").dead_time == (1, 0)
    if still_output:
        assert lags.dead_time["u1", "z"] is lags.dead_time["u2", "z"] is None


def test_one_long_record_does_not_hide_what_the_others_show():
    """The long one stands still: the dead time is that of the many short ones."""
    rng = np.random.default_rng(0)
    u = [np.zeros(2_000), *(rng.normal(size=300) for _ in range(12))]
    y = [np.roll(x, 4) + 0.05 * rng.normal(size=len(x)) for x in u]
    data = Dataset.from_arrays(u, y, inputs=["u"], outputs=["y"], sample_time=0.1)
    assert suggest_lags(data).dead_time["u", "y"] == 4
    assert profile_data(data, "y").dead_time == (4,)


def test_two_records_with_one_value_each():
    found = check(records(SECOND["differs"], count=2))
    assert found.is_okay
    (told,) = [f for f in found.of("constant") if f.channel == "u2"]
    assert told.severity == "note" and "within each record" in told.message
