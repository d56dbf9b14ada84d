"""Least squares against `numpy.linalg.lstsq`, and where it is not unique."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.arrays import least_squares

TIME, TERMS = 40, 5
solve = jax.jit(least_squares)


def problem(time: int = TIME, terms: int = TERMS, seed: int = 0):
    rng = np.random.default_rng(seed)
    weight = rng.uniform(0.2, 3.0, size=time)
    return rng.normal(size=(terms, time)), rng.normal(size=time), weight


def reference(columns, y, weight):
    root = np.sqrt(weight)
    return np.linalg.lstsq((columns * root).T, y * root, rcond=None)[0]


def solved(columns, y, weight):
    theta, rank, condition = solve(*(jnp.asarray(a) for a in (columns, y, weight)))
    return np.asarray(theta), int(rank), float(condition)


def scaled_condition(columns, weight):
    a = columns * np.sqrt(weight)
    return np.linalg.cond((a / np.linalg.norm(a, axis=1, keepdims=True)).T)


def test_equals_lstsq_with_condition_of_the_scaled_columns():
    columns, y, weight = problem()
    theta, rank, condition = solved(columns, y, weight)
    # A well conditioned problem of this size is solved to rounding by both.
    np.testing.assert_allclose(theta, reference(columns, y, weight), rtol=1e-12)
    assert rank == TERMS
    np.testing.assert_allclose(condition, scaled_condition(columns, weight), rtol=1e-10)


def test_the_weighted_residual_is_orthogonal_to_every_column():
    columns, y, weight = problem(seed=1)
    theta, _, _ = solved(columns, y, weight)
    moment = (columns * weight) @ (y - theta @ columns)
    # Sums of 40 products of order one.
    np.testing.assert_allclose(moment, 0.0, atol=1e-12)


def test_samples_of_weight_zero_do_not_count_whatever_they_hold():
    columns, y, weight = problem(seed=2)
    kept = solved(columns, y, weight * (np.arange(TIME) % 4 > 0))
    columns[:, ::4], y[::4] = 1e6, -1e6
    spoilt = solved(columns, y, weight * (np.arange(TIME) % 4 > 0))
    np.testing.assert_array_equal(kept[0], spoilt[0])
    keep = np.arange(TIME) % 4 > 0
    expected = reference(columns[:, keep], y[keep], weight[keep])
    np.testing.assert_allclose(kept[0], expected, rtol=1e-12)


def test_an_integer_weight_is_a_repeated_sample():
    columns, y, _ = problem(seed=3)
    times = np.arange(TIME) % 3 + 1
    repeated = np.repeat(columns, times, axis=1), np.repeat(y, times)
    expected = reference(*repeated, np.ones(times.sum()))
    theta, _, _ = solved(columns, y, times.astype(float))
    np.testing.assert_allclose(theta, expected, rtol=1e-12)


def test_scaling_a_column_scales_its_coefficient_only():
    columns, y, weight = problem(seed=4)
    factor = 10.0 ** np.array([-8, -3, 0, 4, 9])
    plain = solved(columns, y, weight)
    scaled = solved(columns * factor[:, None], y, weight)
    np.testing.assert_allclose(scaled[0] * factor, plain[0], rtol=1e-10)
    np.testing.assert_allclose(scaled[2], plain[2], rtol=1e-10)
    assert scaled[1] == plain[1] == TERMS


def test_an_ill_conditioned_fit_still_has_the_smallest_residual():
    columns, y, weight = problem(seed=5)
    # Nearly equal columns: the normal equations would lose all digits (condition 1e16).
    columns[4] = columns[0] + 1e-8 * columns[4]
    theta, rank, condition = solved(columns, y, weight)
    assert rank == TERMS
    assert 1e7 < condition < 1e10
    expected = reference(columns, y, weight)
    ours, theirs = (np.sum(weight * (y - t @ columns) ** 2) for t in (theta, expected))
    # Coefficients near 1e7 make the sums themselves uncertain by 1e7 eps; a dropped
    # direction would cost about one part in 40.
    np.testing.assert_allclose(ours, theirs, rtol=1e-8)


def test_collinear_columns_report_their_rank_and_fit_as_well_as_any():
    columns, y, weight = problem(seed=6)
    columns[3] = -2.0 * columns[1]
    theta, rank, condition = solved(columns, y, weight)
    assert rank == TERMS - 1
    assert condition == np.inf
    best = reference(columns, y, weight)
    np.testing.assert_allclose(theta @ columns, best @ columns, atol=1e-12)
    # Minimum norm belongs to unit columns: there the pair shares alike.
    np.testing.assert_allclose(theta[1], -2.0 * theta[3], rtol=1e-9)


def test_an_all_zero_column_gets_a_zero_coefficient():
    columns, y, weight = problem(seed=7)
    columns[2] = 0.0
    theta, rank, condition = solved(columns, y, weight)
    others = np.array([0, 1, 3, 4])
    # Zero to rounding of the others, which are of order one.
    assert abs(theta[2]) < 1e-14
    assert rank == TERMS - 1 and condition == np.inf
    expected = reference(columns[others], y, weight)
    np.testing.assert_allclose(theta[others], expected, rtol=1e-12)


def test_no_weight_at_all_gives_zeros():
    columns, y, _ = problem(seed=8)
    theta, rank, condition = solved(columns, y, np.zeros(TIME))
    np.testing.assert_array_equal(theta, 0.0)
    assert rank == 0 and condition == np.inf


def test_fewer_samples_than_terms_is_rank_deficient():
    columns, y, weight = problem(time=3, seed=9)
    theta, rank, condition = solved(columns, y, weight)
    np.testing.assert_allclose(theta @ columns, y, atol=1e-12)
    assert rank == 3
    assert condition == np.inf


def test_vmap_is_a_loop():
    problems = [problem(seed=s) for s in (10, 11)]
    stacked = [np.stack(a) for a in zip(*problems, strict=True)]
    theta, rank, _ = jax.jit(jax.vmap(least_squares))(
        *(jnp.asarray(a) for a in stacked)
    )
    for n in range(2):
        alone = solved(*(a[n] for a in stacked))
        np.testing.assert_allclose(theta[n], alone[0], rtol=1e-12)
        assert rank[n] == alone[1]


def test_float32_stays_float32():
    columns, y, weight = (jnp.asarray(a, jnp.float32) for a in problem(seed=12))
    theta, _, condition = solve(columns, y, weight)
    assert theta.dtype == condition.dtype == jnp.float32
    exact = reference(*problem(seed=12))
    # Condition below 3, so a few float32 roundings.
    np.testing.assert_allclose(theta, exact, rtol=0, atol=3e-6)


# normal equations -----------------------------------------------------------------
