"""The nonlinear Box-Jenkins model against the system that made the data."""

from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy.signal

import jaxnarx as jnx

C, D = [1.0, 0.5], [1.0, -0.9]
SIGMA = 0.05


@cache
def system(seed: int, rows: int = 1500) -> tuple[jnx.Dataset, np.ndarray, np.ndarray]:
    """y = w + C/D e, w(t) = 0.6 w(t-1) + u(t-1) + 0.5 u(t-1)^2; the data, w, e."""
    rng = np.random.default_rng(seed)
    u, w = rng.uniform(-1, 1, rows), np.zeros(rows)
    for t in range(1, rows):
        w[t] = 0.6 * w[t - 1] + u[t - 1] + 0.5 * u[t - 1] ** 2
    e = SIGMA * rng.normal(size=rows)
    y = w + np.asarray(scipy.signal.lfilter(C, D, e))
    names: dict[str, Any] = {"inputs": ["u"], "outputs": ["y"], "sample_time": 1.0}
    return jnx.Dataset.from_arrays(u, y, **names), w, e


@cache
def plant() -> jnx.Network:
    """The true w, from records without noise."""
    data, w, _ = system(0)
    names: dict[str, Any] = {"inputs": ["u"], "outputs": ["y"], "sample_time": 1.0}
    clean = jnx.Dataset.from_arrays(data[0].records[0].u, w, **names)
    lags: dict[str, Any] = {"input_lags": (1,), "output_lags": (1,), "degree": 2}
    pool = jnx.polynomial_pool(clean.channels, **lags)
    method = jnx.ForwardOLS(max_terms=4)
    return jnx.grow(jnx.select(pool, clean, method).value, clean, jnx.Global()).value


@cache
def fitted() -> jnx.Solution:
    return jnx.linear.fit_noise(plant(), system(1)[0], nc=1, nd=1)


def test_the_noise_is_recovered_within_its_standard_errors():
    model = fitted().value.noise
    found = [float(model.c[1]), float(model.d[1])]
    truth = np.array([C[1], D[1]])
    # The constant is the last parameter.
    z = (np.array(found) - truth) / model.standard_errors[:2]
    assert np.abs(z).max() < 4.5
    assert float(model.noise_variance) == pytest.approx(SIGMA**2, rel=0.2)
    np.testing.assert_allclose(
        model.noise_transfer_function().poles, [-D[1]], atol=0.05
    )


def test_one_step_predictions_leave_the_innovations():
    """On unseen data: y - y(t | t-1) is e; the free run leaves C/D e, much more."""
    data, w, e = system(2)
    one = fitted().value.predict(data)
    y = data.records[0].y[:, 0]
    scored = one.scored[0]
    np.testing.assert_allclose(one.predicted[0] + one.error[0], y, rtol=1e-12)
    error = (y - one.predicted[0])[scored]
    # Five standard deviations of the scatter of a standard deviation.
    spread = 5 / np.sqrt(2 * len(error))
    assert np.std(error) == pytest.approx(SIGMA, rel=spread)
    assert np.corrcoef(error, e[scored])[0, 1] > 0.99
    assert np.std((y - w)[scored]) > 2 * np.std(error)


def test_without_c_and_with_d_it_is_an_autoregression_of_the_free_run_error():
    """Least squares of v(t) on v(t-1) and one, by hand."""
    data, _, _ = system(1)
    model = jnx.linear.fit_noise(plant(), data, nc=0, nd=1).value.noise
    run = jnx.simulate(plant(), data).value
    v = data.records[0].y[:, 0] - run.outputs[0][:, 0]
    v = v[run.scored[0][:, 0]][1:]
    columns = np.stack([v[:-1], np.ones(len(v) - 1)], axis=1)
    slope = np.linalg.lstsq(columns, v[1:], rcond=None)[0][0]
    # The search has e = 0 before the record: one sample of 1,500.
    assert float(model.d[1]) == pytest.approx(-slope, abs=5e-3)
