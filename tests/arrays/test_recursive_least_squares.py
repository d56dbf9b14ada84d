"""The recursion equals the batch problem it claims to solve, and stays definite."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.arrays.recursive_least_squares import (
    begin,
    recursive_least_squares,
    solve_recursively,
)

TIME, TERMS = 60, 4
solve = jax.jit(solve_recursively)
run = jax.jit(recursive_least_squares, static_argnames="history")


def problem(seed: int = 0):
    rng = np.random.default_rng(seed)
    columns, y = rng.normal(size=(TERMS, TIME)), rng.normal(size=TIME)
    return columns, y, rng.uniform(0.2, 3.0, size=TIME)


def batch(columns, y, weight, forgetting, theta, covariance):
    """(X'WX + lambda^N/P0)^-1 (X'Wy + lambda^N/P0 theta0), and that inverse."""
    time = len(y)
    total = weight * forgetting ** np.arange(time - 1, -1, -1)
    prior = forgetting**time / covariance
    inverse = np.linalg.inv((columns * total) @ columns.T + prior * np.eye(TERMS))
    return inverse @ ((columns * total) @ y + prior * theta), inverse


@pytest.mark.parametrize("forgetting", [1.0, 0.9])
def test_equals_the_weighted_batch_with_its_prior(forgetting):
    columns, y, weight = problem()
    theta0, covariance = np.arange(TERMS) / 3.0, 2.5
    start = begin(jnp.asarray(theta0), covariance)
    data = [jnp.asarray(a) for a in (columns, y, weight)]
    factor = jnp.asarray(forgetting)
    end, seen = run(start, *data, forgetting=factor, history=True)
    for n in (1, 7, TIME):
        part = columns[:, :n], y[:n], weight[:n]
        theta, inverse = batch(*part, forgetting, theta0, covariance)
        # Rounding: the problem is well conditioned.
        np.testing.assert_allclose(seen.coefficient[n - 1], theta, rtol=1e-11)
        if n < TIME:
            expected = y[n] - theta @ columns[:, n]
            np.testing.assert_allclose(seen.error[n], expected, rtol=1e-10)
        else:
            np.testing.assert_allclose(end.covariance, inverse, rtol=1e-11)
            np.testing.assert_allclose(end.trace, np.trace(inverse), rtol=1e-11)


def test_samples_without_weight_change_nothing():
    columns, y, weight = problem(seed=1)
    keep = np.arange(TIME) % 3 > 0
    start = begin(jnp.zeros(TERMS), 10.0)
    factor = jnp.asarray(0.95)
    columns[:, ~keep] = 1e6
    masked, _ = run(
        start, *map(jnp.asarray, (columns, y, weight * keep)), forgetting=factor
    )
    # Nothing is forgotten at them either.
    rest = np.zeros(TIME - keep.sum())
    data = [np.append(a[..., keep], 0 * a[..., ~keep], axis=-1) for a in (columns, y)]
    data.append(np.append(weight[keep], rest))
    alone, _ = run(start, *map(jnp.asarray, data), forgetting=factor)
    np.testing.assert_allclose(masked.packed, alone.packed, rtol=1e-11, atol=1e-13)


def assert_inverse(root, gram, rtol):
    """root root' times the Gram matrix is one, in units of the columns' norms."""
    unit = np.sqrt(np.diag(gram))
    product = (np.asarray(root) @ np.asarray(root).T @ gram) * unit[:, None] / unit
    np.testing.assert_allclose(product, np.eye(len(unit)), atol=rtol)


def plain_recursion(columns, y, covariance, forgetting):
    """(4.40) to (4.42) as they stand, with P itself."""
    p, theta = covariance * np.eye(len(columns)), np.zeros(len(columns))
    for x, y_n in zip(columns.T, y, strict=True):
        g = p @ x
        gain = g / (forgetting + x @ g)
        theta = theta + gain * (y_n - x @ theta)
        p = (p - np.outer(gain, x) @ p) / forgetting
    return p, theta


def test_stays_definite_where_the_plain_form_does_not():
    rng = np.random.default_rng(2)
    # Nearly collinear columns of different size, known to nothing at the start.
    time = 100_000
    common = rng.normal(size=time)
    columns = np.stack(
        [common, 1e3 * common + 1e-3 * rng.normal(size=time), np.ones(time)]
    )
    y = columns.sum(axis=0) + 1e-3 * rng.normal(size=time)
    start = begin(jnp.zeros(3), 1e16)
    ones = jnp.ones(time)
    factor = jnp.asarray(0.999)
    end, _ = run(start, jnp.asarray(columns), jnp.asarray(y), ones, forgetting=factor)
    values = np.linalg.eigvalsh(np.asarray(end.covariance))
    assert values.min() > 0
    total = 0.999 ** np.arange(time - 1, -1, -1.0)
    root = np.sqrt(total)
    best = np.linalg.lstsq((columns * root).T, y * root, rcond=None)[0]
    # The condition is 1e6: sqrt(P_0) = 1e8 times eps is lost beside it at first, and
    # forgotten.
    np.testing.assert_allclose(end.coefficient, best, rtol=1e-6)
    p, _ = plain_recursion(columns[:, :1000], y[:1000], 1e16, 0.999)
    assert np.linalg.eigvalsh((p + p.T) / 2).min() < 0


def test_the_start_is_taken_out_of_a_regression():
    columns, y, weight = problem(seed=3)
    columns = columns * 10.0 ** np.array([[-4], [0], [2], [6]])
    columns[1] += 1e-3 * columns[2]
    fit = solve(*map(jnp.asarray, (columns, y, weight)))
    root = np.sqrt(weight)
    best = np.linalg.lstsq((columns * root).T, y * root, rcond=None)[0]
    np.testing.assert_allclose(fit.coefficient, best, rtol=1e-8)
    gram = (columns * weight) @ columns.T
    assert_inverse(fit.root, gram, 1e-6)
    unit = (columns * root).T
    unit /= np.linalg.norm(unit, axis=0)
    np.testing.assert_allclose(fit.condition, np.linalg.cond(unit), rtol=1e-6)
    assert fit.rank == TERMS


def test_a_regression_says_what_it_cannot_tell():
    columns, y, weight = problem(seed=4)
    columns[2] = 0.0
    columns[3] = 2.0 * columns[0]
    fit = solve(*map(jnp.asarray, (columns, y, weight)))
    assert fit.rank == 2 and fit.condition == np.inf
    assert fit.coefficient[2] == 0.0
    best = np.linalg.lstsq((columns * np.sqrt(weight)).T, y * np.sqrt(weight))[0]
    np.testing.assert_allclose(fit.coefficient @ columns, best @ columns, atol=1e-4)


def test_a_ridge_is_the_start():
    columns, y, weight = problem(seed=5)
    columns *= 10.0 ** np.array([[-4], [0], [2], [6]])
    fit = solve(*map(jnp.asarray, (columns, y, weight)), ridge=jnp.asarray(0.2))
    gram = (columns * weight) @ columns.T
    gram += 0.2 * np.diag(np.diag(gram))
    expected = np.linalg.solve(gram, (columns * weight) @ y)
    np.testing.assert_allclose(fit.coefficient, expected, rtol=1e-9)
    assert_inverse(fit.root, gram, 1e-11)
