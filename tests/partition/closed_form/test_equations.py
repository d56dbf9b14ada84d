"""Normal equations by group, against dense least squares with the ridge as rows."""

import dataclasses

import numpy as np
import pytest

from jaxnarx.partition.closed_form.equations import NormalEquations, System

RIDGE = 1e-2
LENGTHS = 30, 45, 25, 40
EXACT = 1e-9
"""Columns are well conditioned: normal equations lose few digits."""


@pytest.fixture(scope="module")
def dense():
    """Columns of very different sizes by group, one of them zero, and a target."""
    rng = np.random.default_rng(3)
    size = np.array([1.0, 1e3, 1e-4, 2.0, 50.0, 1.0, 3.0, 1.0])
    parts = []
    for n in LENGTHS:
        columns = rng.normal(size=(8, n)) + rng.normal(size=(1, n))
        columns[7] = 0.0
        target = columns[0] - 0.5 * columns[3] + 0.3 * rng.normal(size=n)
        parts.append((columns * size[:, None], target))
    return parts


@pytest.fixture(scope="module")
def equations(dense) -> NormalEquations:
    return NormalEquations(
        np.stack([c @ c.T for c, _ in dense]),
        np.stack([c @ e for c, e in dense]),
        np.array([e @ e for _, e in dense]),
        np.array([float(len(e)) for _, e in dense]),
        np.eye(len(dense), dtype=bool),
    )


def together(dense, without: int | None):
    """Columns and target of all groups but one."""
    kept = [part for g, part in enumerate(dense) if g != without]
    return np.concatenate([c for c, _ in kept], axis=1), np.concatenate(
        [e for _, e in kept]
    )


def ridged(columns, target, ridge: float):
    """Least squares with sqrt(ridge) as further rows, columns of unit mean square;
    coefficients of the columns as they are, and the sum of squares."""
    count = len(target)
    size = np.sqrt(np.mean(columns**2, axis=1))
    size[size == 0] = 1.0
    rows = (columns / size[:, None]).T / np.sqrt(count)
    rows = np.concatenate([rows, np.sqrt(ridge) * np.eye(len(columns))])
    right = np.concatenate([target / np.sqrt(count), np.zeros(len(columns))])
    found = np.linalg.lstsq(rows, right)[0]
    return found / size, float(np.sum((right - rows @ found) ** 2))


@pytest.mark.parametrize("without", [None, 0, 3])
@pytest.mark.parametrize("ridge", [1e-6, RIDGE, 10.0])
def test_solution_is_that_of_ridge_regression(dense, equations, without, ridge):
    columns, target = together(dense, without)
    expected, _ = ridged(columns, target, ridge)
    found = equations.exclude_group(without).solve(ridge)
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=1)), 1e-300)
    np.testing.assert_allclose(found * size, expected * size, atol=EXACT)
    assert found[7] == 0.0


def test_a_gap_trains_unless_a_group_beside_it_is_left_out(dense, equations):
    """Two groups, then a gap beside the first and one that is beside neither."""
    apart = np.array([[True, False, True, False], [False, True, False, False]])
    found = dataclasses.replace(equations, apart=apart)
    assert found.judged.tolist() == list(LENGTHS[:2])
    for g, trains in ((None, (0, 1, 2, 3)), (0, (1, 3)), (1, (0, 2, 3))):
        columns, target = together([dense[n] for n in trains], None)
        expected, _ = ridged(columns, target, RIDGE)
        theta = found.exclude_group(g).solve(RIDGE)
        np.testing.assert_allclose(theta, expected, rtol=1e-7, atol=1e-12)


def test_loss_is_the_sum_of_squares_of_a_group(dense, equations):
    rng = np.random.default_rng(1)
    theta = rng.normal(size=8) / np.sqrt(np.mean(dense[0][0] ** 2, axis=1) + 1e-9)
    for g, (columns, target) in enumerate(dense):
        expected = np.sum((target - theta @ columns) ** 2)
        np.testing.assert_allclose(equations.loss(g, theta), expected, rtol=EXACT)
    # Where rounding would make it negative it is zero.
    exact = dataclasses.replace(equations, square=0 * equations.square)
    assert exact.loss(0, equations.exclude_group(None).solve(RIDGE)) == 0.0


def test_sums_of_chosen_columns_are_those_of_their_own_equations(dense, equations):
    at = np.array([5, 1, 2])
    few = equations.select(at)
    assert len(few) == len(LENGTHS) and few.columns == 3
    for g, (columns, target) in enumerate(dense):
        own = columns[at]
        np.testing.assert_allclose(few.gram[g], own @ own.T, rtol=EXACT)
        np.testing.assert_allclose(few.right[g], own @ target, rtol=EXACT)


def slow_forward(columns, target, ridge: float, steps: int, first=()):
    """Columns by trying each: the smallest penalised sum of squares is kept."""
    order: list[int] = []
    for step in range(steps):
        left = [j for j in range(len(columns)) if j not in order]
        left = [j for j in left if np.any(columns[j])]
        if step < len(first):
            left = [first[step]]
        losses = [ridged(columns[[*order, j]], target, ridge)[1] for j in left]
        order.append(left[int(np.argmin(losses))])
    return order


@pytest.mark.parametrize("first", [(), (4,), (6, 2)])
@pytest.mark.parametrize("without", [None, 1])
def test_forward_is_the_largest_decrease_at_each_step(dense, equations, first, without):
    columns, target = together(dense, without)
    path = equations.exclude_group(without).select_forward(RIDGE, 7, first)
    assert path.order.tolist() == slow_forward(columns, target, RIDGE, 7, first)


@pytest.mark.parametrize("ridge", [1e-8, RIDGE, 1.0])
def test_coefficients_on_a_path_are_those_of_ridge_regression(dense, equations, ridge):
    columns, target = together(dense, 2)
    path = equations.exclude_group(2).select_forward(ridge, 7, (4,))
    for size in (1, 3, 7):
        at, theta = path.truncate(size)
        assert at.tolist() == path.order[:size].tolist()
        expected, _ = ridged(columns[at], target, ridge)
        power = np.sqrt(np.mean(columns[at] ** 2, axis=1))
        np.testing.assert_allclose(theta * power, expected * power, atol=EXACT)


def test_all_columns_of_a_path_are_the_whole_solution(equations):
    system = equations.exclude_group(None)
    at, theta = system.select_forward(RIDGE, 100, ()).truncate(100)
    assert sorted(at.tolist()) == list(range(7))
    np.testing.assert_allclose(theta, system.solve(RIDGE)[at], rtol=1e-7)


def test_columns_that_others_make_up_are_passed_over():
    rng = np.random.default_rng(5)
    columns = rng.normal(size=(3, 60))
    columns = np.concatenate([columns, columns[:1] + columns[1:2], 0 * columns[:1]])
    target = columns[0] + 2 * columns[1] + 0.1 * columns[2]
    equations = NormalEquations(
        (columns @ columns.T)[None],
        (columns @ target)[None],
        np.array([target @ target]),
        np.array([60.0]),
        np.eye(1, dtype=bool),
    )
    path = equations.exclude_group(None).select_forward(0.0, 5, ())
    assert len(path.order) == 3 and path.order[-1] != 4
    at, theta = path.truncate(5)
    np.testing.assert_allclose(theta @ columns[at], target, atol=1e-7)
    # A first column without power leaves its place to others.
    assert equations.exclude_group(None).select_forward(0.0, 3, (4,)).order[0] != 4


def test_order_of_columns_does_not_matter(equations):
    order = np.random.default_rng(2).permutation(8)
    plain = equations.exclude_group(None).select_forward(RIDGE, 7, ())
    moved = equations.select(order).exclude_group(None).select_forward(RIDGE, 7, ())
    assert order[moved.order].tolist() == plain.order.tolist()


def test_without_columns_or_samples_there_is_nothing_to_choose():
    nothing = System(np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    at, theta = nothing.select_forward(RIDGE, 3, (0,)).truncate(3)
    assert not len(at) and not len(theta)
    empty = NormalEquations(
        *(np.zeros((2, 1, 1)), np.zeros((2, 1)), np.zeros(2), np.zeros(2)),
        np.eye(2, dtype=bool),
    )
    assert empty.exclude_group(0).solve(RIDGE).tolist() == [0.0]
