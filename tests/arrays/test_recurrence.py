"""Output-feedback runs against a plain loop, their derivative against everything."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import central_difference

from jaxnarx.arrays.recurrence import (
    free_run,
    linear_recurrence,
    own_history,
    past_outputs,
    polynomial_step,
    run_history,
)

TIME, OUTPUTS, DEPTH = 40, 2, 3
WIDE = np.array([-50.0, -50.0]), np.array([50.0, 50.0])
# Where the run below leaves these, it is limited at about a third of its samples.
TIGHT = np.array([-0.35, -0.3]), np.array([0.5, 0.45])


def formula(p, u, h) -> tuple[Any, Any]:
    """Two coupled outputs, products of feedback, input and parameters; lags 1 to 3."""
    first = p[0] * h[0, 0] - 0.2 * h[0, 1] + p[1] * u[0] * h[1, 0] + u[0]
    second = p[2] * h[1, 0] + p[3] * h[0, 2] * h[0, 2] + u[1] * u[0] + p[4] * h[1, 2]
    return first, second


def step(params, drive, history):
    return jnp.stack(formula(params, drive, history))


def plain_loop(params, drive, measured, anchor, lower, upper):
    """The recursion in NumPy, one sample at a time; NaN before the first anchor."""
    y = np.full(measured.shape, np.nan)
    last = None
    for t in range(len(measured)):
        last = t if anchor[t] else last
        if last is None:
            continue
        past = [(y if t - 1 - d >= last else measured)[t - 1 - d] for d in range(DEPTH)]
        value = formula(params, drive[t], np.array(past).T)
        y[t] = np.clip(np.array(value), lower, upper)
    return y


class Problem(NamedTuple):
    params: np.ndarray
    drive: np.ndarray
    measured: np.ndarray
    anchor: np.ndarray


def anchored(*at: int) -> np.ndarray:
    return np.isin(np.arange(TIME), at)


def problem(anchor: np.ndarray, seed: int = 0) -> Problem:
    rng = np.random.default_rng(seed)
    params = np.array([0.7, 0.2, 0.5, 0.3, -0.25])
    drive = rng.uniform(-0.5, 0.5, size=(TIME, 2))
    return Problem(params, drive, rng.uniform(-0.4, 0.4, size=(TIME, OUTPUTS)), anchor)


@jax.jit
def compiled(params, drive, measured, anchor, lower, upper):
    return free_run(step, params, drive, measured, anchor, lower, upper, depth=DEPTH)


def run(p: Problem, bounds=WIDE):
    return np.asarray(compiled(*p, *bounds))


ANCHORS = {
    "one": anchored(DEPTH),
    "late": anchored(11),
    "several": anchored(3, 10, 11, 25),
    "every": np.arange(TIME) >= DEPTH,
    "windows": (np.arange(TIME) >= DEPTH) & ((np.arange(TIME) - DEPTH) % 5 == 0),
}


# the run --------------------------------------------------------------------------


@pytest.mark.parametrize("anchor", ANCHORS.values(), ids=ANCHORS.keys())
@pytest.mark.parametrize("bounds", [WIDE, TIGHT], ids=["wide", "tight"])
def test_equals_the_plain_loop_from_the_first_anchor(anchor, bounds):
    p = problem(anchor)
    expected = plain_loop(*p, *bounds)
    first = int(np.argmax(anchor))
    # Forty steps of a contraction: rounding only.
    np.testing.assert_allclose(
        run(p, bounds)[first:], expected[first:], rtol=0, atol=1e-13
    )


def test_tight_bounds_do_limit():
    free = run(problem(ANCHORS["one"]))[DEPTH:]
    held = run(problem(ANCHORS["one"]), TIGHT)[DEPTH:]
    at_border = (held == TIGHT[0]) | (held == TIGHT[1])
    assert 0.1 < at_border.mean() < 0.9
    assert not np.allclose(free[~at_border], held[~at_border])


def test_an_anchor_at_every_sample_is_the_one_step_prediction():
    p = problem(ANCHORS["every"])
    found = run(p)
    for t in range(DEPTH, TIME):
        past = np.array([p.measured[t - 1 - d] for d in range(DEPTH)]).T
        expected = formula(p.params, p.drive[t], past)
        np.testing.assert_allclose(found[t], np.array(expected), rtol=0, atol=1e-14)


def test_nothing_before_the_first_anchor_matters():
    p, late = problem(ANCHORS["late"]), 11
    wild = p.drive.copy()
    wild[:late] = 1e6
    measured = p.measured.copy()
    measured[: late - DEPTH] = -1e6
    spoilt = p._replace(drive=wild, measured=measured)

    def loss(params, q: Problem):
        y = compiled(params, *q[1:], *WIDE)
        return jnp.sum(y[late:] ** 2)

    graded = jax.jit(jax.value_and_grad(loss))
    plain, other = (graded(p.params, q) for q in (p, spoilt))
    np.testing.assert_array_equal(plain[0], other[0])
    np.testing.assert_array_equal(plain[1], other[1])


def test_a_chaotic_stretch_before_an_anchor_leaves_the_derivative_behind_it_finite():
    # The logistic map stays in [0, 1] while its sensitivity doubles every other sample;
    # after 2000 samples it has overflowed, but the history is measured anew there.
    time, late = 2000, 1990

    def logistic(params, drive, history):
        return params * history[:, 0] * (1.0 - history[:, 0]) + drive

    def tail(growth):
        y = free_run(
            logistic,
            growth,
            jnp.zeros((time, 1)),
            jnp.full((time, 1), 0.3),
            jnp.isin(jnp.arange(time), jnp.array([1, late])),
            jnp.zeros(1),
            jnp.ones(1),
            depth=1,
        )
        return y[late:, 0]

    _, tangent = jax.jit(lambda p, t: jax.jvp(tail, (p,), (t,)))(3.9, 1.0)
    # The first sample after the anchor: d/dp of p y (1 - y) at the measured y.
    np.testing.assert_allclose(tangent[0], 0.3 * 0.7, rtol=1e-14)
    assert np.all(np.isfinite(tangent))


def test_vmap_is_a_loop():
    problems = [problem(ANCHORS["several"], seed=s) for s in (1, 2, 3)]
    stacked = [np.stack(a) for a in zip(*problems, strict=True)]
    batch = jax.jit(jax.vmap(compiled, in_axes=(0, 0, 0, 0, None, None)))
    batched = np.asarray(batch(*stacked, *TIGHT))
    for n, p in enumerate(problems):
        np.testing.assert_allclose(
            batched[n, 3:], run(p, TIGHT)[3:], rtol=0, atol=1e-14
        )


def test_float32_stays_float32():
    p = problem(ANCHORS["one"])
    numbers = [a.astype(np.float32) for a in p[:3]]
    y = np.asarray(compiled(*numbers, p.anchor, *(b.astype(np.float32) for b in WIDE)))
    assert y.dtype == np.float32
    np.testing.assert_allclose(y[3:], run(p)[3:], rtol=0, atol=1e-5)


# its derivative -------------------------------------------------------------------


def scored(args, rest):
    """The run from the first anchor on, zero before; `rest`: anchor, bounds."""
    params, drive, measured = args
    anchor, lower, upper = rest
    y = free_run(step, params, drive, measured, anchor, lower, upper, depth=DEPTH)
    return jnp.where(jnp.cumsum(anchor)[:, None] > 0, y, 0.0)


def through_scan(args, rest):
    """The same by an explicit scan that jax differentiates itself."""
    params, drive, measured = args
    anchor, lower, upper = rest
    fresh = jnp.stack(
        [jnp.roll(measured, d + 1, axis=0) for d in range(DEPTH)], axis=-1
    )

    def body(past, inputs):
        u, fresh_t, restart = inputs
        past = jnp.where(restart, fresh_t, past)
        y = jnp.clip(step(params, u, past), lower, upper)
        return jnp.concatenate([y[:, None], past[:, :-1]], axis=1), y

    start = jnp.zeros((OUTPUTS, DEPTH))
    _, y = jax.lax.scan(body, start, (drive, fresh, anchor))
    return jnp.where(jnp.cumsum(anchor)[:, None] > 0, y, 0.0)


value = jax.jit(scored)
# One compiled program of each kind serves all cases: anchors and bounds are data.
forward = jax.jit(lambda a, t, r: jax.jvp(lambda a: scored(a, r), (a,), (t,)))
reverse = jax.jit(lambda a, ct, r: jax.vjp(lambda a: scored(a, r), a)[1](ct)[0])


@partial(jax.jit, static_argnames="run")
def gradient(args, target, rest, run):
    return jax.grad(lambda a: jnp.sum((run(a, rest) - target) ** 2))(args)


CASES = [
    pytest.param(ANCHORS[name], bounds, id=f"{name}-{kind}")
    for name in ("one", "several", "every")
    for kind, bounds in (("wide", WIDE), ("tight", TIGHT))
]


def arguments(anchor, bounds):
    return tuple(problem(anchor)[:3]), (anchor, *bounds)


def normal(*shape: int, seed: int):
    return np.random.default_rng(seed).normal(size=shape)


@pytest.mark.parametrize(("anchor", "bounds"), CASES)
@pytest.mark.parametrize("which", [0, 1, 2], ids=["params", "drive", "measured"])
def test_jvp_is_the_central_difference(anchor, bounds, which):
    args, rest = arguments(anchor, bounds)
    tangents = [np.zeros_like(a) for a in args]
    tangents[which] = normal(*args[which].shape, seed=which)
    _, found = forward(args, tuple(tangents), rest)

    def along(s):
        pairs = zip(args, tangents, strict=True)
        return np.asarray(value(tuple(a + s[0] * t for a, t in pairs), rest))

    expected = central_difference(along, np.zeros(1), eps=1e-6)[..., 0]
    # Values of order one: rounding 1e-16 / 1e-6, and h^2 f'''.
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-8)
    assert np.abs(expected).max() > 0.1


@pytest.mark.parametrize(("anchor", "bounds"), CASES)
def test_forward_is_the_transpose_of_reverse(anchor, bounds):
    args, rest = arguments(anchor, bounds)
    tangents = tuple(normal(*a.shape, seed=n) for n, a in enumerate(args))
    y, pushed = forward(args, tangents, rest)
    cotangent = normal(*y.shape, seed=9)
    pulled = reverse(args, cotangent, rest)
    inner = sum(np.sum(a * b) for a, b in zip(pulled, tangents, strict=True))
    # Both are sums of some hundred products of order one.
    np.testing.assert_allclose(np.sum(cotangent * pushed), inner, rtol=1e-11)


@pytest.mark.parametrize(("anchor", "bounds"), CASES)
def test_gradient_is_that_of_autodiff_through_an_explicit_scan(anchor, bounds):
    args, rest = arguments(anchor, bounds)
    target = normal(TIME, OUTPUTS, seed=8)
    ours, theirs = (gradient(args, target, rest, f) for f in (scored, through_scan))
    for a, b in zip(ours, theirs, strict=True):
        # Gradients of order ten by two orders of summation.
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-11)


def test_a_limited_sample_has_no_derivative():
    args, rest = arguments(ANCHORS["one"], TIGHT)
    y, tangent = forward(args, tuple(np.ones_like(a) for a in args), rest)
    y, tangent = np.asarray(y)[DEPTH:], np.asarray(tangent)[DEPTH:]
    at_border = (y == TIGHT[0]) | (y == TIGHT[1])
    assert at_border.any()
    np.testing.assert_array_equal(tangent[at_border], 0.0)
    assert np.all(tangent[~at_border] != 0.0)


# its parts ------------------------------------------------------------------------


history = jax.jit(partial(past_outputs, depth=DEPTH))


def test_history_is_newest_first():
    y = np.random.default_rng(0).normal(size=(6, OUTPUTS))
    found = np.asarray(history(y))
    for t in range(DEPTH, 6):
        for d in range(DEPTH):
            np.testing.assert_array_equal(found[t, :, d], y[t - 1 - d])
    np.testing.assert_array_equal(found[0], np.tile(y[0][:, None], (1, DEPTH)))


def test_run_history_is_simulated_since_the_anchor_and_measured_before():
    anchor = ANCHORS["several"]
    rng = np.random.default_rng(1)
    y, measured = (rng.normal(size=(TIME, OUTPUTS)) for _ in range(2))
    found = np.asarray(jax.jit(run_history)(y, history(measured), anchor))
    own = np.asarray(jax.jit(partial(own_history, depth=DEPTH))(anchor))
    for t in range(3, TIME):
        last = max(a for a in (3, 10, 11, 25) if a <= t)
        for d in range(DEPTH):
            simulated = t - 1 - d >= last
            assert own[t, d] == simulated
            expected = (y if simulated else measured)[t - 1 - d]
            np.testing.assert_array_equal(found[t, :, d], expected)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_linear_recurrence_solves_the_dense_triangular_system(shape):
    time = 12
    rng = np.random.default_rng(3)
    a = 0.4 * rng.normal(size=(time, OUTPUTS, OUTPUTS, DEPTH))
    d = rng.normal(size=(time, OUTPUTS, *shape))
    start = rng.normal(size=(DEPTH, OUTPUTS, *shape))

    # Unknowns are S of all samples; known ones before the start go to the right.
    size = time * OUTPUTS
    matrix, right = np.eye(size), d.reshape(size, -1).copy()
    for t in range(time):
        rows = slice(t * OUTPUTS, (t + 1) * OUTPUTS)
        for k in range(DEPTH):
            if t - 1 - k >= 0:
                columns = slice((t - 1 - k) * OUTPUTS, (t - k) * OUTPUTS)
                matrix[rows, columns] -= a[t, :, :, k]
            else:
                right[rows] += a[t, :, :, k] @ start[k - t].reshape(OUTPUTS, -1)
    expected = np.linalg.solve(matrix, right).reshape(d.shape)

    end, found = jax.jit(linear_recurrence)(a, d, start)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(end, expected[::-1][:DEPTH], rtol=0, atol=1e-11)


# polynomial steps -----------------------------------------------------------------


@pytest.mark.parametrize("copies", [1, 40], ids=["written out", "gathered"])
def test_polynomial_step_is_its_sum(copies):
    # Both forms: the table repeated forty times has too many products to write out.
    table = np.array([[0, 0], [0, 1], [0, 3], [1, 2], [2, 2], [3, 3]])
    output, lag = np.array([0, 1, 0]), np.array([0, 2, 1])
    rng = np.random.default_rng(5)
    g = rng.normal(size=(OUTPUTS, copies * len(table)))
    history = rng.normal(size=(OUTPUTS, DEPTH))
    polynomial = polynomial_step(
        np.tile(table, (copies, 1)), np.tile(output, (OUTPUTS, 1)), lag
    )
    found, slope = jax.jit(
        lambda g, h: (
            polynomial(None, g, h),
            jax.jacfwd(lambda h: polynomial(None, g, h))(h),
        )
    )(g, history)

    def plain(h):
        x = np.array([1.0, *h[output, lag]])
        return g.reshape(OUTPUTS, copies, -1).sum(axis=1) @ np.prod(x[table], axis=1)

    np.testing.assert_allclose(found, plain(history), rtol=1e-12)
    expected = central_difference(
        lambda h: plain(h.reshape(history.shape)), history.ravel(), eps=1e-5
    )
    # Quadratic: central differences are exact but for rounding, 1e-14 / 1e-5.
    np.testing.assert_allclose(
        np.reshape(slope, (OUTPUTS, -1)), expected, rtol=1e-8, atol=1e-8
    )


@pytest.mark.parametrize("unroll", [2, 3, 8])
def test_unrolling_changes_nothing(unroll):
    args, (anchor, lower, upper) = arguments(ANCHORS["several"], TIGHT)
    unrolled = partial(free_run, step, depth=DEPTH, unroll=unroll)
    y = np.asarray(jax.jit(unrolled)(*args, anchor, lower, upper))
    expected = run(problem(ANCHORS["several"]), TIGHT)
    # Another arrangement of the same sums.
    np.testing.assert_allclose(y[3:], expected[3:], rtol=0, atol=1e-15)
