"""The size and the colour of noise, from covariances known exactly."""

import numpy as np
import pytest

from jaxnarx.confidence.noise import (
    autocovariance,
    autoregression,
    estimate_noise,
    longest_order,
)


@pytest.mark.parametrize("pole", [-0.5, 0.0, 0.9])
def test_yule_walker_of_exact_covariances_is_exact(pole):
    # First order with unit innovations: c(k) = pole^k / (1 - pole^2).
    c = pole ** np.arange(8.0) / (1 - pole**2)
    found, variance = autoregression(c, 1000)
    # A higher order lowers the variance by nothing but rounding, and costs 2.
    np.testing.assert_allclose(found, [pole] if pole else [], rtol=1e-12)
    np.testing.assert_allclose(variance, 1.0, rtol=1e-12)


def test_second_order():
    # Yule-Walker: c1 = a1 c0 / (1 - a2), c(k) = a1 c(k-1) + a2 c(k-2).
    a1, a2 = 1.1, -0.4
    c = [1.0, a1 / (1 - a2)]
    for _ in range(6):
        c.append(a1 * c[-1] + a2 * c[-2])
    found, variance = autoregression(np.array(c), 1000)
    np.testing.assert_allclose(found, [a1, a2], rtol=1e-10)
    np.testing.assert_allclose(variance, 1 - a1 * c[1] - a2 * c[2], rtol=1e-10)


def test_a_pure_tone_stops_the_recursion_and_silence_has_no_colour():
    found, variance = autoregression(np.cos(0.3 * np.arange(6.0)), 1000)
    assert len(found) <= 2 and variance >= 0
    found, variance = autoregression(np.zeros(5), 1000)
    assert found.size == 0 and variance == 0


def test_autocovariance_stays_within_records_and_masks():
    e = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    scored = np.array([[True, True, False], [True, True, True]])
    found = autocovariance(e, scored, 5)
    np.testing.assert_allclose(found, np.array([82.0, 2 + 20 + 30, 24, 0, 0]) / 5)


def test_parameters_cost_degrees_of_freedom():
    rng = np.random.default_rng(0)
    e = rng.normal(size=(2, 30, 2))
    scored = np.ones(e.shape, bool)
    scored[0, :10, 1] = False
    noise = estimate_noise(e, scored, coloured=False, depth=3).less(np.array([4.0, 60]))
    first = np.sum(e[..., 0] ** 2) / 56
    # More parameters than samples leave one.
    second = np.sum(np.where(scored, e, 0.0)[..., 1] ** 2)
    np.testing.assert_allclose(noise.innovation, [first, second])
    np.testing.assert_allclose(noise.covariance, [[first, 0, 0], [second, 0, 0]])
    np.testing.assert_array_equal(noise.freedom, [56, 1])
    assert noise.shape.shape == (2, 0)


def test_the_longest_order_grows_slowly():
    assert [longest_order(n) for n in (0, 20, 1000, 10**6)] == [0, 2, 30, 60]
