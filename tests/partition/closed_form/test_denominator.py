"""Stable feedback by reflection coefficients, against the roots of A(q)."""

import numpy as np
import pytest

from jaxnarx.arrays.stable_polynomials import reflection_coefficients
from jaxnarx.partition.closed_form.denominator import (
    STABILITY_MARGIN,
    denominator_from_times,
    is_stable,
    limit_poles,
)


def by_roots(radius: float, order: int, seed: int):
    """A polynomial whose roots, real ones and pairs, are within `radius`; one is on
    it."""
    rng = np.random.default_rng(seed)
    roots: list[complex] = []
    while len(roots) < order:
        size = radius if not roots else radius * np.sqrt(rng.uniform())
        if order - len(roots) > 1 and rng.uniform() < 0.5:
            root = size * np.exp(1j * rng.uniform(0.1, 3.0))
            roots += [root, root.conjugate()]
        else:
            roots.append(size * rng.choice([-1.0, 1.0]))
    return np.real(np.poly(roots)), np.array(roots)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6])
def test_stable_is_all_roots_within_the_circle(order):
    told = []
    for seed in range(60):
        radius = (0.3, 0.9, 0.99, 1.01, 1.1, 2.0)[seed % 6]
        a, roots = by_roots(radius, order, seed)
        assert is_stable(a) == (np.abs(roots).max() < 1)
        told.append(is_stable(a))
    assert 0 < sum(told) < 60


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_random_coefficients_are_stable_where_their_roots_are(order):
    rng = np.random.default_rng(order)
    every = rng.normal(0, 0.8 / order**0.5, (300, order))
    mine = [is_stable(np.array([1.0, *row])) for row in every]
    largest = [np.abs(np.roots([1.0, *row])).max() for row in every]
    clear = np.abs(np.array(largest) - 1) > 1e-4
    np.testing.assert_array_equal(np.array(mine)[clear], np.array(largest)[clear] < 1)
    assert 10 < sum(mine) < 290


def stepped_up(k):
    """Levinson's recursion from reflection coefficients to A(q)."""
    a = np.ones(1)
    for value in k:
        longer = np.append(a, 0.0)
        a = longer + value * longer[::-1]
    return a


def test_reflections_are_those_that_the_polynomial_was_made_of():
    rng = np.random.default_rng(0)
    for order in (0, 1, 2, 5):
        k = rng.uniform(-0.95, 0.95, order)
        np.testing.assert_allclose(
            reflection_coefficients(stepped_up(k)), k, atol=1e-10
        )


def test_on_the_circle_is_not_stable():
    for a in ([1.0, -1.0], [1.0, 1.0], [1.0, -2.0, 1.0], [1.0, 0.0, 1.0]):
        assert not is_stable(np.array(a))
    assert is_stable(np.ones(1))
    assert is_stable(np.array([1.0, -1.0 + 2 * STABILITY_MARGIN]))
    assert not is_stable(np.array([1.0, -1.0 + STABILITY_MARGIN / 2]))
    # Beyond all numbers, which a step may propose, is not stable either.
    assert not is_stable(np.array([1.0, np.nan]))
    assert not is_stable(np.array([1.0, 0.5, np.inf]))


def test_poles_of_time_constants():
    a = denominator_from_times((0.3, 2.0, 0.7), 0.1)
    assert a[0] == 1.0 and is_stable(a)
    np.testing.assert_allclose(
        np.sort(np.roots(a)), np.exp(-0.1 / np.array([0.3, 0.7, 2.0]))
    )
    assert denominator_from_times((), 0.1).tolist() == [1.0]


@pytest.mark.parametrize("order", [1, 2, 4])
def test_poles_beyond_move_to_the_limit_and_others_stay(order):
    for seed in range(20):
        a, roots = by_roots((0.5, 0.95)[seed % 2], order, seed)
        found = limit_poles(a, 0.8)
        if seed % 2 == 0:
            assert found is a
            continue
        held = roots * np.minimum(1.0, 0.8 / np.abs(roots))
        np.testing.assert_allclose(found, np.real(np.poly(held)), atol=1e-9)
    a = np.array([1.0, -1.5, 0.9])
    assert limit_poles(a, np.inf) is a
