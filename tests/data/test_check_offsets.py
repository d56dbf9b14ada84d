"""A channel far from zero is named before anything is fitted."""

import numpy as np
import pytest

from jaxnarx.data import Dataset, check


@pytest.mark.parametrize("channel", ["u2", "y"])
def test_a_huge_offset_is_named(channel):
    rng = np.random.default_rng(3)
    columns = {name: rng.normal(size=200) for name in ("u1", "u2", "y")}
    columns["u1"] += 100.0
    columns[channel] += 1e6
    u = np.stack([columns["u1"], columns["u2"]], axis=1)
    data = Dataset.from_arrays(
        u, columns["y"], inputs=["u1", "u2"], outputs=["y"], sample_time=1.0
    )
    (found,) = check(data).of("offset")
    assert found.severity == "warning" and found.channel == channel
    assert "offset" in found.message


def test_a_constant_channel_has_no_offset():
    u = np.stack([np.random.default_rng(3).normal(size=100), np.full(100, 5.0)], axis=1)
    data = Dataset.from_arrays(
        u, u[:, 0], inputs=["u1", "u2"], outputs=["y"], sample_time=1.0
    )
    assert not list(check(data).of("offset"))
