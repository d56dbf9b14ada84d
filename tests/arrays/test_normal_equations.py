"""Products of columns, and normal equations solved, beside numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.arrays import gram, ridge_solve
from jaxnarx.arrays.normal_equations import PANEL_COLUMNS

in_program = jax.jit(ridge_solve)


def equations(seed=0, terms=4):
    random = np.random.default_rng(seed)
    p = random.normal(size=(terms, 60)) * 10.0 ** np.arange(terms)[:, None]
    return p @ p.T, p @ random.normal(size=60)


@pytest.mark.parametrize(
    "columns", [3, PANEL_COLUMNS - 1, PANEL_COLUMNS, PANEL_COLUMNS + 1]
)
def test_products(columns):
    a = np.random.default_rng(columns).normal(size=(40, columns))
    found = np.asarray(jax.jit(gram)(a))
    np.testing.assert_allclose(found, a.T @ a, atol=1e-12)
    np.testing.assert_allclose(found, found.T, atol=1e-13)


@pytest.mark.parametrize("solve", [in_program, ridge_solve])
def test_what_solves_the_equations(solve):
    a, b = equations()
    # The relative ridge is 1e-12.
    np.testing.assert_allclose(solve(a, b), np.linalg.solve(a, b), rtol=1e-9)
    many = np.stack([b, 2 * b, b[::-1]], axis=1)
    wanted = np.linalg.solve(a, many)
    np.testing.assert_allclose(solve(a, many), wanted, rtol=1e-8)


@pytest.mark.parametrize("solve", [in_program, ridge_solve])
def test_the_ridge_is_a_share_of_the_diagonal(solve):
    a, b = equations(1)
    pull = np.array([0.1, 0.0, 2.0, 0.3])
    wanted = np.linalg.solve(a + np.diag(pull * np.diag(a)), b)
    np.testing.assert_allclose(solve(a, b, pull), wanted, rtol=1e-9)


def test_the_scale_of_the_columns_does_not_matter():
    a, b = equations(2)
    scale = 10.0 ** np.array([-100, 0, 7, 100])
    given = jnp.asarray(a * scale[:, None] * scale), jnp.asarray(b * scale)
    wanted = np.linalg.solve(a, b)
    np.testing.assert_allclose(in_program(*given) * scale, wanted, rtol=1e-9)


@pytest.mark.parametrize("solve", [in_program, ridge_solve])
def test_padding_gives_zero_and_leaves_the_others_alone(solve):
    a, b = equations(3)
    padded_a, padded_b = np.zeros((6, 6)), np.zeros(6)
    padded_a[:4, :4], padded_b[:4] = a, b
    found = np.asarray(solve(padded_a, padded_b))
    np.testing.assert_array_equal(found[4:], 0.0)
    np.testing.assert_allclose(found[:4], solve(a, b), rtol=1e-13)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("padded", [False, True])
def test_singular_equations_stay_finite_and_are_solved(padded, dtype):
    random = np.random.default_rng(3)
    p, y = random.normal(size=(4, 60)).astype(dtype), random.normal(size=60)
    y = y.astype(dtype)
    p[3] = 0.0 if padded else p[1]
    theta = np.asarray(in_program(p @ p.T, p @ y))
    assert np.all(np.isfinite(theta))
    best = np.linalg.lstsq(p.T, y, rcond=None)[0]
    # Rounding along the singular direction is magnified by its small ridge.
    np.testing.assert_allclose(theta @ p, best @ p, atol=1e-3)
