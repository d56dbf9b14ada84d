"""Checks of single samples: what is masked throughout, what is in float32."""

import dataclasses

import numpy as np
import pytest

from jaxnarx.data import Dataset, check


def data(dtype=np.float64, masked=()):
    """Two records of an input and an output; the output is masked in some."""
    rng = np.random.default_rng(2)
    us, ys = rng.standard_normal((2, 2, 60)).astype(dtype)
    made = Dataset.from_arrays(
        list(us), list(ys), inputs=["u"], outputs=["y"], sample_time=1
    )
    records = [
        dataclasses.replace(
            r,
            y=np.zeros_like(r.y) if k in masked else r.y,
            valid=r.valid & np.array([True, k not in masked]),
        )
        for k, r in enumerate(made)
    ]
    return dataclasses.replace(made, records=tuple(records))


def test_what_is_masked_throughout_is_not_called_constant():
    found = check(data(masked=(0, 1)), max_lag=2)
    assert not found.of("constant") and not found.is_okay
    assert any("y has no valid sample" in f.message for f in found.of("gaps"))
    # nor in one record
    assert not check(data(masked=(1,)), max_lag=2).of("constant")


@pytest.mark.parametrize(("dtype", "count"), [(np.float32, 1), (np.float64, 0)])
def test_float32_says_that_all_runs_in_it(dtype, count):
    found = check(data(dtype), max_lag=2).of("precision")
    assert len(found) == count
    assert all("runs in float32" in f.message for f in found)
