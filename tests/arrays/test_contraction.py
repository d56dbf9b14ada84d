"""Contractions of a pool that is never formed, against the formed pool."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import full_pool, term_matrix

from jaxnarx.arrays.contraction import (
    BLOCK_SAMPLES,
    WIDTH_MULTIPLE,
    contract,
    plan,
    positions,
)

compiled = jax.jit(contract, static_argnames=("degree", "squared"))


def problem(variables: int, time: int, vectors: int = 1, seed: int = 0):
    """`v` with its leading ones, (variables + 1, time), and vectors (vectors, time)."""
    rng = np.random.default_rng([seed, variables, time])
    x = rng.normal(size=(variables, time))
    return np.concatenate([np.ones((1, time)), x]), rng.normal(size=(vectors, time))


def formed(v, q, factor):
    """The same products from the formed pool, and the sums of magnitudes in them."""
    p = term_matrix(v[1:].T, factor)
    return q @ p, np.abs(q) @ np.abs(p)


def assert_products(found, v, q, factor, *, eps=2.2e-16):
    """Equal to rounding: N additions and 5 products on either side.

    Each side is off by at most (N + 5) eps / 2 times the sum of magnitudes.
    """
    expected, magnitude = formed(v, q, factor)
    assert found.shape == expected.shape
    assert np.all(np.abs(found - expected) <= (v.shape[1] + 5) * eps * magnitude)


# Variables (without the one) that fill the right-hand side to before, at and after its
# rounded width, and enough of them for one, two and many groups. At degree 4 the right
# side holds pairs: 3, 15, 36 and 66.
SIZES = [
    *((1, n) for n in (1, WIDTH_MULTIPLE - 1, WIDTH_MULTIPLE)),
    *((2, n) for n in (1, WIDTH_MULTIPLE - 1, WIDTH_MULTIPLE, 3 * WIDTH_MULTIPLE)),
    *((3, n) for n in (1, WIDTH_MULTIPLE - 1, WIDTH_MULTIPLE, 27)),
    *((4, n) for n in (1, 4, 7, 10)),
]


@pytest.mark.parametrize(("degree", "variables"), SIZES)
def test_equals_the_formed_pool(degree, variables):
    v, q = problem(variables, 40)
    factor = full_pool(variables, degree)
    found = compiled(v, q, degree=degree)
    assert_products(
        np.asarray(found)[:, positions(factor, variables + 1)], v, q, factor
    )


@pytest.mark.parametrize(
    "time",
    [1, BLOCK_SAMPLES - 1, BLOCK_SAMPLES, BLOCK_SAMPLES + 1, 2 * BLOCK_SAMPLES, 1100],
)
@pytest.mark.parametrize("degree", [3, 4])
def test_every_remainder_of_a_block_counts_once(time, degree):
    v, q = problem(3, time)
    factor = full_pool(3, degree)
    found = compiled(v, q, degree=degree)
    assert_products(np.asarray(found)[:, positions(factor, 4)], v, q, factor)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_several_vectors_are_each_alone(degree):
    v, q = problem(5, BLOCK_SAMPLES + 8, vectors=3)
    together = np.asarray(compiled(v, q, degree=degree))
    factor = full_pool(5, degree)
    assert_products(np.asarray(together)[:, positions(factor, 6)], v, q, factor)
    for n in range(3):
        alone = np.asarray(compiled(v, q[n : n + 1], degree=degree))
        # Another batch size may be summed in another order.
        np.testing.assert_allclose(together[n], alone[0], rtol=0, atol=1e-11)


def test_a_zero_in_the_vector_removes_the_sample_whatever_it_holds():
    v, q = problem(4, 30)
    q[:, 11] = 0.0
    v[1:, 11] = 1e150
    keep = np.arange(30) != 11
    factor = full_pool(4, 2)
    found = compiled(v, q, degree=2)
    assert_products(
        np.asarray(found)[:, positions(factor, 5)], v[:, keep], q[:, keep], factor
    )


@pytest.mark.parametrize("time", [40, BLOCK_SAMPLES + 8])
def test_squared_is_the_contraction_of_the_squares(time):
    v, q = problem(4, time)
    factor = full_pool(4, 3)
    found = compiled(v, q, degree=3, squared=True)
    assert_products(np.asarray(found)[:, positions(factor, 5)], v**2, q, factor)


@pytest.mark.parametrize("squared", [False, True])
def test_no_copy_of_the_variables_is_made(squared):
    v, q = (np.zeros((n, 64 * BLOCK_SAMPLES)) for n in (10, 1))
    lowered = compiled.lower(v, q, degree=3, squared=squared)
    memory = lowered.compile().memory_analysis()
    assert memory is not None
    assert memory.temp_size_in_bytes < v.nbytes / 4


def test_vmap_over_data_is_a_loop():
    problems = [problem(4, 60, seed=s) for s in (1, 2, 3)]
    v, q = (np.stack(a) for a in zip(*problems, strict=True))
    batched = np.asarray(jax.jit(jax.vmap(lambda v, q: contract(v, q, 3)))(v, q))
    factor = full_pool(4, 3)
    for n in range(3):
        found = batched[n][:, positions(factor, 5)]
        assert_products(found, v[n], q[n], factor)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_float32_stays_float32(degree):
    v, q = (a.astype(np.float32) for a in problem(3, BLOCK_SAMPLES + 5))
    found = compiled(v, q, degree=degree)
    assert found.dtype == jnp.float32
    factor = full_pool(3, degree)
    sums = np.asarray(found, float)[:, positions(factor, 4)]
    assert_products(sums, v.astype(float), q.astype(float), factor, eps=1.2e-7)


# positions ------------------------------------------------------------------------


@pytest.mark.parametrize(("degree", "variables"), SIZES)
def test_positions_of_a_full_pool_are_distinct_and_in_range(degree, variables):
    at = positions(full_pool(variables, degree), variables + 1)
    assert len(np.unique(at)) == len(at) == math.comb(variables + degree, degree)
    assert at.min() >= 0
    assert at.max() < plan(variables + 1, degree).offsets[-1]


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_rows_may_be_unsorted_repeated_and_few(degree):
    variables = 8
    factor = full_pool(variables, degree)
    whole = dict(
        zip(map(tuple, factor.tolist()), positions(factor, variables + 1), strict=True)
    )
    rng = np.random.default_rng(degree)
    some = rng.choice(len(factor), size=20)
    shuffled = rng.permuted(factor[some], axis=1)
    expected = [whole[tuple(sorted(row))] for row in shuffled.tolist()]
    np.testing.assert_array_equal(positions(shuffled, variables + 1), expected)


def test_every_order_of_the_factors_is_the_same_term():
    orders = np.array(list(itertools.permutations((0, 2, 5, 2))))
    assert len(set(positions(orders, 6).tolist())) == 1


@pytest.mark.parametrize("degree", [0, 5])
def test_other_degrees_are_refused(degree):
    with pytest.raises(ValueError, match=f"1 to 4, got {degree}"):
        plan(3, degree)
