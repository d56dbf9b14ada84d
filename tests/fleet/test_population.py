"""Posterior and EM algorithm against plain NumPy, on known populations."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import scipy.signal
from fleet_problems import MEAN, NOISE, ROOT, donors, learnt

from jaxnarx.fleet.broken import find_broken, squared_distances
from jaxnarx.fleet.information import Information
from jaxnarx.fleet.ladder import _begins
from jaxnarx.fleet.population import (
    Population,
    begin_population,
    fit_population,
    posterior,
    root_of,
)
from jaxnarx.fleet.rivals import estimate_each, expect_errors, make_rivals

PARAMS, ENGINES, SAMPLES = 3, 40, 30


def draw(seed: int = 0):
    """Rows, targets and coefficients of linear engines."""
    rng = np.random.default_rng(seed)
    mean = np.array([1.0, -2.0, 0.5])
    root = np.array([[0.5, 0.0, 0.0], [0.2, 0.3, 0.0], [0.0, 0.1, 0.05]])
    theta = mean + rng.normal(size=(ENGINES, PARAMS)) @ root.T
    x = rng.normal(size=(ENGINES, SAMPLES, PARAMS))
    y = np.einsum("esp,ep->es", x, theta) + 0.2 * rng.normal(size=(ENGINES, SAMPLES))
    return x, y, theta, mean, root


def sums(x, y) -> Information:
    """About zero, one output; errors are run - measured."""
    return Information(
        np.einsum("es,es->e", y, y)[:, None],
        -np.einsum("esp,es->ep", x, y)[:, None],
        np.einsum("esp,esq->epq", x, x)[:, None],
        np.full((len(y), 1), float(y.shape[1])),
    )


def test_posterior_is_that_of_the_normal_distribution():
    x, y, _, mean, root = draw()
    covariance, noise = root @ root.T, 0.04
    one = Information(*(a[0] for a in sums(x, y)))
    found = posterior(
        one, np.zeros(PARAMS), np.array([1 / noise]), mean, root_of(covariance)
    )
    inverse = np.linalg.inv(covariance)
    expected = np.linalg.inv(x[0].T @ x[0] / noise + inverse)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-8, atol=1e-12)
    mode = expected @ (x[0].T @ y[0] / noise + inverse @ mean)
    np.testing.assert_allclose(found.mean, mode, rtol=1e-8)


def test_posterior_may_have_a_singular_prior():
    x, y, _, mean, _ = draw()
    one = Information(*(a[0] for a in sums(x, y)))
    nothing = np.zeros((PARAMS, PARAMS))
    found = posterior(one, np.zeros(PARAMS), np.array([25.0]), mean, nothing)
    np.testing.assert_allclose(found.mean, mean)
    np.testing.assert_allclose(found.covariance, nothing, atol=1e-15)


def log_likelihood(x, y, population) -> float:
    total = 0.0
    for rows, targets in zip(x, y, strict=True):
        cov = rows @ np.asarray(population.covariance) @ rows.T
        cov = cov + float(population.noise[0]) * np.eye(len(targets))
        far = targets - rows @ np.asarray(population.mean)
        total -= 0.5 * (far @ np.linalg.solve(cov, far) + np.linalg.slogdet(cov)[1])
    return total


def test_every_step_of_em_makes_the_data_more_likely():
    x, y, *_ = draw()
    every = sums(x, y)
    chunks = [(every, np.zeros((ENGINES, PARAMS)), np.ones(ENGINES))]
    start = Population(
        jnp.zeros(PARAMS), jnp.eye(PARAMS), jnp.array([1.0]), jnp.array([1.0])
    )
    likely = []
    for _ in range(12):
        likely.append(log_likelihood(x, y, start))
        start = fit_population(chunks, start, 1)[0]
    assert np.all(np.diff(likely)[:6] > 0)
    # behind that the shrinkage of the covariance costs a little
    assert likely[-1] > likely[5] - 1.0


def test_population_is_found_again():
    x, y, theta, *_ = draw()
    chunks = [(sums(x, y), np.zeros((ENGINES, PARAMS)), np.ones(ENGINES))]
    start = Population(
        jnp.zeros(PARAMS), jnp.eye(PARAMS), jnp.array([1.0]), jnp.array([1.0])
    )
    found, means, _ = fit_population(chunks, start)
    np.testing.assert_allclose(found.mean, theta.mean(axis=0), atol=0.05)
    np.testing.assert_allclose(found.covariance, np.cov(theta.T), atol=0.06)
    np.testing.assert_allclose(found.noise, [0.04], rtol=0.1)
    assert np.sqrt(np.mean((means - theta) ** 2)) < 0.05


def test_coloured_residuals_are_not_taken_for_differences_of_engines():
    """Slow inputs beside slow residuals: as white noise they widen the covariance."""
    rng = np.random.default_rng(3)
    pole, size, rows = 0.9, (ENGINES, 300), np.zeros((ENGINES, 300, PARAMS))

    def slow():
        noise = rng.normal(size=size)
        kept = scipy.signal.lfilter([np.sqrt(1 - pole**2)], [1, -pole], noise)
        return np.asarray(kept)

    for k in range(PARAMS):
        rows[:, :, k] = slow()
    theta = 0.05 * rng.normal(size=(ENGINES, PARAMS))
    y = np.einsum("esp,ep->es", rows, theta) + 0.5 * slow()
    chunks = [(sums(rows, y), np.zeros((ENGINES, PARAMS)), np.ones(ENGINES))]
    spread, error = [], []
    for colour in (1.0, (1 + pole) / (1 - pole)):
        start = begin_population(*chunks[0][:2], np.array([colour]))
        found, means, _ = fit_population(chunks, start)
        np.testing.assert_allclose(found.noise, [0.25], rtol=0.2)
        np.testing.assert_array_equal(found.precision, 1 / (found.noise * colour))
        spread.append(np.sqrt(np.trace(found.covariance) / PARAMS))
        error.append(np.sqrt(np.mean((means - theta) ** 2)))
    assert spread[0] > 1.7 * 0.05 and 0.5 * 0.05 < spread[1] < 1.2 * 0.05
    assert error[1] < 0.7 * error[0]


def test_few_donors_are_judged_by_several_stretches():
    for count, each in ((3, 4), (32, 4), (50, 2), (128, 1), (1000, 1)):
        found = _begins(count, 4)
        assert len(found) == count
        assert all(len(set(own)) == each for own in found)
    # Donors of one part begin elsewhere.
    assert len({own[0] for own in _begins(128, 4)[::4]}) == 4


def test_distance_is_that_of_the_estimate():
    x, y, _, mean, root = draw()
    population = Population(
        jnp.asarray(mean),
        jnp.asarray(root @ root.T),
        jnp.array([0.04]),
        jnp.array([1.0]),
    )
    square, freedom = squared_distances(
        sums(x, y), np.zeros((ENGINES, PARAMS)), population
    )
    gram = x[0].T @ x[0] / 0.04
    far = np.linalg.solve(x[0].T @ x[0], x[0].T @ y[0]) - mean
    cov = np.linalg.inv(gram) + root @ root.T
    np.testing.assert_allclose(square[0], far @ np.linalg.solve(cov, far), rtol=1e-8)
    assert np.all(np.asarray(freedom) == PARAMS)
    assert 1.5 < float(np.mean(square)) < 5.0


def test_broken_engines_are_found_and_the_rest_is_as_without_them():
    x, y, *_ = draw()
    broken = y.copy()
    broken[4] *= 5.0  # another unit
    broken[9] = 3.0  # a sensor that hangs
    broken[17] = np.roll(y[17], 7)  # channels out of step
    there = np.full(ENGINES, True)

    def screen(y, there):
        every = sums(x, y)

        def of(weight):
            return [(every, np.zeros((ENGINES, PARAMS)), weight)]

        return find_broken(of, there, ["y"], np.ones(1))

    found = screen(broken, there)
    assert set(found.remark) == {4, 9, 17}
    assert set(np.flatnonzero(~found.used)) == {4, 9, 17}
    kept = there.copy()
    kept[[4, 9, 17]] = False
    alone = screen(y, kept)
    for field in dataclasses.fields(Population):
        np.testing.assert_allclose(
            getattr(found.population, field.name),
            getattr(alone.population, field.name),
            rtol=1e-2,
            atol=1e-3,
        )
    assert not screen(y, there).remark


def test_fleet_is_learnt():
    found = learnt()
    prior = found.value
    assert found.is_okay and found.stats["passes"] == 1
    assert not prior.broken() and prior.used.all()
    noise = np.sqrt(float(prior.population.noise[0])) * float(prior.network.gain[-1])
    np.testing.assert_allclose(noise, NOISE, rtol=0.1)
    # two directions vary, as two numbers make the engines
    value = np.linalg.eigvalsh(np.asarray(prior.population.covariance))[::-1]
    assert value[2] < 0.2 * value[1]
    assert len(donors()) == len(prior.donors)
    assert MEAN.shape[0] == ROOT.shape[0] == len(prior.names)


def test_errors_to_be_expected_are_those_of_drawn_engines():
    # A Monte Carlo oracle: engines and noise drawn, calibrated, and judged.
    random = np.random.default_rng(4)
    mean, root = np.array([0.3, -0.2]), np.array([[0.5, 0.0], [0.2, 0.3]])
    x, other = random.normal(size=(6, 2)), random.normal(size=(200, 2))
    noise, left, colour = 0.04, 0.01, 1.0
    given = (mean, root @ root.T, [noise], [colour])
    population = Population(*map(jnp.asarray, given))
    ways = make_rivals(population, np.array([[1.0], [1.0]]), np.zeros(2))
    gram = (x.T @ x)[None]
    typical = (other.T @ other)[None] / len(other)
    found = expect_errors(ways, gram, population, typical, np.array([left]))[:, 0]
    engines = mean + random.normal(size=(4000, 2)) @ root.T
    y = engines @ x.T + random.normal(size=(4000, len(x))) * noise**0.5
    one = Information(
        np.zeros((4000, 1)),
        -(y @ x)[:, None],  # about zero
        np.tile(gram, (4000, 1, 1, 1)),
        np.full((4000, 1), 6.0),
    )
    given = ways.weight, ways.mean, ways.root
    v = estimate_each(one, np.zeros(2), 1 / np.array([noise]), *given)
    apart = v - engines[:, None]
    errors = np.einsum("ewp,pq,ewq->w", apart, typical[0], apart) / len(engines)
    np.testing.assert_allclose(found, errors + left, rtol=0.08)


def test_a_gain_that_samples_do_not_tell_is_expected_to_be_wrong():
    # Two coefficients, of an offset and of an input that rests at 1 or moves.
    given = (np.zeros(2), np.diag([1.0, 0.01]), [0.01], [5.0])
    population = Population(*map(jnp.asarray, given))
    ways = make_rivals(population, np.eye(2), np.array([-1.0, -1.0]))
    moves, rests = (
        np.stack([np.ones(20), u]) for u in (np.linspace(-2, 2, 20), np.full(20, 1.0))
    )
    typical, left = np.eye(2)[None], np.array([0.001])
    found = {}
    for name, x in (("moves", moves), ("rests", rests)):
        errors = expect_errors(ways, (x @ x.T)[None], population, typical, left)[:, 0]
        kinds = np.array(ways.kinds)
        found[name] = {kind: errors[kinds == kind].min() for kind in set(ways.kinds)}
    by_hand = {name: one["offset and gain"] for name, one in found.items()}
    learnt = {name: one["prior"] for name, one in found.items()}
    assert by_hand["moves"] < 2 * learnt["moves"]
    assert by_hand["rests"] > 10 * learnt["rests"]
