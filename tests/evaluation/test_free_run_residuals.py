"""Correlations of free-run residuals: how often they cry wolf, and what they find."""

import dataclasses
from functools import cache

import common
import numpy as np
import pytest
import scipy.signal

import jaxnarx as jnx
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import diagnose_free_run
from jaxnarx.evaluation.residual_tests.free_run import _correlation, product_covariance


def coloured(rng, shape, pole: float):
    white = rng.normal(size=(shape[0], shape[1] + 200))
    return np.asarray(scipy.signal.lfilter([1.0], [1.0, -pole], white))[:, 200:]


def test_the_variance_of_a_correlation_is_that_of_many_trials():
    """Two AR(1) series: sum of R_u R_e, (1 + pq)/(1 - pq) times that of white ones."""
    rng = np.random.default_rng(0)
    p, q, shape = 0.8, 0.9, (3, 400)
    told, sums = [], []
    for _ in range(400):
        u, e = coloured(rng, shape, p), coloured(rng, shape, q)
        told.append(product_covariance(u, e, e.size, 3))
        sums.append(np.sum(u * e))
    exact = (1 + p * q) / (1 - p * q) / (1 - p**2) / (1 - q**2) * 1200
    # The taper takes 2/200 per lag of some 7; 400 trials know a variance to 7 %.
    assert np.mean(told, axis=0)[0] == pytest.approx(exact, rel=0.1)
    assert np.var(sums) == pytest.approx(exact, rel=0.2)


def test_coloured_noise_is_seldom_taken_for_a_finding():
    rng = np.random.default_rng(1)
    p = np.array(
        [
            _correlation(
                coloured(rng, (2, 400), 0.9),
                coloured(rng, (2, 400), 0.9),
                800,
                *("u", 12, 0.05),
            ).p
            for _ in range(300)
        ]
    )
    # 300 trials at 5 %: 15 are expected, 26 or more have probability 0.5 %; taking the
    # residual as white would make it more than half of them.
    assert 3 <= np.sum(p < 0.05) <= 26


@cache
def noisy(missing: float) -> jnx.Dataset:
    """Free runs of a network with coloured noise, and a share of b that it misses."""
    rng = np.random.default_rng(6)
    plain = common.dataset((300, 299))
    run = jnx.simulate(common.named("one model"), plain).value
    records = []
    for n, r in enumerate(plain):
        noise = coloured(rng, (1, len(r)), 0.9)[0]
        lost = missing * np.r_[np.zeros(3), r.u[:-3, 1]]
        y = r.y.copy()
        y[:, 0] = run.outputs[n][:, 0] + noise + lost
        records.append(dataclasses.replace(r, y=y))
    return dataclasses.replace(plain, records=tuple(records))


def test_a_right_model_in_coloured_noise_has_no_findings():
    (found,) = diagnose_free_run(common.named("one model"), noisy(0.0)).value
    assert found.significant_inputs() == [] and found.samples > 590
    assert found.autocorrelation.value[0] == pytest.approx(0.9, abs=0.06)
    assert not found.autocorrelation.tested.any()


def test_an_input_that_is_missed_is_found_at_its_lag():
    (found,) = diagnose_free_run(common.named("one model"), noisy(6.0)).value
    assert found.significant_inputs() == ["b"]
    (test,) = [t for t in found.inputs if t.signal == "b"]
    assert test.worst == 3 and test.effect > 0.2
    assert "b" in str(found)


def test_what_cannot_be_tested_is_told():
    tight = common.named("one model", bound=1e-3)
    assert diagnose_free_run(tight, noisy(0.0)).status_name == "diverged"
    short = diagnose_free_run(common.named("one model"), common.dataset((20,)))
    assert short.status_name == "too_short" and short.value == ()
    with pytest.raises(SpecError, match="lags is at least 1"):
        diagnose_free_run(common.named("one model"), noisy(0.0), lags=0)
