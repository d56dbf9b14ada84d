"""Levels, and sums of squares against the textbook and against projections."""

import anova_oracles as oracle
import numpy as np
import pytest
from anova_problems import layout, noise
from scipy.stats import f as f_distribution

from jaxnarx.selection.anova.cells import cut, group_tests, lay_out


def f_tests(codes: np.ndarray, y: np.ndarray, order: int, balance: float = 0.0):
    variables = codes.shape[1]
    shape = tuple(int(n) for n in codes.max(axis=0) + 1)
    return group_tests(
        lay_out(list(codes.T.astype(np.uint8)), shape, balance),
        y,
        tuple(range(variables)),
        oracle.effects(variables, order),
        order=order,
    )


# ----------------------------------------------------------------------------- levels


@pytest.mark.parametrize("levels", (2, 3, 4, 7))
def test_levels_are_equally_frequent(levels):
    code, count = cut(noise(1001), levels)
    sizes = np.bincount(code)
    assert count == levels == len(sizes)
    assert sizes.max() - sizes.min() <= 1


def test_levels_depend_on_the_order_of_values_only():
    x = noise(301)
    np.testing.assert_array_equal(cut(x, 4)[0], cut(np.exp(3 * x), 4)[0])
    # Equal values share a level, whatever that does to the frequencies.
    tied = np.round(x)
    code, _ = cut(tied, 3)
    assert all(len(set(code[tied == value])) == 1 for value in np.unique(tied))


@pytest.mark.parametrize("share", (0.01, 0.2, 0.5, 0.8, 0.99))
def test_a_binary_variable_keeps_both_its_levels(share):
    x = (np.arange(200) < 200 * share).astype(float)
    code, count = cut(x, 3)
    assert count == 2
    np.testing.assert_array_equal(code, x)


def test_a_value_most_samples_share_still_leaves_two_levels():
    x = np.concatenate([np.zeros(700), np.linspace(1, 2, 300)])
    code, count = cut(x, 3)
    assert count == 2
    np.testing.assert_array_equal(code, x > 0)


# -------------------------------------------------------------------- sums of squares


def test_two_way_layout_by_the_textbook():
    (a, b), r = (3, 4), 5
    codes, y = layout((a, b), r)
    cells = y.reshape(a, b, r)
    mean, row, column = cells.mean(-1), cells.mean((1, 2)), cells.mean((0, 2))
    squares = {
        (0,): b * r * np.sum(row**2),
        (1,): a * r * np.sum(column**2),
        (0, 1): r * np.sum((mean - row[:, None] - column[None]) ** 2),
    }
    freedom = {(0,): a - 1, (1,): b - 1, (0, 1): (a - 1) * (b - 1)}
    error = np.sum((cells - mean[..., None]) ** 2)
    spare = a * b * (r - 1)
    found = f_tests(codes, y, 2)
    assert [t.balanced for t in found] == [True] * 3
    for test in found:
        # Rounding of sums over 60 samples.
        np.testing.assert_allclose(test.squares, squares[test.effect], rtol=1e-12)
        assert (test.freedom, test.spare) == (freedom[test.effect], spare)
        f = squares[test.effect] / freedom[test.effect] / (error / spare)
        np.testing.assert_allclose(test.f, f, rtol=1e-12)
        p = f_distribution.sf(f, test.freedom, spare)
        np.testing.assert_allclose(test.p, p, rtol=1e-9)
    parts = sum(t.squares for t in found) + error
    np.testing.assert_allclose(parts, found[0].total, rtol=1e-12)


def test_sums_of_squares_of_a_three_way_layout_add_up():
    codes, y = layout((2, 3, 4), 3)
    found = f_tests(codes, y, 3)
    error, _ = oracle.left(codes, [(0, 1, 2)], y)
    np.testing.assert_allclose(sum(t.squares for t in found) + error, y @ y, rtol=1e-12)
    assert sum(t.freedom for t in found) + found[0].spare + 1 == len(y)


@pytest.mark.parametrize("order", (1, 2, 3))
def test_balanced_tests_equal_projections(order):
    codes, y = layout((3, 2, 4), 4, seed=order)
    for test in f_tests(codes, y, order):
        freedom, spare, squares, f = oracle.f_test(codes, test.effect, y, order)
        assert (test.freedom, test.spare) == (freedom, spare)
        np.testing.assert_allclose([test.squares, test.f], [squares, f], rtol=1e-10)


def test_balanced_and_unbalanced_form_agree_on_equal_cells():
    codes, y = layout((3, 3, 2), 4)
    for a, b in zip(f_tests(codes, y, 2), f_tests(codes, y, 2, 2.0), strict=True):
        assert a.balanced and not b.balanced
        assert (a.freedom, a.spare) == (b.freedom, b.spare)
        np.testing.assert_allclose([a.f, a.squares], [b.f, b.squares], rtol=1e-10)


@pytest.mark.parametrize("empty", ([], [0, 5], [0, 1, 2, 9]))
def test_unequal_and_empty_cells_equal_projections(empty):
    codes, y = layout((3, 4), 6, seed=3)
    rng = np.random.default_rng(1)
    taken = rng.random(len(y)) < 0.6
    taken &= ~np.isin(np.arange(len(y)) // 6, empty)
    codes, y = codes[taken], y[taken] - y[taken].mean()
    for test in f_tests(codes, y, 2, 1.0):
        freedom, spare, squares, f = oracle.f_test(codes, test.effect, y, 2)
        assert (test.freedom, test.spare) == (freedom, spare)
        np.testing.assert_allclose([test.squares, test.f], [squares, f], rtol=1e-9)


def test_single_samples_per_cell_leave_the_model_s_residual_as_error():
    # Two-way without replication: the interaction is the error (Tukey).
    codes, y = layout((4, 5), 1)
    found = f_tests(codes, y, 1)
    without, rank = oracle.left(codes, [(0,), (1,)], y)
    for test in found:
        other = [(1 - test.effect[0],)]
        squares = oracle.left(codes, other, y)[0] - without
        assert test.spare == len(y) - rank == 12
        f = squares / test.freedom / (without / 12)
        np.testing.assert_allclose(test.f, f, rtol=1e-10)
    assert all(t.spare == 0 and t.p == 1.0 for t in f_tests(codes, y, 2))
