"""QR, SVD and normal equations by one call: ridge, scaling, rank, leverage."""

from fractions import Fraction
from functools import partial

import jax
import numpy as np
import pytest

from jaxnarx.arrays._least_squares import leverage, solve_least_squares
from jaxnarx.arrays.accurate_product import accurate_product, slices
from jaxnarx.arrays.column_scaling import column_scale, power_of_two

TIME, TERMS = 30, 4
WAYS = ("qr", "svd", "normal")
solvers = {w: jax.jit(partial(solve_least_squares, algorithm=w)) for w in WAYS}


def problem(seed: int = 0):
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(TERMS, TIME)) * 10.0 ** np.array([[-6], [0], [3], [8]])
    return columns, rng.normal(size=TIME), rng.uniform(0.2, 3.0, size=TIME)


def fitted(way, columns, y, weight, ridge=0.0):
    fit = solvers[way](columns, y, weight, ridge=ridge)
    return jax.tree.map(np.asarray, fit)


def plain(columns, y, weight, ridge=0.0):
    """By lstsq on rows for the ridge, of unit columns."""
    norm = np.sqrt((columns**2 * weight).sum(axis=1))
    a = (columns * np.sqrt(weight) / norm[:, None]).T
    a = np.concatenate([a, np.sqrt(ridge) * np.eye(len(norm))])
    target = np.concatenate([y * np.sqrt(weight), np.zeros(len(norm))])
    return np.linalg.lstsq(a, target, rcond=None)[0] / norm


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("ridge", [0.0, 0.3])
def test_every_way_equals_lstsq(way, ridge):
    case = problem()
    fit = fitted(way, *case, ridge=ridge)
    # Condition near 1: rounding only, also of the normal equations.
    np.testing.assert_allclose(fit.coefficient, plain(*case, ridge), rtol=1e-11)
    assert fit.rank == TERMS
    columns, _, weight = case
    a = (columns * np.sqrt(weight)).T
    gram = a.T @ a
    inverse = np.linalg.inv(gram + ridge * np.diag(np.diag(gram)))
    np.testing.assert_allclose(fit.root @ fit.root.T, inverse, rtol=1e-9, atol=0)
    hat = jax.jit(leverage)(columns, weight, fit.root)
    np.testing.assert_allclose(hat, np.diag(a @ inverse @ a.T), rtol=1e-9)


@pytest.mark.parametrize("way", WAYS)
def test_zero_columns_and_zero_weights_are_padding(way):
    columns, y, weight = problem(seed=1)
    kept = np.array([0, 1, 3])
    alone = plain(columns[kept], y, weight)
    columns[2] = 0.0
    fit = fitted(way, columns, y, weight)
    assert fit.rank == 3 and fit.condition == np.inf
    assert fit.coefficient[2] == 0.0
    np.testing.assert_allclose(fit.coefficient[kept], alone, rtol=1e-11)
    np.testing.assert_allclose(fit.root[2], 0.0)
    quiet = np.where(np.arange(TIME) < 20, weight, 0.0)
    first = fitted(way, columns, y, quiet)
    columns[:, 20:], y[20:] = 1e9, -1e9
    # Zero times what they hold is zero: nothing rounds differently.
    np.testing.assert_array_equal(
        fitted(way, columns, y, quiet).coefficient, first.coefficient
    )


@pytest.mark.parametrize("way", WAYS)
def test_collinear_columns_have_the_solution_of_minimum_norm(way):
    columns, y, weight = problem(seed=2)
    columns[3] = -3.0 * columns[1]
    fit = fitted(way, columns, y, weight)
    assert fit.rank == TERMS - 1 and fit.condition == np.inf
    # Unit columns share alike, whatever their sizes. The normal equations know the
    # zero eigenvalue to eps, its direction thus to sqrt(eps).
    rtol = 1e-6 if way == "normal" else 1e-10
    np.testing.assert_allclose(fit.coefficient[1], -3.0 * fit.coefficient[3], rtol=rtol)
    best = plain(columns, y, weight)
    np.testing.assert_allclose(fit.coefficient @ columns, best @ columns, atol=1e-6)


def test_a_cut_off_of_ones_own_drops_weak_directions():
    columns, y, weight = problem(seed=3)
    columns[1] = columns[0] * (1.0 + 1e-3 * columns[1])
    # Columns 0 and 1 differ by 1e-3: singular values of the pair near 1.4 and 7e-4.
    quick = jax.jit(partial(solve_least_squares, refinements=0))
    for cutoff, rank in ((1e-5, TERMS), (1e-2, TERMS - 1)):
        assert quick(columns, y, weight, cutoff=cutoff).rank == rank


def test_vmap_is_a_loop():
    cases = [problem(seed=s) for s in (4, 5)]
    stacked = [np.stack(a) for a in zip(*cases, strict=True)]
    batch = np.asarray(jax.jit(jax.vmap(solvers["svd"]))(*stacked).coefficient)
    for n, case in enumerate(cases):
        alone = fitted("svd", *case)
        np.testing.assert_allclose(batch[n], alone.coefficient, rtol=1e-11)


def test_scales():
    rng = np.random.default_rng(6)
    weight = rng.uniform(0.5, 2.0, size=50)
    root = np.sqrt(weight)
    x = np.stack([3.0 + rng.normal(size=50), np.zeros(50), rng.normal(size=50)], axis=1)
    x[:, 2] -= np.average(x[:, 2], weights=weight)
    a, scale = x * root[:, None], jax.jit(column_scale, static_argnums=2)
    mean = np.asarray(scale(a, root, "mean"))
    np.testing.assert_allclose(mean[0], np.average(x[:, 0], weights=weight))
    assert mean[1] == 1.0
    # No mean to divide by: the root mean square.
    rms = np.sqrt(np.average(x[:, 2] ** 2, weights=weight))
    np.testing.assert_allclose(mean[2], rms)
    huge = np.asarray(scale(a * 1e200, root, "norm"))
    np.testing.assert_allclose(huge[0] / 1e200, np.linalg.norm(a[:, 0]))
    power = jax.jit(power_of_two)(np.array([0.3, 1.0, 1000.0]))
    np.testing.assert_array_equal(power, [0.25, 1.0, 1024.0])
    with pytest.raises(ValueError, match="scaling must be"):
        scale(a, root, "max")


def test_refinement_removes_what_a_large_residual_costs():
    # Powers up to 5 on 0 ... 20 and integers all along: the exact solution is ones
    # when the residual is orthogonal to the columns. Made so in exact arithmetic.
    t = np.arange(21)
    columns = np.stack([t**k for k in range(6)]).astype(float)
    # The sixth difference kills polynomials of degree 5.
    difference = np.array([1, -6, 15, -20, 15, -6, 1]) * 10**9
    y = columns.sum(axis=0)
    y[7:14] += difference
    args = columns, y, np.ones(21)
    for way in ("qr", "svd"):
        one = jax.jit(
            partial(solve_least_squares, algorithm=way), static_argnames="refinements"
        )
        fine = np.asarray(one(*args).coefficient)
        rough = np.asarray(one(*args, refinements=0).coefficient)
        assert np.max(np.abs(rough - 1.0)) > 1e-6
        # Condition 2e3 times the rounding of y, 2e10 eps.
        np.testing.assert_allclose(fine, 1.0, rtol=1e-9)


def test_accurate_product_rounds_once():
    rng = np.random.default_rng(7)
    a = rng.normal(size=(3, 40)) * 10.0 ** rng.uniform(-6, 6, size=(3, 40))
    x = rng.normal(size=40)
    # Cancels to nothing that plain products would know.
    start = -(a @ x)
    exact = [
        float(
            Fraction(s)
            + sum(Fraction(p) * Fraction(q) for p, q in zip(r, x, strict=True))
        )
        for s, r in zip(start.tolist(), a.tolist(), strict=True)
    ]
    found = jax.jit(lambda a, x, s: accurate_product(slices(a), x, s))(a, x, start)
    # Counted from the largest entries, as the slices are.
    size = 40 * np.abs(a).max(axis=1) * np.abs(x).max()
    slack = np.finfo(float).eps ** 1.5 * size
    assert np.all(slack < 1e-4 * np.abs(exact))
    assert np.all(np.abs(np.asarray(found) - exact) < slack)
