"""Whether an engine is still itself."""

import jax.numpy as jnp
import numpy as np
from fleet_problems import coefficients, engine, learnt

import jaxnarx as jnx
from jaxnarx.fleet._compare import _log_evidence
from jaxnarx.fleet.member import sum_records

NEW = coefficients(6, 77)


def test_an_engine_is_itself_and_another_is_not():
    prior = learnt().value
    for n, theta in enumerate(NEW[:3]):
        before = engine(theta, 80, 10 + n)
        same = jnx.fleet.compare_records(prior, before, engine(theta, 80, 50 + n))
        assert same.value.same is True and same.is_okay
        other = jnx.fleet.compare_records(prior, before, engine(NEW[5], 80, 50 + n))
        assert other.value.same is False
        assert "changed" in str(other.value) and other.value.changed


def test_records_that_tell_nothing_are_not_clear():
    prior = learnt().value
    one = engine(NEW[0], 3, 1)
    found = jnx.fleet.compare_records(prior, one, one)
    assert found.value.same is None


def test_evidence_is_that_of_the_normal_distribution():
    """Up to a constant: the difference between two engines' records of one length."""
    prior = learnt().value
    found, true = [], []
    gain = float(prior.network.gain[-1])
    for n in (0, 1):
        data = engine(NEW[n], 40, 3)
        sums = sum_records(prior, data)
        found.append(_log_evidence(prior, sums))
        runs = jnx.prepare(prior.network, data)
        rows = np.flatnonzero(np.asarray(runs.scored)[0, :, 0])
        run = np.asarray(jnx.free_run(prior.network, runs))[0, rows, 0] / gain
        y = data.records[0].y[rows, 0] / gain
        slopes = []
        for k in range(len(prior.names)):
            v = np.zeros(len(prior.names))
            v[k] = 1.0
            moved = jnx.free_run(prior.coefficients.place(jnp.asarray(v)), runs)
            slopes.append(np.asarray(moved)[0, rows, 0] / gain - run)
        j = np.array(slopes).T
        population = prior.population
        noise = float(population.noise[0] * population.colour[0])
        cov = j @ np.asarray(population.covariance) @ j.T + noise * np.eye(len(rows))
        far, size = y - run, np.linalg.slogdet(cov)[1]
        true.append(-0.5 * (far @ np.linalg.solve(cov, far) + size))
    np.testing.assert_allclose(found[0] - found[1], true[0] - true[1], rtol=1e-6)
