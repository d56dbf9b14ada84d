"""The oracles against closed forms, brute force and published figures."""

import math
from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles import (
    Network,
    OutputModel,
    central_difference,
    forward_ols_dense,
    free_run,
    full_pool,
    k_step,
    lagged,
    lolimot,
    normal_equations,
    run_from,
    term_matrix,
    validity,
)

# Only rounding separates the two sides.
ROUNDING = 1e-12

# Published training NRMSE (DESIGN section 9), printed to six decimals.
GOLDEN_1D = [0.602127, 0.390072, 0.198680, 0.198358]
GOLDEN_2D = [
    *[0.544439, 0.365469, 0.215300, 0.142034, 0.110022, 0.090782, 0.072288],
    *[0.062162, 0.048693, 0.046219, 0.040753, 0.033456, 0.032087, 0.029373],
    *[0.027575, 0.025671, 0.024634, 0.023574, 0.021947, 0.020655, 0.018866],
    *[0.018058, 0.016542, 0.014898, 0.013875, 0.013625],
]


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


# ------------------------------------------------------------------- lags and terms


def test_lagged_shifts_and_zero_fills():
    signals = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]])
    x, usable = lagged(signals, [(0, 0), (1, 1), (0, 2)])
    assert_array_equal(x, [[1, 0, 0], [2, 10, 0], [3, 20, 1]])
    assert_array_equal(usable, [False, False, True])


def test_lagged_longer_than_record_is_all_zero():
    x, usable = lagged(np.ones((3, 1)), [(0, 5)])
    assert_array_equal(x, np.zeros((3, 1)))
    assert not usable.any()


def test_lagged_empty_table():
    x, usable = lagged(np.ones((3, 1)), [])
    assert x.shape == (3, 0)
    assert usable.all()


def test_terms_are_products_and_zero_is_one():
    x = np.array([[2.0, 3.0], [5.0, 7.0]])
    factor = np.array([[0, 0, 0], [0, 0, 1], [0, 1, 2], [2, 2, 2]])
    assert_array_equal(term_matrix(x, factor), [[1, 2, 6, 27], [1, 5, 35, 343]])


def test_pool_of_two_variables():
    expected = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]]
    assert_array_equal(full_pool(2, 2), expected)


@pytest.mark.parametrize(("variables", "degree"), [(1, 1), (3, 2), (4, 3), (2, 4)])
def test_pool_counts_sorts_and_never_repeats(variables, degree):
    rows = [tuple(row) for row in full_pool(variables, degree)]
    assert len(rows) == math.comb(variables + degree, degree)
    assert rows == sorted(set(rows))
    assert all(list(row) == sorted(row) for row in rows)
    assert rows[0] == (0,) * degree


def test_pool_sums_to_the_power():
    # (1 + x_1 + x_2)^3 = sum over ordered rows; sorted rows with multiplicities.
    pool = full_pool(2, 3)
    counts = [
        math.factorial(3) / math.prod(math.factorial(list(r).count(i)) for i in r_set)
        for r, r_set in ((row, set(row)) for row in pool)
    ]
    x = noise(4, 2)
    power = (1 + x.sum(axis=1)) ** 3
    assert_allclose(term_matrix(x, pool) @ counts, power, rtol=ROUNDING)


# ------------------------------------------------------------------- term selection


def sse(p: np.ndarray, y: np.ndarray) -> float:
    theta = np.linalg.lstsq(p, y, rcond=None)[0]
    return float(np.sum((y - p @ theta) ** 2))


def test_orthogonal_columns_are_taken_by_size():
    p = np.eye(4) * np.array([1.0, 5.0, 2.0, 1.0])
    y = np.array([3.0, 1.0, 2.0, 0.0])
    out = forward_ols_dense(p, y, 3)
    assert_array_equal(out.indices, [0, 2, 1])
    assert_allclose(out.err, np.array([9, 4, 1]) / 14, rtol=ROUNDING)
    assert_allclose(out.coefficients, [3, 1, 0.2], rtol=ROUNDING)
    assert_allclose(out.gaps, np.array([5, 3, 1]) / 14, rtol=ROUNDING)


@pytest.mark.parametrize("weighted", [False, True])
def test_forward_ols_equals_greedy_least_squares(weighted):
    p, y = noise(40, 9), noise(40, seed=1) + 3
    p = p + 0.7 * p[:, [0]]
    w = noise(40, seed=2) ** 2 if weighted else None
    out = forward_ols_dense(p, y, 5, weights=w)
    root = np.ones(40) if w is None else np.sqrt(w)
    pw, yw = p * root[:, None], y * root
    chosen: list[int] = []
    for step in range(5):
        rest = [j for j in range(9) if j not in chosen]
        errors = sorted((sse(pw[:, [*chosen, j]], yw), j) for j in rest)
        gap = (errors[1][0] - errors[0][0]) / (yw @ yw)
        assert_allclose(out.gaps[step], gap, atol=ROUNDING)
        chosen.append(errors[0][1])
        left = 1 - errors[0][0] / (yw @ yw)
        assert_allclose(out.err[: step + 1].sum(), left, rtol=ROUNDING)
    assert_array_equal(out.indices, chosen)
    assert_allclose(
        out.coefficients,
        np.linalg.lstsq(pw[:, chosen], yw, rcond=None)[0],
        rtol=ROUNDING,
    )


def test_whole_number_weights_repeat_rows():
    p, y = noise(12, 5), noise(12, seed=1)
    count = np.arange(12) % 3
    weighted = forward_ols_dense(p, y, 3, weights=count.astype(float))
    repeated = forward_ols_dense(np.repeat(p, count, axis=0), np.repeat(y, count), 3)
    assert_array_equal(weighted.indices, repeated.indices)
    assert_allclose(weighted.err, repeated.err, rtol=ROUNDING)


def test_rows_of_weight_zero_may_hold_anything():
    p, y = noise(12, 5), noise(12, seed=1)
    clean = forward_ols_dense(p[1:], y[1:], 3)
    p[0], y[0] = np.nan, np.inf
    masked = forward_ols_dense(p, y, 3, weights=np.r_[0.0, np.ones(11)])
    assert_array_equal(masked.indices, clean.indices)
    assert_array_equal(masked.err, clean.err)


def test_column_scaling_changes_nothing_but_coefficients():
    p, y = noise(30, 6), noise(30, seed=1)
    scale = 10.0 ** np.arange(-3, 3)
    plain, scaled = forward_ols_dense(p, y, 4), forward_ols_dense(p * scale, y, 4)
    assert_array_equal(plain.indices, scaled.indices)
    assert_allclose(plain.err, scaled.err, rtol=ROUNDING)
    undone = scaled.coefficients * scale[scaled.indices]
    assert_allclose(plain.coefficients, undone, rtol=ROUNDING)


def test_dependent_and_zero_columns_are_passed_over():
    a, b = noise(20), noise(20, seed=1)
    p = np.column_stack([a, b, a + 2 * b, 3 * a, np.zeros(20)])
    out = forward_ols_dense(p, noise(20, seed=2), 5)
    assert len(out.indices) == 2
    assert 4 not in out.indices
    assert not {0, 3} <= set(out.indices.tolist())


def test_tau_decides_what_is_nearly_dependent():
    a = np.array([1.0, 0.0, 0.0])
    nearly = np.array([1.0, 1e-4, 0.0])  # squared remainder 1e-8 of its norm
    p, y = np.column_stack([a, nearly]), np.array([3.0, 1.0, 0.0])
    assert len(forward_ols_dense(p, y, 2, tau=1e-7).indices) == 1
    assert len(forward_ols_dense(p, y, 2, tau=1e-9).indices) == 2


def test_no_more_terms_than_rows_and_last_gap_is_infinite():
    assert len(forward_ols_dense(noise(3, 5), noise(3, seed=1), 5).indices) == 3
    assert forward_ols_dense(noise(9, 2), noise(9, seed=1), 2).gaps[-1] == np.inf


def test_zero_target():
    out = forward_ols_dense(noise(9, 3), np.zeros(9), 2)
    assert_array_equal(out.err, [0, 0])
    assert_array_equal(out.coefficients, [0, 0])


# ---------------------------------------------------------------- validity functions


def test_reactivation_figures_of_the_design():
    z, centre = np.array([[0.2], [0.5], [0.9]]), np.array([[0.2], [0.5]])
    phi = validity(z, centre, np.array([[0.2], [0.05]]))
    # Printed to six decimals.
    assert_allclose(phi[:, 0], [1.0, 0.245085, 1.0], atol=1e-6)


def test_equal_widths_give_a_sigmoid():
    z = np.linspace(-1, 2, 7)[:, None]
    phi = validity(z, np.array([[0.0], [1.0]]), np.full((2, 1), 0.5))
    sigmoid = 1 / (1 + np.exp((z[:, 0] - 0.5) / 0.25))
    assert_allclose(phi[:, 0], sigmoid, rtol=ROUNDING)


def test_validity_sums_to_one_even_far_away():
    phi = validity(1e3 * noise(20, 3), noise(5, 3, seed=1), np.full((5, 3), 0.01))
    assert_allclose(phi.sum(axis=1), 1, rtol=ROUNDING)


def test_dimensions_multiply():
    z, c, s = noise(6, 2), noise(3, 2, seed=1), 1 + noise(3, 2, seed=2) ** 2
    product = validity(z[:, :1], c[:, :1], s[:, :1])
    product = product * validity(z[:, 1:], c[:, 1:], s[:, 1:])
    product /= product.sum(axis=1, keepdims=True)
    assert_allclose(validity(z, c, s), product, rtol=ROUNDING)


# ----------------------------------------------------------- prediction, simulation


def first_order(a: float, b: float, **options) -> Network:
    """y(t) = a y(t-1) + b u(t) with signals u, y."""
    terms = [((0, 1), a), ((0, 2), b)]
    return Network([OutputModel(1, [(1, 1), (0, 0)], [terms], **options)], np.ones(2))


def test_free_run_of_a_first_order_lag():
    a, b, time = 0.8, 0.5, 12
    signals = np.column_stack([np.ones(time), np.full(time, 7.0)])
    run = free_run(signals, first_order(a, b))
    steps = np.arange(time)
    closed = a**steps * 7 + b * (1 - a**steps) / (1 - a)
    assert_allclose(run.outputs[:, 0], closed, rtol=ROUNDING)
    assert_array_equal(run.usable, steps > 0)
    assert not run.limited.any()


def quadratic_network(gain: np.ndarray) -> Network:
    """Two coupled outputs, scheduled on own and foreign signals, uneven terms."""
    first = OutputModel(
        signal=2,
        variables=[(2, 1), (3, 2), (0, 0), (1, 3)],
        models=[
            [((0, 1), 0.5), ((1, 3), -0.2), ((0, 0), 0.1)],
            [((0, 2), 0.3), ((4, 4), 0.4)],
        ],
        schedule=[(0, 0), (2, 1)],
        schedule_offset=[-1.0, -2.0],
        schedule_gain=[2.0, 4.0],
        centre=np.array([[0.2, 0.3], [0.8, 0.6]]),
        width=np.array([[0.3, 0.3], [0.2, 0.5]]),
    )
    second = OutputModel(
        signal=3,
        variables=[(3, 1), (2, 1), (0, 1)],
        models=[[((0, 1), 0.6), ((1, 2), 0.1), ((0, 3), 1.0)]],
    )
    return Network([first, second], gain)


def network_signals(time: int = 25) -> np.ndarray:
    return np.random.default_rng(3).uniform(-1, 1, (time, 4))


def test_run_follows_the_formula_written_out():
    gain = np.array([2.0, 0.5, 3.0, 1.5])
    s = network_signals()
    run = free_run(s, quadratic_network(gain))
    assert_array_equal(run.outputs[:3], s[:3, 2:])
    y = run.outputs
    for t in range(3, len(s)):
        z = np.array([(s[t, 0] + 1) / 2, (y[t - 1, 0] + 2) / 4])
        mu_1 = np.exp(-0.5 * (((z - [0.2, 0.3]) / 0.3) ** 2).sum())
        mu_2 = np.exp(-0.5 * (((z - [0.8, 0.6]) / [0.2, 0.5]) ** 2).sum())
        own, other = y[t - 1, 0] / 3.0, y[t - 2, 1] / 1.5
        u, v = s[t, 0] / 2.0, s[t - 3, 1] / 0.5
        local_1 = 0.5 * own - 0.2 * own * u + 0.1
        local_2 = 0.3 * other + 0.4 * v**2
        first = 3.0 * (mu_1 * local_1 + mu_2 * local_2) / (mu_1 + mu_2)
        back, side = y[t - 1, 1] / 1.5, y[t - 1, 0] / 3.0
        second = 1.5 * (0.6 * back + 0.1 * back * side + s[t - 1, 0] / 2.0)
        assert_allclose(y[t], [first, second], rtol=1e-10)


def test_linear_coupled_outputs_are_matrix_powers():
    a = np.array([[0.9, -0.3], [0.2, 0.7]])
    outputs = [
        OutputModel(o, [(0, 1), (1, 1)], [[((1,), a[o, 0]), ((2,), a[o, 1])]])
        for o in range(2)
    ]
    start = np.array([1.0, -2.0])
    signals = np.vstack([start, np.full((9, 2), np.nan)])
    run = free_run(signals, Network(outputs, np.ones(2)))
    powers = [np.linalg.matrix_power(a, n) @ start for n in range(10)]
    assert_allclose(run.outputs, powers, rtol=ROUNDING)


def test_free_run_ignores_later_measured_outputs():
    s = network_signals()
    network = quadratic_network(np.ones(4))
    changed = s.copy()
    changed[3:, 2:] = np.nan
    assert_array_equal(
        free_run(s, network).outputs[3:], free_run(changed, network).outputs[3:]
    )


def test_gain_scaling_is_a_change_of_units():
    # Signals in other units, with gains and scheduling in those units: same model.
    s, unit = network_signals(), np.array([10.0, 0.1, 5.0, 20.0])
    network = quadratic_network(np.ones(4))
    first, second = network.outputs
    moved = OutputModel(
        signal=2,
        variables=first.variables,
        models=first.models,
        schedule=first.schedule,
        schedule_offset=[-10.0, -10.0],
        schedule_gain=[20.0, 20.0],
        centre=first.centre,
        width=first.width,
    )
    other = free_run(s * unit, Network([moved, second], unit))
    expected = free_run(s, network).outputs * unit[2:]
    assert_allclose(other.outputs, expected, rtol=1e-10)


def test_identical_local_models_make_the_partition_immaterial():
    terms = [((0, 1), 0.8), ((0, 2), 0.5)]
    split = OutputModel(
        1,
        [(1, 1), (0, 0)],
        [terms, terms],
        schedule=[(1, 1)],
        schedule_offset=[0.0],
        schedule_gain=[1.0],
        centre=np.array([[0.0], [1.0]]),
        width=np.array([[0.3], [0.3]]),
    )
    s = network_signals()[:, :2]
    one = free_run(s, first_order(0.8, 0.5))
    two = free_run(s, Network([split], np.ones(2)))
    assert_allclose(one.outputs, two.outputs, rtol=ROUNDING)


def test_bounds_clip_feed_back_and_mark():
    # y doubles each step: 1 2 4 8 16; clipped at 5 it stays there, being 10 inside.
    signals = np.column_stack([np.zeros(6), np.ones(6)])
    run = free_run(signals, first_order(2.0, 0.0, lower=-5.0, upper=5.0))
    assert_array_equal(run.outputs[:, 0], [1, 2, 4, 5, 5, 5])
    assert_array_equal(run.limited[:, 0], [0, 0, 0, 1, 1, 1])
    mirrored = free_run(-signals, first_order(2.0, 0.0, lower=-5.0, upper=5.0))
    assert_array_equal(mirrored.outputs, -run.outputs)
    assert_array_equal(mirrored.limited, run.limited)


def test_reaching_a_bound_exactly_is_not_limited():
    signals = np.column_stack([np.zeros(4), np.ones(4)])
    run = free_run(signals, first_order(1.0, 0.0, upper=1.0))
    assert not run.limited.any()


def test_measured_start_is_not_clipped():
    signals = np.column_stack([np.zeros(3), np.full(3, 9.0)])
    run = free_run(signals, first_order(1.0, 0.0, upper=5.0))
    assert_array_equal(run.outputs[:, 0], [9, 5, 5])
    assert_array_equal(run.limited[:, 0], [False, True, False])


def test_record_no_longer_than_the_history():
    s = network_signals(2)
    run = free_run(s, quadratic_network(np.ones(4)))
    assert_array_equal(run.outputs, s[:, 2:])
    assert not run.usable.any()


def test_output_without_lag_is_refused():
    loop = OutputModel(1, [(1, 0)], [[((1,), 1.0)]])
    with pytest.raises(ValueError, match="lag >= 1"):
        free_run(np.ones((3, 2)), Network([loop], np.ones(2)))


def test_start_before_full_history_is_refused():
    with pytest.raises(ValueError, match="start >= 1"):
        run_from(np.ones((3, 2)), first_order(0.5, 0.5), 0, 3)


def test_one_step_prediction_is_a_matrix_product():
    s = network_signals()
    table, factor = [(3, 1), (2, 1), (0, 1)], np.array([[0, 1], [1, 2], [0, 3]])
    x, _ = lagged(s, table)
    run = k_step(s, quadratic_network(np.ones(4)), 1)
    expected = term_matrix(x, factor) @ [0.6, 0.1, 1.0]
    assert_allclose(run.outputs[3:, 1], expected[3:], rtol=ROUNDING)
    assert_array_equal(run.usable, np.arange(25) >= 3)


@pytest.mark.parametrize("k", [1, 2, 5])
def test_k_step_of_a_first_order_lag(k):
    a, time = 0.8, 15
    y = noise(time)
    run = k_step(np.column_stack([np.zeros(time), y]), first_order(a, 0.5), k)
    assert_allclose(run.outputs[k:, 0], a**k * y[:-k], rtol=ROUNDING)
    assert_array_equal(run.outputs[:k, 0], y[:k])
    assert_array_equal(run.usable, np.arange(time) >= k)


def test_k_step_meets_the_free_run():
    s, network = network_signals(), quadratic_network(np.ones(4))
    run = free_run(s, network)
    for k in (1, 4, 22):
        t = network.max_lag + k - 1
        assert_array_equal(k_step(s, network, k).outputs[t], run.outputs[t])


def test_k_step_of_a_perfect_model_is_the_record():
    network = quadratic_network(np.ones(4))
    s = network_signals()
    s[:, 2:] = free_run(s, network).outputs
    for k in (1, 3):
        assert_allclose(k_step(s, network, k).outputs, s[:, 2:], rtol=ROUNDING)


# -------------------------------------------------------------------------- LOLIMOT


def grid() -> tuple[np.ndarray, np.ndarray]:
    u = np.linspace(0, 1, 15)
    pairs = np.array([(a, b) for a in u for b in u])
    return pairs, 1 / (0.1 + pairs[:, 0]) + (2 * pairs[:, 1]) ** 2


def test_published_curve_in_one_dimension():
    u = np.linspace(0, 1, 15)
    out = lolimot(u[:, None], 1 / (0.1 + u), k_sigma=0.4, max_models=20)
    # Printed to six decimals; growth ends by itself, every model locked.
    assert len(out.nrmse) == len(GOLDEN_1D)
    assert_allclose(out.nrmse, GOLDEN_1D, rtol=0, atol=1e-6)


def test_published_curve_in_two_dimensions():
    z, y = grid()
    out = lolimot(z, y, k_sigma=0.4, max_models=26)
    assert_allclose(out.nrmse, GOLDEN_2D, rtol=0, atol=1e-6)
    # The one tie: at 9 models two boxes are mirror images; either gives the figures.
    assert [m for m, gap in enumerate(out.worst_gap, 1) if gap < 1e-9] == [9]
    assert min(out.dim_gap) > 1e-3


def test_boxes_tile_the_unit_square():
    z, y = grid()
    out = lolimot(z, y, max_models=12)
    assert_allclose(np.prod(out.upper - out.lower, axis=1).sum(), 1, rtol=ROUNDING)
    for a, b in combinations(range(12), 2):
        low = np.maximum(out.lower[a], out.lower[b])
        high = np.minimum(out.upper[a], out.upper[b])
        assert (high <= low).any()


def test_one_model_is_least_squares():
    z, y = grid()
    x = np.column_stack([np.ones(len(z)), z])
    out = lolimot(z, y, max_models=1)
    expected = np.sqrt(sse(x, y) / np.sum((y - y.mean()) ** 2))
    assert_allclose(out.nrmse, [expected], rtol=ROUNDING)


def test_units_of_inputs_and_output_do_not_matter():
    z, y = grid()
    plain = lolimot(z, y, max_models=8)
    moved = lolimot(z * [1e3, 1e-2] + [5.0, 70.0], 4 * y - 300, max_models=8)
    assert_allclose(moved.nrmse, plain.nrmse, rtol=1e-9)
    assert moved.splits == plain.splits


def test_a_kink_at_the_middle_is_split_there():
    z = noise(200, 2)
    z = (z - z.min(axis=0)) / np.ptp(z, axis=0)
    y = np.abs(z[:, 1] - 0.5)
    out = lolimot(z, y, max_models=2)
    assert out.splits == [(0, 1)]
    # The children see mostly one side each: slopes of opposite sign.
    assert out.coefficients[0, 2] < 0 < out.coefficients[1, 2]


def test_consequents_may_differ_from_the_scheduling():
    # One regressor, one border: y = theta(z) x with theta -1 left and 2 right of it.
    z, x = np.repeat([0.0, 1.0], 10)[:, None], noise(20, 1)
    y = np.where(z[:, 0] < 0.5, -1.0, 2.0) * x[:, 0]
    out = lolimot(z, y, k_sigma=0.05, max_models=2, regressors=x)
    # phi at the far samples is exp(-100): the fits see one side only.
    assert_allclose(out.coefficients[:, 0], [-1, 2], rtol=ROUNDING)
    assert out.nrmse[-1] < ROUNDING


def test_too_few_samples_lock_everything():
    z = np.linspace(0, 1, 3)[:, None]
    out = lolimot(z, z[:, 0] ** 2, max_models=5)
    # 3 samples cannot carry two models of two parameters.
    assert len(out.nrmse) == 1
    assert out.splits == []


# ---------------------------------------------------------------------- derivatives


def test_central_difference_is_exact_on_quadratics():
    a = noise(3, 3)
    x = noise(3, seed=1)
    gradient = central_difference(lambda v: v @ a @ v, x, eps=1e-3)
    # A quadratic has no third derivative; rounding is 1e-16 / 1e-3.
    assert_allclose(gradient, (a + a.T) @ x, rtol=1e-11, atol=1e-11)


def test_central_difference_keeps_the_axes_of_the_function():
    x = np.array([0.3, 200.0])

    def f(v):
        return np.array([[v[0] * v[1], np.sin(v[0])], [v[1], 1.0], [v[1] ** 2, v[0]]])

    expected = [[[200, 0.3], [np.cos(0.3), 0]], [[0, 1], [0, 0]], [[0, 400], [1, 0]]]
    # Rounding of values near 200 over a step of 1e-6: 2e-16 * 200 / 1e-6.
    assert_allclose(central_difference(f, x), expected, rtol=1e-8, atol=1e-7)


def test_normal_equations_of_a_linear_residual():
    p, y, theta = noise(10, 3), noise(10, seed=1), noise(3, seed=2)
    hessian, gradient = normal_equations(lambda v: p @ v - y, theta)
    assert_allclose(hessian, p.T @ p, rtol=1e-7, atol=1e-7)
    assert_allclose(gradient, p.T @ (p @ theta - y), rtol=1e-7, atol=1e-7)
    step = theta - np.linalg.solve(hessian, gradient)
    assert_allclose(step, np.linalg.lstsq(p, y, rcond=None)[0], rtol=1e-6)


def test_normal_equations_of_a_simulation_error():
    # y(t) = a y(t-1) free running from y(0) = 1: r_t = a^t - m_t, dr_t/da = t a^(t-1).
    a, steps = 0.9, np.arange(8)
    measured = noise(8)

    def residual(v):
        signals = np.column_stack([np.zeros(8), np.r_[1.0, measured[1:]]])
        return (
            free_run(signals, first_order(v[0], 0.0)).outputs[1:] - measured[1:, None]
        )

    slope = steps[1:] * a ** (steps[1:] - 1)
    hessian, gradient = normal_equations(residual, np.array([a]))
    assert_allclose(hessian, [[slope @ slope]], rtol=1e-8)
    assert_allclose(gradient, [slope @ (a ** steps[1:] - measured[1:])], rtol=1e-7)
