"""Factorisations on the host, against dense algebra of the same columns."""

import numpy as np
import pytest

from jaxnarx.arrays import factorisation
from jaxnarx.arrays.factorisation import directions, quadratic, triangle


@pytest.fixture
def columns():
    return np.random.default_rng(5).normal(size=(50, 4))


def test_the_triangle_solves_as_the_rows_do_whatever_the_blocks(columns, monkeypatch):
    monkeypatch.setattr(factorisation, "ROWS_AT_ONCE", 7)
    r = triangle(columns.T)
    assert r.shape == (4, 4)
    np.testing.assert_allclose(r.T @ r, columns.T @ columns, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("rows", [50, 5])
def test_directions_are_a_basis_and_solve_least_squares(columns, rows):
    x, y = columns[:rows], np.arange(float(rows))
    found = directions(x)
    u = found.basis
    np.testing.assert_allclose(u.T @ u, np.eye(4), atol=1e-13)
    theta = np.linalg.lstsq(x, y, rcond=None)[0]
    np.testing.assert_allclose(found.inverse @ (u.T @ y), theta, rtol=1e-10)
    exact = np.linalg.inv(x.T @ x)
    np.testing.assert_allclose(found.inverse @ found.inverse.T, exact, rtol=1e-9)
    assert found.rank == 4
    np.testing.assert_allclose(found.condition, np.linalg.cond(x), rtol=1e-10)


def test_a_column_too_many_leaves_the_answer_of_minimum_norm(columns):
    x = np.column_stack([columns[:, :2], columns[:, 0]])
    found = directions(x)
    assert found.rank == 2 and found.condition == np.inf
    np.testing.assert_allclose(
        np.abs(found.weakest), [0.5**0.5, 0, 0.5**0.5], atol=1e-8
    )
    theta = found.inverse @ (found.basis.T @ columns[:, 3])
    exact = np.linalg.pinv(x) @ columns[:, 3]
    np.testing.assert_allclose(theta, exact, rtol=1e-10)


def test_a_cut_off_counts_more_as_rounding(columns):
    x = np.column_stack([columns[:, 0], columns[:, 0] + 1e-6 * columns[:, 1]])
    assert directions(x).rank == 2
    assert directions(x, rounding=1e-4).rank == 1


@pytest.mark.parametrize("shape", [(5, 0), (5, 2)])
def test_without_a_column_or_with_zeros_there_is_no_direction(shape):
    found = directions(np.zeros(shape))
    assert found.rank == 0 and found.inverse.shape == (shape[1], 0)


def test_the_quadratic_form_leaves_directions_without_variance_out(columns):
    half = np.diag([2.0, 1.0, 0.0]) @ np.linalg.qr(columns[:3, :3])[0]
    v = half.T @ half
    x = half.T @ np.array([1.0, 3.0, 0.0])
    value, rank = quadratic(v, x, least=1e-10)
    assert rank == 2
    np.testing.assert_allclose(value, 10.0, rtol=1e-12)
    assert quadratic(np.zeros((2, 2)), np.zeros(2), least=1e-10) == (0.0, 0)
