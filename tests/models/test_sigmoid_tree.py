"""Trees of sigmoid gates: weights, their slopes, and what is said about a leaf."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tree_oracles
from common import device

from jaxnarx.models import AbstractValidity, SigmoidTree

MODELS, DIMS, SPARE = 5, 2, 3
PATH = [[1, 1, 0, 0], [-1, 0, 1, 1], [1, -1, 0, 0], [-1, 0, -1, 0], [-1, 0, 1, -1]]
"""Gate 0 at the root, 1 on its upper side, 2 on its lower, 3 on the upper of 2."""

weights = jax.jit(lambda shape, z, on: shape(z, on))
unit = jax.jit(lambda shape: shape.unit())


def of(direction, border, log_steepness, path) -> SigmoidTree:
    """A tree of numbers."""
    d, b, a = (np.asarray(x, float) for x in (direction, border, log_steepness))
    return SigmoidTree(device(d), device(b), device(a), device(np.asarray(path, int)))


def gates(seed: int = 0):
    """Directions of any length, borders that cross the range, moderate steepness."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(4, DIMS)) * np.array([[0.1], [1.0], [7.0], [2.0]])
    return direction, rng.uniform(-0.5, 0.5, size=4), rng.uniform(0.5, 2.5, size=4)


def tree(seed: int = 0, spare: int = 0) -> SigmoidTree:
    """With `spare` gates and leaves that hold numbers that must not matter."""
    direction, border, log_steepness = gates(seed)
    rng = np.random.default_rng(9)
    path = np.zeros((MODELS + spare, 4 + spare), int)
    path[:MODELS, :4] = PATH
    path[MODELS:] = rng.integers(-1, 2, size=(spare, 4 + spare))
    unused = np.zeros((spare, DIMS)), rng.normal(size=spare), np.full(spare, 5.0)
    if spare:
        # an unused gate may hold a direction too
        unused[0][-1] = 3.0
    fields = zip((direction, border, log_steepness), unused, strict=True)
    direction, border, log_steepness = (np.concatenate(pair) for pair in fields)
    return of(direction, border, log_steepness, path)


def active(spare: int = 0) -> jax.Array:
    return device(np.arange(MODELS + spare) < MODELS)


def points(rows: int = 60, seed: int = 1) -> np.ndarray:
    """Inside the range, around it, and a thousand times as far."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(-1, 2, size=(DIMS, rows))
    z[:, rows // 2 :] = 1e3 * rng.normal(size=(DIMS, rows - rows // 2))
    return z


def plain(seed: int, z: np.ndarray) -> np.ndarray:
    direction, border, log_steepness = gates(seed)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    parts = [
        tree_oracles.Gate(d, b, float(np.exp(a)))
        for d, b, a in zip(unit, border, log_steepness, strict=True)
    ]
    leaves = [[(parts[g], s) for g, s in enumerate(row) if s] for row in PATH]
    return np.stack([tree_oracles.leaf_validity(z.T, leaf) for leaf in leaves])


def test_weights_are_products_of_gates_and_sum_to_one_everywhere():
    for seed in range(3):
        phi = weights(tree(seed), points(), active())
        assert np.all(np.isfinite(phi)) and np.all(phi >= 0)
        np.testing.assert_allclose(np.sum(phi, axis=0), 1.0, rtol=0, atol=1e-12)
        np.testing.assert_allclose(phi, plain(seed, points()), rtol=1e-10, atol=1e-15)


def test_far_away_nearly_every_point_has_one_leaf():
    # Unless it lies along a border.
    phi = np.asarray(weights(tree(), points(), active()))[:, 30:]
    assert np.mean(phi.max(axis=0) > 1 - 1e-9) > 0.9


def test_axis_gates_divide_one_variable():
    gate = of([[0.0, 2.0]], [0.3], [1.5], [[1], [-1]])
    z, on = np.array([[-5.0, 0.2, 9.0], [0.3, 0.3, 0.3]]), np.ones(2, bool)
    # One half at the border, wherever the other variable is; odd about it.
    np.testing.assert_allclose(weights(gate, z, on), 0.5, rtol=1e-14)
    away = np.array([[0.0], [0.17]])
    above, below = (np.asarray(weights(gate, z + s * away, on)) for s in (1, -1))
    np.testing.assert_allclose(above[0], below[1], rtol=1e-13)
    expected = 1 / (1 + np.exp(-np.exp(1.5) * 0.17))
    np.testing.assert_allclose(above[0], expected, rtol=1e-13)


def test_steep_gates_are_a_partition_in_pieces_and_flat_ones_none():
    shape, z = tree(), points()
    steep = of(shape.direction, shape.border, np.full(4, 60.0), shape.path)
    phi = np.asarray(weights(steep, z, active()))
    np.testing.assert_allclose(np.sort(phi, axis=0)[-1], 1.0, rtol=1e-12)
    side = np.asarray(unit(shape)) @ z > np.asarray(shape.border)[:, None]
    for m, row in enumerate(PATH):
        inside = [side[g] == (s > 0) for g, s in enumerate(row) if s]
        np.testing.assert_array_equal(phi[m] > 0.5, np.all(inside, axis=0))
    flat = of(shape.direction, shape.border, np.full(4, -60.0), shape.path)
    depth = np.count_nonzero(PATH, axis=1)
    expected = np.broadcast_to(0.5 ** depth[:, None], phi.shape)
    np.testing.assert_allclose(weights(flat, z, active()), expected, rtol=1e-12)


def test_only_the_direction_of_a_direction_matters():
    shape, z = tree(), points()
    longer = of(
        *(np.asarray(shape.direction) * 1e6, shape.border),
        *(shape.log_steepness, shape.path),
    )
    phi, same = (weights(one, z, active()) for one in (shape, longer))
    np.testing.assert_allclose(same, phi, rtol=1e-9)
    np.testing.assert_allclose(np.sum(unit(shape) ** 2, axis=1), 1.0, rtol=1e-14)
    nowhere = np.asarray(unit(tree(spare=SPARE)))[4:-1]
    np.testing.assert_array_equal(nowhere, 0.0)


def test_spare_leaves_and_gates_weigh_nothing():
    bare = weights(tree(), points(), active())
    padded = np.asarray(weights(tree(spare=SPARE), points(), active(SPARE)))
    np.testing.assert_array_equal(padded[MODELS:], 0.0)
    np.testing.assert_allclose(padded[:MODELS], bare, rtol=1e-14)


def score(shape: AbstractValidity, z: jax.Array, on: jax.Array) -> jax.Array:
    return jnp.sum(shape(z, on) * jnp.cos(jnp.arange(on.shape[0]))[:, None])


@pytest.mark.parametrize("spare", [0, SPARE])
def test_slopes(spare):
    shape, on = tree(spare=spare), active(spare)
    z = device(points()[:, :20])

    def at(values):
        return score(shape.replace_parameters(values), z, on)

    found, slow = jax.jit(jax.grad(at))(shape.parameters), jax.jit(at)
    values = [np.asarray(v) for v in shape.parameters]
    for n, value in enumerate(values):
        gradient = np.asarray(found[n])
        for k in np.ndindex(value.shape):
            # A step in proportion to a direction's own length.
            size = float(np.linalg.norm(value[k[0]])) if n == 0 else 1.0
            step = 1e-5 * max(size, 0.1)
            move = np.zeros(value.shape)
            move[k] = step
            ends = [
                float(slow([v + s * move if v is value else v for v in values]))
                for s in (1, -1)
            ]
            slope = (ends[0] - ends[1]) / (2 * step)
            # Rounding, 1e-15 over the step, and the square of the step.
            assert gradient[k] == pytest.approx(slope, rel=1e-6, abs=1e-7)
        if spare:
            np.testing.assert_array_equal(gradient[4:], 0.0)


def test_slopes_are_finite_far_away_and_for_stiff_gates():
    shape, on = tree(spare=SPARE), active(SPARE)
    stiffness = np.asarray(shape.log_steepness) + 40
    stiff = of(shape.direction, shape.border, stiffness, shape.path)
    slope = jax.jit(
        lambda v, z: jax.grad(lambda v: score(shape.replace_parameters(v), z, on))(v)
    )
    for one in (shape, stiff):
        for leaf in slope(one.parameters, 1e3 * points()):
            assert np.all(np.isfinite(leaf))


def test_limits_hold_the_present_and_the_range():
    shape = tree()
    low, high = shape.limits((0.5, 2.0))
    for a, now, b in zip(
        low.parameters, shape.parameters, high.parameters, strict=True
    ):
        assert np.all(np.less(a, now)) and np.all(np.less(now, b))
    # Twice as wide is half as steep.
    np.testing.assert_allclose(
        np.subtract(high.log_steepness, low.log_steepness), np.log(4), rtol=1e-12
    )
    corners = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    seen = corners @ np.asarray(unit(shape)).T
    assert np.all(np.asarray(low.border) <= seen.min(axis=0) + 1e-12)
    assert np.all(np.asarray(high.border) >= seen.max(axis=0) - 1e-12)


NAMES, OFFSET, SPAN = (
    ("n[t]", "q[t]"),
    np.array([1000.0, 5.0]),
    np.array([4000.0, 20.0]),
)


def test_regions_say_in_physical_units_where_a_leaf_lies():
    shape = of(
        [[1.0, 0.0], [0.0, -3.0], [3.0, -4.0]],
        [0.25, -0.5, 0.0],
        np.zeros(3),
        [[1, 1, 0], [-1, 0, 1], [1, -1, 0], [-1, 0, -1]],
    )
    # n = 1000 + 4000/4; q below its middle is above in -q; 3 z1 > 4 z2 is
    # 3 (n - 1000)/4000 > 4 (q - 5)/20, that is q - 0.00375 n < 1.25.
    bend, at = "-0.00375 n[t] + q[t]", pytest.approx(1.25, rel=1e-12)
    assert shape.regions(NAMES, OFFSET, SPAN) == [
        {"n[t]": {"above": 2000.0}, "q[t]": {"below": 15.0}},
        {"n[t]": {"below": 2000.0}, bend: {"below": at}},
        {"n[t]": {"above": 2000.0}, "q[t]": {"above": 15.0}},
        {"n[t]": {"below": 2000.0}, bend: {"above": at}},
    ]


def test_the_tightest_of_several_gates_is_said():
    two = [[1.0, 0.0], [1.0, 0.0]]
    shape = of(two, [0.25, 0.5], np.zeros(2), [[1, 1], [-1, 0], [1, -1]])
    above, below, between = shape.regions(NAMES, OFFSET, SPAN)
    assert above == {"n[t]": {"above": 3000.0}}
    assert below == {"n[t]": {"below": 2000.0}}
    assert between == {"n[t]": {"above": 2000.0, "below": 3000.0}}


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("direction", np.zeros((3, DIMS)), "direction"),
        ("border", np.zeros(3), "direction"),
        ("log_steepness", np.zeros((4, 1)), "log_steepness"),
        ("path", np.full((MODELS, 4), 2), "-1, 0 and 1"),
        ("path", np.zeros((MODELS, 5), int), "path"),
    ],
)
def test_fields_that_do_not_fit_are_refused(field, value, message):
    shape = tree()
    shape.check(MODELS, DIMS)
    # As a file would fill it, past the shapes of the constructor.
    object.__setattr__(shape, field, device(value))
    with pytest.raises(ValueError, match=message):
        shape.check(MODELS, DIMS)
