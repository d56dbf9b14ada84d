"""The stretches of time with the largest error: where they were made, each once."""

import numpy as np
import pytest
from common import BRIEF, HALVES, from_rows, network

from jaxnarx.evaluation import report

SAMPLE_TIME = 0.1
BUMPS = {0: (300, 330, 5.0), 1: (500, 520, -8.0)}
"""By record: first sample, end, and what is added to the output."""


@pytest.fixture(scope="module")
def found():
    """The network says 0; the output is noise of size 1 but for two stretches."""
    rng = np.random.default_rng(7)
    us, ys = [], []
    for first, stop, size in BUMPS.values():
        u = rng.uniform(-1, 1, (800, 2))
        u[:, 0] = -np.abs(u[:, 0])
        u[first:stop, 0] *= -1
        y = rng.normal(size=(800, 2))
        y[first:stop, 0] += size
        us.append(u)
        ys.append(y)
    data = from_rows([np.hstack(pair) for pair in zip(us, ys, strict=True)])
    return data, report(network([HALVES]), data, **BRIEF)


def test_the_largest_comes_first_with_its_time_bias_and_region(found):
    data, told = found
    for stretch, n in zip(told.worst, (1, 0), strict=False):
        first, stop, size = BUMPS[n]
        assert stretch.record == data.names[n]
        # errors are averaged over 8 samples, so that ends are known to about as many
        assert stretch.start == pytest.approx(first * SAMPLE_TIME, abs=0.8)
        assert stretch.end == pytest.approx(stop * SAMPLE_TIME, abs=0.8)
        part = slice(*(round(t / SAMPLE_TIME) for t in (stretch.start, stretch.end)))
        error = data.records[n].y[part.start : part.stop + 1, 0]
        assert stretch.bias == pytest.approx(error.mean(), rel=1e-12)
        assert stretch.rmse == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
        assert np.sign(stretch.bias) == np.sign(size)
        assert stretch.region.startswith("a[t] near 0.5")
    row = told.pooled_row("y")
    assert told.worst[0].times == pytest.approx(told.worst[0].rmse / row.rmse)


def test_none_overlaps_another_and_all_are_told(found):
    _, told = found
    assert len(told.worst) == 10
    for one in told.worst:
        same = [w for w in told.worst if w.record == one.record and w is not one]
        assert all(w.end < one.start or w.start > one.end for w in same)
        assert one.index is None and one.unusual == ""
    assert told.to_dict()["worst"][0]["record"] == told.worst[0].record


def test_of_a_perfect_run_nothing_is_told():
    data = from_rows([np.zeros((800, 4))] * 2)
    assert report(network([HALVES]), data, **BRIEF).worst == ()
