"""The run by Newton's method against the time loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.arrays.recurrence import free_run, linear_recurrence
from jaxnarx.arrays.time_parallel import affine_recurrence, newton_run, parallel_run

TIME, OUTPUTS, DEPTH = 60, 2, 3
EQUAL = 1e-9
"""The contract of `parallel_run`; Newton's method stops at 1e-10."""


def step(params, drive, history):
    """Two coupled outputs, products of feedback and input, lags 1 to 3."""
    h = history
    first = params[0] * h[0, 0] - 0.2 * h[0, 1] + params[1] * drive[0] * h[1, 0]
    second = params[2] * h[1, 0] + params[3] * h[0, 2] ** 2 - 0.25 * h[1, 2]
    return jnp.stack([first + drive[0], second + drive[1] * drive[0]])


def problem(*anchors: int, gain: float = 1.0, seed: int = 0):
    rng = np.random.default_rng(seed)
    return (
        gain * np.array([0.7, 0.2, 0.5, 0.3]),
        rng.uniform(-0.5, 0.5, size=(TIME, 2)),
        rng.uniform(-0.4, 0.4, size=(TIME, OUTPUTS)),
        np.isin(np.arange(TIME), anchors),
    )


def bounds(limit: float):
    return np.full(OUTPUTS, -limit), np.full(OUTPUTS, limit)


def compiled(run, **more):
    """A run in one program, on the host."""
    program = jax.jit(lambda *args: run(step, *args, depth=DEPTH, **more))
    return lambda *args: jax.tree.map(np.asarray, program(*args))


loop, newton = compiled(free_run), compiled(newton_run)
parallel = compiled(parallel_run)


@pytest.mark.parametrize("limit", [50.0, 0.35], ids=["wide", "tight"])
@pytest.mark.parametrize("anchors", [(3,), (17,), (3, 20, 21, 40), tuple(range(3, 60))])
def test_newton_alone_equals_the_loop(anchors, limit):
    args = (*problem(*anchors), *bounds(limit))
    expected = loop(*args)[anchors[0] :]
    found, converged, count = newton(*args)
    assert converged and count <= 30
    np.testing.assert_allclose(found[anchors[0] :], expected, rtol=0, atol=EQUAL)
    assert (np.abs(expected) == limit).any() == (limit < 1)


@pytest.mark.parametrize("size", [1.0, 1e4])
def test_an_affine_run_takes_one_iteration_and_one_to_see_it(size):
    """Whatever the size of its outputs, against which corrections are judged."""
    params, drive, measured, anchor = problem(3)
    linear = params * np.array([1.0, 0.0, 1.0, 0.0])
    rest = size * drive, size * measured, anchor
    _, converged, count = newton(linear, *rest, *bounds(50.0 * size**2))
    assert converged and count == 2


def test_an_unstable_run_is_that_of_the_loop():
    # The linear solutions overflow; whatever Newton does, the loop's outputs return.
    args = (*problem(3, gain=4.0), *bounds(5.0))
    expected = loop(*args)[3:]
    assert (np.abs(expected) == 5.0).mean() > 0.2
    np.testing.assert_allclose(parallel(*args)[0][3:], expected, rtol=0, atol=EQUAL)


def test_where_newton_has_not_converged_the_loop_is_used():
    args = (*problem(3), *bounds(50.0))
    y, converged = compiled(parallel_run, iterations=1)(*args)
    assert not converged
    np.testing.assert_array_equal(y[3:], loop(*args)[3:])


def test_what_precedes_the_first_anchor_does_not_matter():
    params, drive, measured, anchor = problem(30)
    wild = np.where(np.arange(TIME)[:, None] < 30, 1e6, drive)
    plain, spoilt = (
        newton(params, d, measured, anchor, *bounds(50.0)) for d in (drive, wild)
    )
    assert plain[1:] == spoilt[1:]
    np.testing.assert_array_equal(plain[0][30:], spoilt[0][30:])


def test_map_over_records_is_a_loop_over_them():
    records = [problem(3, seed=s)[1:] for s in range(3)]
    params, low, high = jax.device_put((problem(3)[0], *bounds(50.0)))
    stacked = [np.stack(a) for a in zip(*records, strict=True)]

    def one(record):
        drive, measured, anchor = record
        args = params, drive, measured, anchor, low, high
        return parallel_run(step, *args, depth=DEPTH)

    y, converged = jax.jit(lambda data: jax.lax.map(one, data))(tuple(stacked))
    assert converged.all()
    for n, record in enumerate(records):
        expected = loop(params, *record, low, high)
        np.testing.assert_allclose(np.asarray(y)[n, 3:], expected[3:], 0, EQUAL)


def test_float32_stays_float32():
    args = [*problem(3), *bounds(50.0)]
    single = [a.astype(np.float32) if a.dtype != bool else a for a in args]
    y, converged = parallel(*single)
    assert y.dtype == np.float32 and converged
    np.testing.assert_allclose(y[3:], loop(*args)[3:], rtol=0, atol=1e-5)


def test_the_parallel_linear_recurrence_is_the_sequential_one():
    rng = np.random.default_rng(2)
    a = 0.3 * rng.normal(size=(TIME, OUTPUTS, OUTPUTS, DEPTH))
    d = rng.normal(size=(TIME, OUTPUTS))
    _, expected = jax.jit(linear_recurrence)(a, d, np.zeros((DEPTH, OUTPUTS)))
    none = np.zeros(TIME, bool)
    found = jax.jit(affine_recurrence)(a, d, none)
    # Sixty products of contractions on numbers of order one.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_an_anchor_forgets_a_past_that_has_overflowed():
    time, late = 400, 390
    age = np.arange(time) - late
    own = age[:, None] > np.arange(2)
    a = np.where((age < 0)[:, None], 1e3, np.where(own, 0.5, 0.0))[:, None, None]
    found = jax.jit(affine_recurrence)(a, np.ones((time, 1)), age == 0)
    found = np.asarray(found)[:, 0]
    assert not np.isfinite(found[late - 1])
    expected = [1.0, 1.5]
    for _ in range(8):
        expected.append(1.0 + 0.5 * (expected[-1] + expected[-2]))
    np.testing.assert_allclose(found[late:], expected, rtol=1e-14)
