"""The non-dominated set: by its definition, and what it must not depend on."""

import numpy as np
import pytest

from jaxnarx.evaluation._cost import pareto


def dominated(points, i):
    return any(
        all(a <= b for a, b in zip(other, points[i], strict=True))
        and any(a < b for a, b in zip(other, points[i], strict=True))
        for other in points
    )


@pytest.mark.parametrize("objectives", [1, 2, 4])
def test_front_is_what_nothing_dominates(objectives, rng=5):
    points = np.random.default_rng(rng).integers(0, 6, (60, objectives)).astype(float)
    expected = [not dominated(points.tolist(), i) for i in range(len(points))]
    got = pareto(points)
    np.testing.assert_array_equal(got, expected)
    # Any increasing function of an objective, and any order of points, is the same.
    np.testing.assert_array_equal(pareto(np.exp(points) - 7), expected)
    np.testing.assert_array_equal(pareto(points[::-1])[::-1], expected)
    # The front alone is its own front.
    assert pareto(points[got]).all()


def test_equal_points_stay_and_unknown_ones_do_not():
    nan, inf = np.nan, np.inf
    points = np.array([[1.0, 2.0], [1.0, 2.0], [2.0, 2.0], [0.0, nan], [inf, 0.0]])
    assert pareto(points).tolist() == [True, True, False, False, True]
    assert pareto(np.full((2, 1), inf)).all()


def test_nothing_and_nothing_to_compare():
    assert pareto(np.zeros((0, 2))).shape == (0,)
    assert pareto(np.zeros((3, 0))).all()
