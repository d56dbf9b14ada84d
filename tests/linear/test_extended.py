"""Extended least squares: unbiased coefficients under coloured noise."""

import numpy as np
import pytest
from linear_problems import dataset, record

import jaxnarx as jnx
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear import extended_least_squares, fit_linear
from jaxnarx.settings.linear import ARMAX, ARX
from jaxnarx.solution import RESULTS

TRUE = {"u[t-2]": 1.0, "u[t-1]^2": 0.3, "y[t-1]": 0.6}
NOISE = 0.7


def narmax(seed: int, samples: int):
    """y = 0.6 y(t-1) + u(t-2) + 0.3 u(t-1)^2 + e + 0.7 e(t-1)."""
    rng = np.random.default_rng(seed)
    u, e = rng.normal(size=samples), 0.5 * rng.normal(size=samples)
    y = np.zeros(samples)
    for t in range(2, samples):
        y[t] = 0.6 * y[t - 1] + u[t - 2] + 0.3 * u[t - 1] ** 2
        y[t] += e[t] + NOISE * e[t - 1]
    return u, y, e


@pytest.fixture(scope="module")
def data():
    pairs = [narmax(seed, 1500)[:2] for seed in (0, 1)]
    us, ys = map(list, zip(*pairs, strict=True))
    return Dataset.from_arrays(us, ys, inputs=["u"], outputs=["y"], sample_time=1.0)


@pytest.fixture(scope="module")
def pool(data):
    """The candidates with the true ones among them."""
    return jnx.polynomial_pool(
        data.channels, input_lags=(1, 2), output_lags=(1,), degree=2
    )


@pytest.fixture(scope="module")
def fit(data, pool):
    """With the noise term."""
    return extended_least_squares(pool, data, residual_lags=1)


def scores(found):
    """Errors of all terms in claimed standard errors; what is not true is zero."""
    true = np.array([TRUE.get(name, 0.0) for name in found.terms])
    return (found.coefficient - true) / found.error


def test_noise_terms_take_the_bias_away(data, pool, fit):
    plain, found = extended_least_squares(pool, data, residual_lags=0), fit
    assert plain.status == found.status == RESULTS.ok
    feedback = found.value.terms.index("y[t-1]")
    assert abs(scores(plain.value)[feedback]) > 8
    # Chance exceeds 4 in one of 1,600 searches of ten terms.
    assert np.abs(scores(found.value)).max() < 4
    # Its standard error is that of a regression on known e: somewhat small.
    assert abs(found.value.noise[0] - NOISE) < 5 * found.value.noise_error[0]
    assert found.value.noise_variance == pytest.approx(0.25, rel=0.1)
    history = found.stats["history"]
    assert history[-1] < history[0] == pytest.approx(plain.stats["history"][0])


def test_residuals_are_the_innovations(fit):
    for seed, residual in zip((0, 1), fit.value.residual, strict=True):
        e = narmax(seed, 1500)[2]
        assert residual.shape == e.shape and not residual[:2].any()
        assert np.corrcoef(residual[20:], e[20:])[0, 1] > 0.99


def test_the_network_is_the_part_without_noise(data, fit):
    found = fit.value
    (equation,) = found.network.equations()
    values = dict(equation["terms"])
    for name, value in zip(found.terms, found.coefficient, strict=True):
        assert values[name] == pytest.approx(value)
    assert jnx.simulate(found.network, data).is_okay


def test_a_selection_brings_its_own_terms(data, pool):
    chosen = jnx.select(pool, data, jnx.ForwardOLS(max_terms=4)).value
    found = extended_least_squares(chosen, data, residual_lags=1).value
    assert list(found.terms) == chosen.names
    assert set(found.terms) == {"1", *TRUE}
    assert np.abs(scores(found)).max() < 4


def test_linear_terms_agree_with_the_prediction_error_search():
    """ARMAX both ways; extended least squares is consistent but not the minimum."""
    u, y = record("ARMAX", 1, 3000)
    data = dataset(u, y)
    pool = jnx.polynomial_pool(
        data.channels, input_lags=(2, 3), output_lags=(1, 2), degree=1
    )
    extended = extended_least_squares(pool, data, residual_lags=1).value
    best = fit_linear(data, ARMAX(2, 2, 1, 2)).value
    values = dict(zip(extended.terms, extended.coefficient, strict=True))
    names = ["speed[t-1]", "speed[t-2]", "duty[t-2]", "duty[t-3]"]
    found = np.array([values[n] for n in names]) * [-1, -1, 1, 1]
    gap = (found - np.asarray(best.parameters)[:4]) / best.standard_errors[:4]
    assert np.abs(gap).max() < 2
    assert extended.noise_variance >= 0.999 * float(best.noise_variance)


def test_without_noise_terms_it_is_arx():
    u, y = record("ARX", 1, 500)
    data = dataset(u, y)
    pool = jnx.polynomial_pool(
        data.channels, input_lags=(2, 3), output_lags=(1, 2), degree=1
    )
    found = extended_least_squares(pool, data, residual_lags=0).value
    arx = fit_linear(data, ARX(2, 2, 2)).value
    values = dict(zip(found.terms, found.coefficient, strict=True))
    # The plain columns are not centred: a condition of 1e5 costs some digits.
    assert values["1"] == pytest.approx(float(arx.constant), rel=1e-7)
    assert values["duty[t-2]"] == pytest.approx(float(arx.b[0][0]), rel=1e-7)
    errors = dict(zip(found.terms, found.error, strict=True))
    assert errors["1"] == pytest.approx(arx.standard_errors[-1], rel=1e-4)


def test_rounds_and_terms_have_their_limits(data, pool):
    few = extended_least_squares(pool, data, residual_lags=1, max_rounds=2)
    assert few.status == RESULTS.budget_spent and few.is_okay
    with pytest.raises(SpecError, match="residual_lags"):
        extended_least_squares(pool, data, residual_lags=-1)
    with pytest.raises(SpecError, match="output"):
        extended_least_squares(pool, data, residual_lags=1, output="z")
    short = Dataset.from_arrays(
        np.arange(9.0), np.ones(9), inputs=["u"], outputs=["y"], sample_time=1.0
    )
    with pytest.raises(DataError, match="need at least"):
        extended_least_squares(pool, short, residual_lags=1)


def test_terms_that_cannot_be_told_apart_are_named(pool):
    u, y, _ = narmax(0, 200)
    u = np.sign(u)
    data = Dataset.from_arrays(u, y, inputs=["u"], outputs=["y"], sample_time=1.0)
    found = extended_least_squares(pool, data, residual_lags=1)
    assert found.status == RESULTS.unidentifiable
    # Two levels: the squares of the input are the constant.
    assert "u[t-1]^2" in found.detail or "u[t-2]^2" in found.detail
    assert np.all(np.isfinite(found.value.coefficient))
