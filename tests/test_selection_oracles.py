"""The oracles of term selection against closed forms, identities and brute force."""

from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from selection_oracles import (
    adjusted_r2,
    backward,
    backward_exchange,
    cp,
    exchange,
    fpe,
    information,
    least_squares,
    overall_f,
    partial_f,
    press_by_leave_one_out,
    standard_errors,
    stepwise_f,
    total_squares,
)

# Only rounding separates the two sides; F values divide differences of sums of squares.
ROUNDING = 1e-9

TIME, TERMS = 40, 6
MODEL = [0, 3, 1, 5]
Problem = tuple[np.ndarray, np.ndarray]


@pytest.fixture
def problem():
    """Six columns, the first constant, and an output of three of them."""
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((TIME, TERMS))
    columns[:, 0] = 1.0
    columns[:, 4] = 0.9 * columns[:, 1] + 0.3 * columns[:, 4]
    y = 2.0 + columns[:, 1] - 0.5 * columns[:, 3] + rng.standard_normal(TIME)
    return columns, y


@pytest.fixture(params=["equal", "weighted"])
def weights(request):
    if request.param == "equal":
        return None
    w = np.random.default_rng(4).uniform(0.2, 3.0, TIME)
    w[5:9] = 0.0
    return w


def waves(*frequencies: int, time: int = 64) -> np.ndarray:
    """Cosines of whole periods: orthogonal, mean zero, squared norm time / 2."""
    t = 2 * np.pi * np.arange(time) / time
    return np.column_stack([np.cos(f * t) for f in frequencies])


# ------------------------------------------------------------------------- one model


def test_partial_f_is_the_squared_t_value(problem: Problem, weights):
    theta = least_squares(*problem, MODEL, weights).theta
    t = theta / standard_errors(*problem, MODEL, weights)
    assert_allclose(partial_f(*problem, MODEL, weights), t**2, rtol=ROUNDING)


def test_partial_f_is_the_nested_comparison_of_the_thesis(problem: Problem):
    columns, y = problem

    def regression(terms):  # (5.11): theta' X' y - N mean^2
        x = columns[:, terms]
        return np.linalg.solve(x.T @ x, x.T @ y) @ x.T @ y - TIME * y.mean() ** 2

    total = y @ y - TIME * y.mean() ** 2
    variance = (total - regression(MODEL)) / (TIME - len(MODEL))
    rest = [[j for j in MODEL if j != term] for term in MODEL]
    expected = [(regression(MODEL) - regression(r)) / variance for r in rest]
    assert_allclose(partial_f(columns, y, MODEL), expected, rtol=ROUNDING)


def test_overall_f_is_the_partial_f_of_a_single_term(problem: Problem, weights):
    single = partial_f(*problem, [0, 3], weights)[1]
    assert_allclose(overall_f(*problem, [0, 3], weights), single, rtol=ROUNDING)


def test_f_of_one_term_follows_from_its_correlation(problem: Problem):
    columns, y = problem
    r = np.corrcoef(columns[:, 3], y)[0, 1]
    expected = r**2 * (TIME - 2) / (1 - r**2)
    assert_allclose(partial_f(columns, y, [0, 3])[1], expected, rtol=ROUNDING)


def test_whole_weights_repeat_samples_and_zeros_leave_them_out(problem: Problem):
    columns, y = problem
    w = np.arange(TIME) % 4
    fit = least_squares(columns, y, MODEL, w)
    repeated = least_squares(columns.repeat(w, 0), y.repeat(w), MODEL)
    assert_allclose(fit.theta, repeated.theta, rtol=ROUNDING)
    assert_allclose(fit.sse, repeated.sse, rtol=ROUNDING)
    assert fit.samples == np.count_nonzero(w)
    y = np.where(w == 0, np.nan, y)
    assert_allclose(least_squares(columns, y, MODEL, w).sse, fit.sse, rtol=0)


def test_the_scale_of_weights_and_columns_does_not_change_f(problem: Problem):
    columns, y = problem
    w = np.linspace(1, 2, TIME)
    expected = partial_f(columns, y, MODEL, w)
    scaled = partial_f(columns * np.arange(1, TERMS + 1), -3 * y, MODEL, 7 * w)
    assert_allclose(scaled, expected, rtol=ROUNDING)


# -------------------------------------------------------------------------- criteria


def test_press_is_the_leverage_formula(problem: Problem, weights):
    columns, y = problem
    w = np.ones(TIME) if weights is None else weights
    x = columns[:, MODEL]
    h = w * np.sum(x * np.linalg.solve((x.T * w) @ x, x.T).T, axis=1)
    error = y - x @ least_squares(columns, y, MODEL, weights).theta
    expected = np.sum(w * (error / (1 - h)) ** 2)
    found = press_by_leave_one_out(columns, y, MODEL, weights)
    assert_allclose(found, expected, rtol=ROUNDING)


def test_cp_of_the_largest_model_is_its_size(problem: Problem, weights):
    full = list(range(TERMS))
    assert_allclose(cp(*problem, full, full, weights), TERMS, rtol=ROUNDING)


def test_cp_falls_by_removal_of_terms_with_f_below_two(problem: Problem):
    # SSE / sigma^2 rises by the partial F of the one removed, 2 n falls by two.
    full = list(range(TERMS))
    for term, value in enumerate(partial_f(*problem, full)):
        rest = [j for j in full if j != term]
        assert_allclose(cp(*problem, rest, full), TERMS + value - 2, rtol=ROUNDING)


def test_fpe_meets_aic_as_its_series_says(problem: Problem, weights):
    # N ln((N + n) / (N - n)) = 2 n + 2 n^3 / (3 N^2) + 2 n^5 / (5 N^4) + ...
    n, total = len(MODEL), least_squares(*problem, MODEL, weights).samples
    gap = fpe(*problem, MODEL, weights) - information(*problem, MODEL, weights).aic
    first = 2 * n**3 / (3 * total**2)
    assert first < gap < first * (1 + (n / total) ** 2)


def test_aicc_and_bic_differ_from_aic_by_their_penalties(problem: Problem):
    found, n = information(*problem, MODEL), len(MODEL)
    assert_allclose(found.bic - found.aic, n * (np.log(TIME) - 2), rtol=ROUNDING)
    assert_allclose(found.aicc - found.aic, 2 * n * (n + 1) / (TIME - n - 1))
    # The likelihood is the same one: SSE scaled by c^2 moves all three by 2 N ln c.
    columns, y = problem
    moved = np.subtract(information(columns, 3 * y, MODEL), found)
    assert_allclose(moved, 2 * TIME * np.log(3), rtol=ROUNDING)


def test_adjusted_r2_falls_by_terms_with_f_below_one(problem: Problem, weights):
    values = partial_f(*problem, MODEL, weights)
    whole = adjusted_r2(*problem, MODEL, weights)
    for term, value in zip(MODEL[1:], values[1:], strict=True):
        rest = [j for j in MODEL if j != term]
        assert (adjusted_r2(*problem, rest, weights) > whole) == (value < 1)


def test_adjusted_r2_of_the_constant_alone_is_zero(problem: Problem, weights):
    assert adjusted_r2(*problem, [0], weights) == pytest.approx(0, abs=ROUNDING)
    sse = least_squares(*problem, [0], weights).sse
    assert_allclose(total_squares(problem[1], weights), sse, rtol=ROUNDING)


# ---------------------------------------------------------------------------- search


def neighbour() -> tuple[np.ndarray, np.ndarray]:
    """y = 1.1 a + b + small; c = a + b + d/2 is more like y than a or b is."""
    a, b, d, e = waves(1, 2, 3, 4).T
    columns = np.column_stack([np.ones(len(a)), a, b, a + b + 0.5 * d])
    return columns, 5 + 1.1 * a + b + 0.01 * e


def test_a_first_chosen_neighbour_is_removed_after_the_true_terms():
    columns, y = neighbour()
    found = stepwise_f(columns, y, 4.0, 4.0, 10)
    # Squared correlations: c 0.89, a 0.55, b 0.45; given c, a explains more than b.
    assert [row.terms for row in found.history] == [[3], [3, 1], [1, 2]]
    assert found.terms == [0, 1, 2] and found.removed == [3]
    # Orthogonal columns: F = |a|^2 / s^2 = (N/2) / ((1e-4 N/2) / (N - 3)).
    assert_allclose(found.history[-1].partial_f, [1.21 * 61e4, 61e4], rtol=ROUNDING)


def test_without_removal_the_neighbour_stays():
    columns, y = neighbour()
    found = stepwise_f(columns, y, 4.0, 0.0, 10)
    assert found.terms == [0, 3, 1, 2] and found.removed == []


def test_history_has_the_shape_of_table_5_2(problem: Problem):
    columns, y = problem
    found = stepwise_f(columns, y, 0.0, 0.0, TERMS)
    order = found.terms[1:]
    assert [row.terms for row in found.history] == [order[:i] for i in range(1, TERMS)]
    for row in found.history:
        expected = partial_f(columns, y, [0, *row.terms])[1:]
        assert_allclose(row.partial_f, expected, rtol=0)
    assert stepwise_f(columns, y, 0.0, 0.0, 3).terms == [0, *order[:2]]


def test_entry_level_ends_the_search(problem: Problem):
    columns, y = problem
    path = stepwise_f(columns, y, 0.0, 0.0, TERMS).history
    entry = [row.partial_f[-1] for row in path]
    size = next(i for i, value in enumerate(entry) if value <= 4.0)
    found = stepwise_f(columns, y, 4.0, 0.0, TERMS)
    assert 0 < size < TERMS - 1 and len(found.history) == size
    # The level must be passed, not met.
    assert not stepwise_f(columns, y, entry[0], 0.0, TERMS).history


def test_a_term_that_was_removed_does_not_come_back():
    # With F_out above F_in a term that enters goes at once; the next one is tried.
    columns, y = waves(1, 2, 3), 5 + waves(1, 2, 5) @ [1.0, 0.5, 1.0]
    columns = np.column_stack([np.ones(64), columns])
    found = stepwise_f(columns, y, 0.5, 1e6, 10)
    assert found.terms == [0] and found.removed == [1, 2]


def test_stages_take_their_counts_from_their_degree(problem: Problem):
    columns, y = problem
    degrees = [0, 1, 2, 2, 1, 1]
    found = stepwise_f(columns, y, 0.0, 0.0, 10, stages=(1, 2), degrees=degrees)
    assert [degrees[j] for j in found.terms] == [0, 1, 2, 2]
    linear = max((1, 4, 5), key=lambda j: partial_f(columns, y, [0, j])[1])
    assert found.terms[1] == linear


def test_a_stage_that_fails_gives_way_to_the_next():
    columns = np.column_stack([np.ones(64), waves(1, 2)])
    y = 5 + waves(2)[:, 0] + 0.1 * waves(7)[:, 0]
    found = stepwise_f(columns, y, 4.0, 4.0, 10, stages=(2, 2), degrees=[0, 1, 2])
    assert found.terms == [0, 2]
    assert stepwise_f(columns, y, 4.0, 4.0, 10, stages=(2,), degrees=[0, 1, 2]).terms


def test_a_late_stage_may_remove_a_term_of_an_early_one():
    columns, y = neighbour()
    degrees = [0, 2, 2, 1]
    found = stepwise_f(columns, y, 4.0, 4.0, 10, stages=(1, 2), degrees=degrees)
    assert found.terms == [0, 1, 2] and found.removed == [3]


def test_forced_and_forbidden_terms():
    columns, y = neighbour()
    found = stepwise_f(columns, y, 4.0, 4.0, 10, forced=[3])
    assert found.terms == [0, 3, 1, 2] and found.removed == []
    assert [row.terms for row in found.history] == [[1], [1, 2]]
    assert stepwise_f(columns, y, 4.0, 4.0, 10, forbidden={3}).terms == [0, 1, 2]


def test_duplicates_and_exact_fits_end_the_search():
    columns, y = neighbour()
    columns = np.column_stack([columns[:, :3], columns[:, 1], np.zeros(len(y))])
    exact = 5 + columns[:, 1] - columns[:, 2]
    assert stepwise_f(columns, exact, 0.0, 0.0, 10).terms in ([0, 1, 2], [0, 2, 1])
    assert len(stepwise_f(columns, y, 0.0, 0.0, 10).terms) == 3


def test_zero_weights_are_samples_left_out(problem: Problem):
    columns, y = problem
    w = (np.arange(TIME) >= 10).astype(float)
    found = stepwise_f(columns, y, 1.0, 1.0, 10, weights=w)
    short = stepwise_f(columns[10:], y[10:], 1.0, 1.0, 10)
    assert found.terms == short.terms
    last, other = found.history[-1].partial_f, short.history[-1].partial_f
    assert_allclose(last, other, rtol=ROUNDING)


def test_backward_ends_with_all_f_above_the_level(problem: Problem, weights):
    found = backward(*problem, list(range(TERMS)), 4.0, weights=weights)
    assert found.removed and sorted(found.terms + found.removed) == list(range(TERMS))
    assert min(found.history[-1].partial_f) >= 4.0
    for row, gone in zip(found.history, found.removed, strict=False):
        assert row.terms[int(np.argmin(row.partial_f))] == gone


def test_backward_never_removes_what_is_kept(problem: Problem):
    columns, y = problem
    assert backward(columns, y, MODEL, np.inf).terms == [0]
    assert backward(columns, y, MODEL, np.inf, kept=(0, 5)).terms == [0, 5]
    # A constant that explains nothing stays as well.
    found = backward(columns, y - y.mean(), [0, 1], 0.0)
    assert found.terms == [0, 1]


def test_exchange_undoes_a_neighbour():
    columns, y = neighbour()
    assert sorted(exchange(columns, y, [0, 3, 1])) == [0, 1, 2]
    assert sorted(exchange(columns, y, [0, 3, 1], kept=(0, 3))) == [0, 1, 3]
    assert sorted(exchange(columns, y, [0, 3, 1], forbidden={2})) == [0, 1, 3]


def test_exchange_leaves_no_swap_that_helps(problem: Problem, weights):
    start = [0, 2, 5]
    found = exchange(*problem, start, weights=weights)
    lowest = least_squares(*problem, found, weights).sse
    assert lowest < least_squares(*problem, start, weights).sse
    for pair in combinations(range(1, TERMS), 2):
        if len({*pair} & {*found}) == 1:
            assert least_squares(*problem, [0, *pair], weights).sse >= lowest


def test_exchange_is_the_best_subset_for_orthogonal_columns():
    columns = np.column_stack([np.ones(64), waves(1, 2, 3, 4)])
    y = columns @ [1.0, 0.1, 2.0, 0.3, 1.0]
    assert sorted(exchange(columns, y, [0, 1, 3])) == [0, 2, 4]


def test_exchange_may_make_a_term_removable():
    # Without b, c = a + b + d/2 needs d, here with an error of its own; once b has come
    # in for one of the two, the other explains nothing.
    columns, y = neighbour()
    columns = np.column_stack([columns, waves(3, 9) @ [1.0, 0.5]])
    start = [0, 3, 1, 4]
    assert len(backward(columns, y, start, 4.0).terms) == 4
    assert sorted(backward_exchange(columns, y, start, 4.0)) == [0, 1, 2]


def test_backward_and_exchange_end_where_neither_helps(problem: Problem, weights):
    found = backward_exchange(*problem, list(range(TERMS)), 4.0, weights=weights)
    assert backward(*problem, found, 4.0, weights=weights).terms == found
    assert exchange(*problem, found, weights=weights) == found
