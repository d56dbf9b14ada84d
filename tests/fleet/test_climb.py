"""Coefficients of engines whose runs are not linear in them."""

import jax
import numpy as np
import pytest
import scipy.optimize
from fleet_problems import MEAN, donors, engine, structure

import jaxnarx as jnx
from jaxnarx.fleet.climb import Climb, climb, sums_about
from jaxnarx.fleet.coefficients import choose_coefficients
from jaxnarx.fleet.information import Information, gather_information, parts_of
from jaxnarx.linear import HiddenStates, fit_states

SHARES = 0.3, 0.5, 0.7, 0.85
"""Shares of the last output that are fed back, of engines in turns."""


@pytest.fixture(scope="module")
def problem():
    """Coefficients of a network with feedback, and an engine with more of it."""
    own = choose_coefficients(structure(fed=True), gates=False, feedback=True)
    data = engine(MEAN, 200, 3, fed=0.8)
    return own, jnx.prepare(structure(fed=True), data)


def gathered(own, runs, v):
    part = jax.device_put(parts_of(runs, ()))
    return Information(*map(np.asarray, gather_information(own, v, runs, part, 1)))


def test_sums_told_about_another_place_are_the_same_parabola(problem):
    own, runs = problem
    random = np.random.default_rng(0)
    v, step = 0.01 * random.normal(size=(2, len(own.free)))
    about_v = gathered(own, runs, v).total()
    about_zero = sums_about(own, v, runs, parts_of(runs, ()), 1).total()
    np.testing.assert_allclose(about_zero.loss(v + step), about_v.loss(step))
    np.testing.assert_allclose(about_zero.shift(v).right, about_v.right)


@pytest.mark.parametrize("known_noise", [False, True])
def test_it_ends_where_a_general_minimiser_does(problem, known_noise):
    own, runs = problem
    params = len(own.free)
    count = np.array([0.02 if known_noise else 1.0])
    drawn = Climb(np.zeros(params), 2.0 * np.eye(params), count, known_noise)
    part = jax.device_put(parts_of(runs, ()))
    found = climb(own, runs, part, drawn, np.zeros(params))

    def value(w):
        total = gathered(own, runs, 2.0 * w).total()
        square, samples = float(total.square[0]), float(total.samples[0])
        loss = square / count[0] if known_noise else samples * np.log(square / samples)
        return loss / 2 + w @ w / 2

    best = scipy.optimize.minimize(value, found / 2.0, method="Nelder-Mead")
    assert value(found / 2.0) < best.fun + 0.02
    assert value(found / 2.0) < value(np.zeros(params)) - 100


def test_a_fleet_with_other_feedback_is_learnt_and_served():
    some = {
        f"engine {n}": engine(MEAN, 200, 40 + n, fed=SHARES[n % 4]) for n in range(12)
    }
    found = jnx.fleet.learn(some, structure(fed=True), feedback=True, rungs=(10, 40))
    prior = found.value
    assert found.is_okay and not prior.linear and not prior.broken()
    assert prior.expected()["prior"][-1] < 0.5 * prior.expected()["as is"][-1]
    new = engine(MEAN, 40, 90, fed=0.65)
    later = engine(MEAN, 200, 91, fed=0.65, noise=0.0)
    value = jnx.fleet.calibrate(prior, new).value
    y, run = later.records[0].y, jnx.simulate(value, later).value.outputs[0]
    assert np.sqrt(np.mean((run - y)[10:] ** 2)) < 0.1 * y.std()
    odds = jnx.fleet.compare_records(prior, new, engine(MEAN, 100, 92, fed=0.65))
    assert odds.value.same is not False


@pytest.mark.slow
def test_hidden_states_are_a_structure_of_a_fleet():
    data = donors(fed=0.5)
    network = fit_states(
        data["engine 0"], HiddenStates(states=1, degree=1, shrink=(0.1,), window=20)
    ).value
    some = {name: data[name] for name in list(data)[:4]}
    found = jnx.fleet.learn(some, network, rungs=(20, 40))
    assert found.is_okay and len(found.value.names) > 2
    assert jnx.fleet.calibrate(found.value, data["engine 9"]).is_okay
