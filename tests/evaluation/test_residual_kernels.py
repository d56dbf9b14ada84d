"""Kernels of the residual tests: lagged sums, fits, quantiles, and their variances."""

import numpy as np
import pytest
import scipy.stats

from jaxnarx.evaluation.residual_tests.bounds import (
    NORMAL_SCORE_GRID,
    bent_quantile,
    correlation_quantile,
    correlation_score,
    joint_p,
    joint_score,
)
from jaxnarx.evaluation.residual_tests.correlations import (
    autocorrelation,
    input_correlation,
    normal_scores_of_squares,
    output_product,
)
from jaxnarx.evaluation.residual_tests.fits import global_fit, local_fit
from jaxnarx.evaluation.residual_tests.lag_tests import product_test
from jaxnarx.evaluation.residual_tests.lagged import lagged_products, lagged_rows
from jaxnarx.evaluation.residual_tests.residual import make_residual


def autoregression(rng, samples, pole):
    y = np.zeros(samples)
    for t, e in enumerate(rng.normal(size=samples)):
        y[t] = pole * y[t - 1] + e if t else e
    return y


def test_lagged_sums_are_those_of_loops_within_records_and_between_gaps():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 3, 17)) * (rng.uniform(size=(2, 3, 17)) > 0.2)
    lags = np.arange(-6, 7)
    want = [
        sum(
            a[n, t - k] * b[n, t]
            for n in range(3)
            for t in range(17)
            if 0 <= t - k < 17
        )
        for k in lags
    ]
    # Rounding of a transform of 23 numbers of size one.
    np.testing.assert_allclose(lagged_products(a, b, lags), want, atol=1e-12)
    at = np.arange(3 * 17)
    rows = lagged_rows(a, at, lags)
    np.testing.assert_allclose(rows.T @ b.reshape(-1), want, atol=1e-12)
    assert rows[at % 17 == 0, 7].tolist() == [0.0, 0.0, 0.0]


def test_a_fit_leaves_what_least_squares_leave_also_of_dependent_columns():
    rng = np.random.default_rng(2)
    x = rng.normal(size=(30, 4)) * [1.0, 1e6, 1e-6, 1.0]
    x[:, 3] = x[:, 0] + x[:, 1]
    z = rng.normal(size=(30, 2))
    fit = global_fit(x)
    solved = np.linalg.lstsq(x[:, :3] / [1.0, 1e6, 1e-6], z)[0]
    left = z - x[:, :3] / [1.0, 1e6, 1e-6] @ solved
    np.testing.assert_allclose(fit.remove_fit(z), left, atol=1e-9)
    assert fit.parameters == pytest.approx(3) and fit.condition == (np.inf,)
    assert fit.leverage.sum() == pytest.approx(3)


def test_the_answer_of_a_fit_is_the_map_from_noise_to_coefficients():
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(25, 3)) * [1.0, 50.0, 0.01], rng.normal(size=25)
    got = global_fit(x).answer.T @ y
    np.testing.assert_allclose(got, np.linalg.lstsq(x, y)[0], rtol=1e-10)


def test_a_local_fit_smooths_like_its_local_models():
    rng = np.random.default_rng(4)
    p, z = rng.normal(size=(40, 2)), rng.normal(size=(40, 1))
    share = rng.uniform(size=40)
    phi = np.stack([share, 1 - share])
    smooth = np.zeros((40, 40))
    thetas = []
    for weight in phi:
        w = np.diag(weight)
        solve = np.linalg.solve(p.T @ w @ p, p.T @ w)
        smooth += w @ p @ solve
        thetas.append(solve @ z[:, 0])
    fit = local_fit([p, p], phi)
    np.testing.assert_allclose(fit.remove_fit(z), z - smooth.T @ z, atol=1e-12)
    assert fit.parameters == pytest.approx(np.trace(smooth))
    np.testing.assert_allclose(fit.answer.T @ z[:, 0], np.concatenate(thetas))


# quantiles ------------------------------------------------------------------------


@pytest.mark.parametrize("freedom", [3.0, 50.0, 1e5])
def test_a_squared_correlation_is_beta_distributed(freedom):
    z = np.array([-3.0, -1.0, 0.0, 0.5, 2.5])
    r = correlation_quantile(z, freedom)
    tail = scipy.stats.beta(0.5, freedom / 2).sf(r**2)
    np.testing.assert_allclose(tail, 2 * scipy.stats.norm.sf(np.abs(z)), rtol=1e-9)
    np.testing.assert_allclose(correlation_score(r, freedom), z, atol=1e-9)


def test_bent_quantiles_rise_keep_moments_and_mirror():
    g, h = np.array([0.0, 0.3, 1.5, 4.0]), np.array([0.0, 0.2, 6.0, 30.0])
    bent = bent_quantile(NORMAL_SCORE_GRID, g, h)
    assert np.all(np.diff(bent, axis=1) >= 0)
    np.testing.assert_allclose(bent[0], NORMAL_SCORE_GRID, atol=1e-12)
    mirrored = bent_quantile(NORMAL_SCORE_GRID, -g, h)
    np.testing.assert_allclose(mirrored[1:], -bent[1:, ::-1])
    weight = scipy.stats.norm.pdf(NORMAL_SCORE_GRID)
    weight /= weight.sum()
    # The cubic term is exact to first order only: second-order terms of 0.2/24.
    for power, want in ((1, 0.0), (2, 1.0), (3, 0.3)):
        assert bent[1] ** power @ weight == pytest.approx(want, abs=0.02)


def test_slight_bending_is_that_of_cornish_and_fisher():
    g, h, z = 1e-3, 2e-3, np.linspace(-3, 3, 61)
    want = z + g * (z**2 - 1) / 6 + h * (z**3 - 3 * z) / 24
    got = bent_quantile(z, np.array([g]), np.array([h]))[0]
    # What is left is of second order: g^2 (2 z^3 - 5 z)/36 is 1e-6.
    np.testing.assert_allclose(got, want, atol=5e-6)


def test_the_joint_score_of_independent_and_of_equal_lags():
    sidak = float(scipy.stats.norm.isf((1 - 0.95 ** (1 / 20)) / 2))
    # 4,096 points: the level is met to sqrt(0.05/4096) = 0.0035 or better, which is
    # 0.03 in the score.
    assert joint_score(np.eye(20), 0.05) == pytest.approx(sidak, abs=0.03)
    one = scipy.stats.norm.isf(0.025)
    assert joint_score(np.ones((20, 20)), 0.05) == pytest.approx(one, abs=0.03)
    assert joint_score(np.zeros((0, 0)), 0.05) == pytest.approx(one)
    assert joint_p(2.5, 2.5, 0.05) == pytest.approx(0.05)
    assert joint_p(sidak + 1, sidak, 0.05) < 0.05 < joint_p(1.0, sidak, 0.05)


# variances ------------------------------------------------------------------------


@pytest.mark.parametrize("centre", [False, True])
def test_white_noise_has_its_exact_variance_at_every_lag(centre):
    # Without a mean var r_k = (N - k)/(N (N + 2)); with it by the moments of a ratio of
    # quadratic forms in e, Dufour and Roy 1985: A the lag matrix, M = I - 11'/N.
    n, draws, lags = 30, 80, np.array([1, 4, 9])
    rng = np.random.default_rng(5)
    claimed = np.zeros(len(lags))
    for _ in range(draws):
        known = np.ones((1, n), bool)
        residual = make_residual(rng.normal(size=(1, n)), known, centre=centre)
        claimed += np.diagonal(autocorrelation(residual, lags=9).covariance)[lags - 1]
    m = np.eye(n) - centre / n
    want = []
    for k in lags:
        a = m @ (np.eye(n, k=k) + np.eye(n, k=-k)) / 2
        f = n - centre
        second = (np.trace(a) ** 2 + 2 * np.trace(a @ a)) / (f * (f + 2))
        want.append(second - (np.trace(a) / f) ** 2)
    if not centre:
        np.testing.assert_allclose(want, (n - lags) / (n * (n + 2)))
    # 80 draws settle the mean to 1 %; taking the mean out of both ends of a product is
    # followed to the first order in 1/N only, 4 % here and 0.6 % at N = 200.
    np.testing.assert_allclose(claimed / draws, want, rtol=0.07 if centre else 0.03)


def test_residuals_of_a_fitted_autoregression_vary_as_box_and_pierce_say():
    # 1970: N var r_k = 1 - (1 - a^2) a^(2k - 2) for an AR(1) with pole a.
    n, pole = 40_000, 0.6
    y = autoregression(np.random.default_rng(6), n, pole)
    fit = global_fit(y[:-1, None])
    known = np.ones((1, n - 1), bool)
    residual = make_residual(fit.remove_fit(y[1:, None]).T, known, fit=fit)
    test = autocorrelation(residual, lags=6)
    k = test.lags
    want = 1 - (1 - pole**2) * pole ** (2 * k - 2)
    # Sampling of the regressors: a few times 1/sqrt(N) = 0.005.
    np.testing.assert_allclose(n * np.diagonal(test.covariance), want, atol=0.015)
    assert residual.parameters == pytest.approx(1) and not residual.centred


def test_lags_inside_the_model_have_nothing_to_test():
    rng = np.random.default_rng(7)
    u = rng.normal(size=401)
    y = u[:-1] + 0.1 * rng.normal(size=400)
    fit = global_fit(np.stack([u[:-1], np.ones(400)], axis=1))
    value = np.r_[0.0, fit.remove_fit(y[:, None])[:, 0]][None]
    residual = make_residual(value, np.arange(401)[None] > 0, fit=fit)
    known = np.ones((1, 401), bool)
    test = input_correlation(residual, u[None], known, signal="u", lags=3)
    assert test.lags[test.tested].tolist() == [0, 2, 3]
    at_one = test.lags == 1
    np.testing.assert_allclose(test.value[at_one], 0.0, atol=1e-12)
    assert test.high[at_one] == 0.0


@pytest.mark.slow
def test_the_share_inside_the_bounds_is_the_claimed_one():
    # Skewed noise and 60 samples, where moments of r_k beyond the second matter.
    rng = np.random.default_rng(8)
    inside, draws, lags = 0.0, 250, 10
    for _ in range(draws):
        e = rng.exponential(size=(1, 60))
        test = autocorrelation(make_residual(e, np.ones((1, 60), bool)), lags=lags)
        inside += np.mean((test.value >= test.low) & (test.value <= test.high))
    # 2,500 nearly independent trials: standard error 0.0044.
    assert inside / draws == pytest.approx(0.95, abs=0.013)


@pytest.mark.slow
def test_products_with_the_output_have_the_variance_of_simulations():
    # y = f + e with f known before: cov(y e, z) over draws of e at fixed f and z.
    rng = np.random.default_rng(9)
    n, draws, lags = 400, 300, np.array([1, 2])
    z, known = rng.normal(size=(1, n)) ** 2, np.ones((1, n), bool)
    z -= z.mean()
    f = np.roll(z, 1, axis=1) + 0.5 * rng.normal(size=(1, n))
    f -= f.mean()
    value, claimed = np.zeros((draws, 2)), np.zeros(2)
    for i in range(draws):
        e = rng.normal(size=(1, n))
        residual = make_residual(e, known, centre=False)
        test = product_test(residual, f + e, z, lags, name="")
        value[i] = test.value
        claimed += np.diagonal(test.covariance)
    # The variance over 300 draws is known to sqrt(2/300) = 8 %: three times that.
    # With f and z independent it would be 1/400, wrong by more than 1.5 at lag 1.
    np.testing.assert_allclose(claimed / draws / value.var(axis=0), 1.0, rtol=0.25)
    assert value.var(axis=0)[0] * n > 1.5


def test_scores_of_squares_are_normal_whatever_the_noise():
    rng = np.random.default_rng(10)
    e = rng.standard_t(2, size=(2, 300))
    known = rng.uniform(size=(2, 300)) > 0.1
    residual = make_residual(e, known)
    scores = normal_scores_of_squares(residual)
    assert np.all(scores.value[~known] == 0)
    assert abs(scipy.stats.kurtosis(scores.value[known])) < 0.2
    order = np.argsort(residual.value[known] ** 2)
    assert np.all(np.diff(scores.value[known][order]) >= 0)
    test = output_product(residual, np.where(known, e, 0.0))
    assert test.lags.tolist() == list(range(1, 21)) and 0 <= test.p <= 1
