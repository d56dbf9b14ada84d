"""Which test tells most about a new engine of a fleet."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from fleet_problems import coefficients, engine, learnt

import jaxnarx as jnx
from jaxnarx.errors import SpecError
from jaxnarx.fleet.information import Information
from jaxnarx.fleet.member import know_member, sum_records


def planned(duration: float = 3.0, **asked) -> jnx.Solution:
    return jnx.fleet.plan(learnt().value, duration=duration, **asked)


def measured(prior, u: np.ndarray) -> Information:
    """Sums of an engine under these inputs."""
    theta = coefficients(1, 5)[0]
    y = np.full(len(u), theta[0])
    for t in range(2, len(u)):
        y[t] = np.array([1.0, u[t - 1], u[t - 2], u[t - 1] ** 2]) @ theta
    same = engine(theta, len(u), 1)
    data = jnx.Dataset.from_arrays(
        u, y, inputs="u", outputs="y", sample_time=same.sample_time
    )
    return sum_records(prior, data)


def test_the_plan_learns_more_than_steps_do():
    prior, found = learnt().value, planned()
    u = found.value.inputs[:, 0]
    theta = coefficients(1, 5)[0]
    usual = sum_records(prior, engine(theta, len(u), 9))

    def left(sums):
        return np.trace(know_member(prior, sums).covariance)

    whole = np.trace(prior.population.covariance)
    assert left(measured(prior, u)) < left(usual) < whole
    # Rows of some samples stand for all, so that this is near, not the same.
    true = 1 - left(measured(prior, u)) / whole
    assert found.stats["learnt"] == pytest.approx(true, abs=0.05)


def test_limits_hold_and_a_rest_begins_it():
    prior = dataclasses.replace(learnt().value, warm_up=7)
    found = jnx.fleet.plan(prior, duration=3.0, ranges={"u": (-0.5, 0.25)}, seed=2)
    u = found.value.inputs[:, 0]
    assert len(u) == 30 + 7 and np.all(u[:7] == u[0])
    assert u.min() >= -0.5 and u.max() <= 0.25


def test_a_population_that_does_not_differ_has_nothing_to_tell():
    prior = learnt().value
    same = jnp.full_like(prior.population.covariance, 0.0)
    population = dataclasses.replace(prior.population, covariance=same)
    with pytest.raises(SpecError, match="do not differ"):
        jnx.fleet.plan(dataclasses.replace(prior, population=population), duration=3.0)


def test_engines_are_drawn_from_the_population():
    prior = learnt().value
    some = jnx.fleet.draw_engines(prior, 64, seed=3)
    again = jnx.fleet.draw_engines(prior, 64, seed=3)
    own = prior.coefficients
    at = np.asarray(own.free)
    rows = np.stack([np.asarray(own.layout.gather(n))[at] for n in some])
    same = np.stack([np.asarray(own.layout.gather(n))[at] for n in again])
    np.testing.assert_array_equal(rows, same)
    found = (rows - np.asarray(own.start)[at]) / np.asarray(own.scale)
    spread = np.sqrt(np.diag(np.asarray(prior.population.covariance)))
    np.testing.assert_allclose(found.std(axis=0), spread, rtol=0.4, atol=1e-3)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(SpecError, match="duration"):
        planned(-1.0)
    with pytest.raises(SpecError, match="ranges"):
        planned(ranges={"v": (0.0, 1.0)})
