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


def plain_recursion(columns, covariance, forgetting):
    """P by (4.41) and (4.42) as they stand, for a batch of problems."""
    batch, terms, _ = columns.shape
    p = np.tile(covariance * np.eye(terms), (batch, 1, 1))
    for x in np.moveaxis(columns, 2, 0):
        g = np.einsum("bij,bj->bi", p, x)
        gain = g / (forgetting + np.einsum("bi,bi->b", x, g))[:, None]
        p = (p - gain[:, :, None] * np.einsum("bi,bij->bj", x, p)[:, None]) / forgetting
    return p


def nearly_collinear(rng, *shape):
    """Columns of different size and a condition of 1e6."""
    common = rng.normal(size=shape)
    second = 1e3 * common + 1e-3 * rng.normal(size=shape)
    return np.stack([common, second, np.ones(shape)], axis=-2)


def test_forgets_what_was_lost_at_a_start_that_knows_nothing():
    rng = np.random.default_rng(2)
    time = 100_000
    columns = nearly_collinear(rng, time)
    y = columns.sum(axis=0) + 1e-3 * rng.normal(size=time)
    start = begin(jnp.zeros(3), 1e16)
    data = map(jnp.asarray, (columns, y, np.ones(time)))
    end, _ = run(start, *data, forgetting=jnp.asarray(0.999))
    root = np.sqrt(0.999 ** np.arange(time - 1, -1, -1.0))
    best = np.linalg.lstsq((columns * root).T, y * root, rcond=None)[0]
    # The condition is 1e6: sqrt(P_0) = 1e8 times eps is lost beside it at first, and
    # forgotten.
    np.testing.assert_allclose(end.coefficient, best, rtol=1e-6)


def test_keeps_digits_that_the_plain_form_loses():
    batch, time = 20, 20
    columns = nearly_collinear(np.random.default_rng(2), batch, time)
    start = begin(jnp.zeros(3), 1e16)
    none, ones, factor = jnp.zeros(time), jnp.ones(time), jnp.asarray(0.999)
    plain = plain_recursion(columns, 1e16, 0.999)
    root = np.sqrt(0.999 ** np.arange(time - 1, -1, -1.0))
    lost = []
    for c, p in zip(columns, plain, strict=True):
        end, _ = run(start, jnp.asarray(c), none, ones, forgetting=factor)
        r = np.linalg.qr((c * root).T)[1]
        own = r @ np.asarray(end.root)
        # R P R' is one where R'R is the information: P is known and definite.
        lost.append([np.abs(a - np.eye(3)).max() for a in (own @ own.T, r @ p @ r.T)])
    # How much is luck of rounding in each, hence the medians (5e-6, and 0.18 to 0.29
    # by the order of summation). The square root has sqrt(P_0) = 1e8, eps and the
    # condition 1e6 against it, 0.02 together.
    ours, theirs = np.median(lost, axis=0)
    assert ours < 0.02 and theirs > 100 * ours


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


def test_a_direction_half_known_by_the_start_has_the_variance_of_the_data():
    columns, y, _ = problem(seed=3)
    columns[1] = columns[2] + 5e-6 * columns[1]
    fit = solve(*map(jnp.asarray, (columns, y, np.ones(TIME))))
    assert fit.rank == TERMS
    weakest = np.linalg.svd(columns.T)[2][-1]
    variance = np.sum((weakest @ np.asarray(fit.root)) ** 2)
    information = np.sum((weakest @ columns) ** 2)
    # condition 3e5, squared, times eps: 2e-5
    np.testing.assert_allclose(variance * information, 1.0, rtol=1e-3)


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
