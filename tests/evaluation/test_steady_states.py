"""Outputs at rest, against the fixed point of one equation."""

from functools import cache

import common
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import intersections, response_surface, steady_states
from jaxnarx.evaluation._steady_states import operating_point

network = cache(common.named)
data = cache(lambda: common.dataset((150, 150)))


def rest(a, b):
    """Of y = 1 + 2.5 a + .6 y - .4 b y, the equation of `one model`."""
    return (1 + 2.5 * a) / (0.4 + 0.4 * b)


def test_a_run_comes_to_rest_at_the_fixed_point_or_says_that_it_does_not():
    points = np.array([[1.0, 0.5], [-2.0, 0.0], [0.5, -0.9], [1.0, -2.0]])
    assert "1 + 2.5 a[t] + 0.6 y[t-1] - 0.4 b[t-1]*y[t-1]" in str(network("one model"))
    found = steady_states(network("one model"), points, np.zeros(2))
    # The pole of the third is .96: after 512 samples 1e-9 of the way is left.
    expected = rest(*points[:3].T)
    np.testing.assert_allclose(found.value[:3, 0], expected, rtol=1e-7)
    assert found.settled[:3].all() and not found.settled[3, 0]  # its pole is 1.4
    assert np.isnan(found.value[3, 0]) and found.lower is None and found.index is None


def test_what_settles_slowly_is_run_longer():
    slow = np.array([[-0.38, -0.995], [1.0, 0.5]])  # poles .998 and .4
    found = steady_states(network("one model"), slow, np.zeros(2))
    # 512 samples leave 9 ppm, which is 9/1000 of the range of the output.
    np.testing.assert_allclose(found.value[:, 0], rest(*slow.T), rtol=0, atol=1.0)


def test_intersections_go_through_the_operating_point():
    cuts = intersections(
        network("one model"), data(), at={"a": 1.5, "b": 1.0}, points=7
    )
    assert [(c.output.name, c.over.name) for c in cuts] == [("y", "a"), ("y", "b")]
    over_a, over_b = cuts
    np.testing.assert_allclose(over_a.x, np.linspace(-20, 20, 7), rtol=1e-12)
    np.testing.assert_allclose(over_a.y, rest(over_a.x, 1.0), rtol=1e-7)
    stable = abs(over_b.x - 1.5) < 2.5  # the pole is .6 - .4 b
    np.testing.assert_allclose(over_b.y[stable], rest(1.5, over_b.x[stable]), rtol=1e-7)
    assert np.isnan(over_b.y[~stable]).all()
    assert over_a.here == (1.5, pytest.approx(rest(1.5, 1.0)))
    assert "held b = 1" in str(over_a)


def test_the_operating_point_is_measured():
    point, y = operating_point(network("one model"), data())
    rows = np.concatenate([r.signals for r in data()])
    assert any(np.array_equal(row, np.r_[point, y]) for row in rows)
    moved, _ = operating_point(network("one model"), data(), {"a": 3.0})
    assert moved[0] == 3.0


def test_a_surface_has_a_value_for_each_pair():
    found = response_surface(network("one model"), data(), ("b", "a"), cells=4)
    b, a = np.meshgrid(found.x, found.y, indexing="ij")
    known = abs(b - 1.5) < 2.5
    np.testing.assert_allclose(found.value[known], rest(a, b)[known], rtol=1e-7)
    assert np.isnan(found.value[~known]).all()
    assert [c.name for c in found.over] == ["b", "a"]


def test_bands_and_the_domain_are_those_of_the_network():
    knows = jnx.confidence.fit_domain(network("one model"), data())
    knows = jnx.confidence.fit_error_model(knows, data())
    (cut,) = intersections(knows, data(), over=["a"], points=9)
    assert cut.lower is not None and cut.upper is not None and cut.index is not None
    assert np.all(cut.lower < cut.y) and np.all(cut.y < cut.upper)
    # The records stay within -6 to 4 V, the network's ranges within -20 to 20 V.
    assert np.all(cut.index[np.abs(cut.x) > 15] > 1)
    assert cut.index[len(cut.x) // 2] <= 1


def test_wrong_use_is_told():
    with pytest.raises(SpecError, match="'c' is no input"):
        intersections(network("one model"), data(), over=["c"])
    with pytest.raises(SpecError, match="two inputs"):
        response_surface(network("one model"), data(), ("a", "a"))
    with pytest.raises(SpecError, match="3 columns"):
        steady_states(network("one model"), np.zeros((1, 3)), np.zeros(2))
    with pytest.raises(SpecError, match="at least 2"):
        intersections(network("one model"), data(), points=1)
