"""Ljung-Box, runs, mean, normality and operating points against what is known."""

import itertools
from typing import Any

import numpy as np
import pytest
import scipy.stats

from jaxnarx.evaluation.residual_tests.correlations import autocorrelation
from jaxnarx.evaluation.residual_tests.fits import global_fit
from jaxnarx.evaluation.residual_tests.operating_point import bin_by_operating_point
from jaxnarx.evaluation.residual_tests.residual import make_residual
from jaxnarx.evaluation.residual_tests.scalar_tests import (
    ljung_box,
    mean_test,
    normality,
    runs_test,
)


def plain(e, **more):
    return make_residual(e[None], np.ones((1, len(e)), bool), **more)


def runs_of(signs):
    return 1 + sum(a != b for a, b in itertools.pairwise(signs))


def test_runs_are_counted_against_all_arrangements_of_the_signs():
    # Moments by enumeration, one stretch of 5 and 4, one of 2 and 3 signs.
    stretches = [[1, 1, -1, 1, -1, -1, 1, 1, -1], [1, -1, -1, 1, -1]]
    mean = variance = 0.0
    for signs in stretches:
        ups = sum(s > 0 for s in signs)
        counts = [
            runs_of([1 if i in chosen else -1 for i in range(len(signs))])
            for chosen in itertools.combinations(range(len(signs)), ups)
        ]
        mean += np.mean(counts)
        variance += np.var(counts)
    found = sum(map(runs_of, stretches))
    joined = np.array([*stretches[0], 0.0, *stretches[1]])
    one = make_residual(joined[None], joined[None] != 0, centre=False)
    score = (found - mean) / np.sqrt(variance)
    assert runs_test(one).statistic == pytest.approx(score, rel=1e-12)
    two = np.zeros((2, 9))
    two[0], two[1, :5] = stretches
    records = make_residual(two, two != 0, centre=False)
    assert runs_test(records).statistic == pytest.approx(score, rel=1e-12)


@pytest.mark.slow
def test_runs_of_a_fitted_autoregression_vary_less():
    # White noise fitted as an AR(1): 1 - 4/pi^2 of the variance is left.
    rng = np.random.default_rng(1)
    scores = []
    for _ in range(300):
        e = rng.normal(size=301)
        fit = global_fit(e[:-1, None])
        scores.append(runs_test(plain(fit.remove_fit(e[1:, None])[:, 0], fit=fit)))
    spread = np.std([s.statistic for s in scores])
    # 300 draws: 1/sqrt(600) = 4 %. Uncorrected it would be sqrt(1 - 4/pi^2) = 0.77.
    assert spread == pytest.approx(1.0, abs=0.13)


def test_ljung_box_of_white_noise_has_as_many_degrees_as_lags():
    e = np.random.default_rng(2).normal(size=2000)
    residual = plain(e, centre=False)
    got = ljung_box(residual, autocorrelation(residual, lags=12))
    r = np.array([e[k:] @ e[:-k] for k in range(1, 13)]) / (e @ e)
    q = 2000 * 2002 * np.sum(r**2 / (2000 - np.arange(1, 13)))
    assert got.statistic == pytest.approx(q, rel=1e-9)
    # Correlations between 12 lags of 2,000 samples: 12^2/2000 of the degrees.
    assert got.freedom == pytest.approx(12, abs=0.2)
    assert got.p == pytest.approx(scipy.stats.chi2.sf(q, 12), abs=0.02)


def test_ljung_box_loses_a_degree_for_every_fitted_lag():
    rng = np.random.default_rng(3)
    e = rng.normal(size=4001)
    fit = global_fit(e[:-1, None])
    residual = plain(fit.remove_fit(e[1:, None])[:, 0], fit=fit)
    got = ljung_box(residual, autocorrelation(residual, lags=12))
    assert got.freedom == pytest.approx(11, abs=0.2)


def test_the_mean_is_tested_by_student_unless_the_fit_made_it_zero():
    e = np.random.default_rng(4).normal(size=40) + 0.2
    want: Any = scipy.stats.ttest_1samp(e, 0.0)
    got = mean_test(plain(e))
    assert got is not None and got.p == pytest.approx(want.pvalue)
    assert mean_test(plain(e - e.mean(), fit=global_fit(np.ones((40, 1))))) is None


def test_normality_needs_samples_and_sees_a_heavy_tail():
    rng = np.random.default_rng(5)
    assert normality(plain(rng.normal(size=19))) is None
    heavy = normality(plain(rng.standard_t(3, size=500)))
    assert heavy is not None and heavy.p < 1e-6


def test_two_bins_without_a_fit_are_welchs_test():
    rng = np.random.default_rng(6)
    e = np.r_[rng.normal(size=300), 3 * rng.normal(size=300) + 0.4]
    side = np.repeat([0.0, 1.0], 300)
    got = bin_by_operating_point(plain(e), side, variable="x", bins=2)
    assert got is not None and got.samples.tolist() == [300, 300]
    t: Any = scipy.stats.ttest_ind(e[:300], e[300:], equal_var=False)
    # Equal but for 1/N in the variances.
    assert got.statistic == pytest.approx(t.statistic**2, rel=0.01)
    np.testing.assert_allclose(got.mean, [e[:300].mean(), e[300:].mean()])
    np.testing.assert_allclose(
        got.deviation, [e[:300].std(ddof=1), e[300:].std(ddof=1)]
    )


def test_bins_after_a_fit_are_the_f_test_of_adding_them():
    # Equal deviations by construction: mirrored residual signs within every bin.
    rng = np.random.default_rng(7)
    x = np.sort(rng.uniform(-1, 1, 400))
    y = 0.3 * x**2 + 0.2 * rng.normal(size=400)
    base = np.stack([np.ones(400), x], axis=1)
    fit = global_fit(base)
    residual = plain(fit.remove_fit(y[:, None])[:, 0], fit=fit)
    got = bin_by_operating_point(residual, x, variable="x", bins=8)
    assert got is not None
    bins = np.searchsorted(got.edges[1:-1], x, side="right")
    more = np.concatenate([base, np.eye(8)[bins]], axis=1)
    left = global_fit(more)
    sse = [np.sum(f.remove_fit(y[:, None]) ** 2) for f in (fit, left)]
    spare = 400 - left.parameters
    f = (sse[0] - sse[1]) / (left.parameters - 2) / (sse[1] / spare)
    assert got.freedom == pytest.approx((left.parameters - 2, spare), abs=1e-6)
    # Deviations of 50 samples a bin differ by 10 %, which enters with both signs.
    assert got.statistic == pytest.approx(f, rel=0.15)
    assert got.p < 1e-6


def test_a_variable_with_one_value_has_no_bins():
    e = np.random.default_rng(8).normal(size=50)
    assert bin_by_operating_point(plain(e), np.full(50, 2.0), variable="x") is None


def test_normal_scores_of_skewness_and_kurtosis_are_those_of_scipy():
    rng = np.random.default_rng(4)
    for n in (20, 57, 3000):
        for values in (rng.normal(size=n), rng.standard_t(3, size=n), rng.random(n)):
            found = normality(plain(values))
            assert found is not None and found.statistic is not None
            theirs = scipy.stats.normaltest(values)
            np.testing.assert_allclose(found.statistic, theirs.statistic, rtol=1e-9)
            np.testing.assert_allclose(found.p, theirs.pvalue, rtol=1e-9)
