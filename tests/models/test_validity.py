"""Validity functions other than Gaussians: weights, their sum, ends, derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.contracts import validity
from jaxnarx.models import (
    AdditiveGates,
    Boxes,
    Compact,
    GateProducts,
    Gaussians,
    LogSigmoids,
)

weights = eqx.filter_jit(lambda f, z, active: f(z, active))

GRID = [(a, b) for a in (0.0, 0.3, 0.7) for b in (0.0, 0.5)]
LOW = np.array(GRID)
HIGH = np.array([({0.0: 0.3, 0.3: 0.7, 0.7: 1.0}[a], b + 0.5) for a, b in GRID])
"""Six boxes that tile the unit square."""
BORDERS = np.array([0.2, 0.45, 0.8])
"""Of four regions of one variable."""


def array(values) -> jax.Array:
    """Of a list or of numpy, without a program for its shape."""
    return jax.device_put(np.asarray(values))


def compact(margin: float = 0.08) -> Compact:
    return Compact(array(LOW), array(HIGH), array(np.full((6, 2), np.log(margin))))


def sigmoids(steepness: float = 30.0) -> LogSigmoids:
    return LogSigmoids(array(BORDERS), array(np.log(steepness)))


SHAPES = {
    "boxes": (Boxes(array(LOW), array(HIGH)), 2, 6),
    "compact": (compact(), 2, 6),
    "log-sigmoids": (sigmoids(), 1, 4),
    "steep log-sigmoids": (sigmoids(1e5), 1, 4),
    "additive gates": (
        AdditiveGates(array([[3.0, -2.0], [0.0, 5.0]]), array([0.4, 2.0])),
        2,
        3,
    ),
    "products of gates": (
        GateProducts(
            *(array([[3.0, -2.0], [0.0, 1.0]]), array([0.4, 0.6]), array([1.0, 2.0])),
            jax.device_put(np.array([[0, 0], [1, 0], [-1, 1]], np.int32)),
        ),
        2,
        3,
    ),
}


STEEP = ("steep log-sigmoids", validity.derivatives_are_central_differences)
"""Differences over steps of 1e-6 say nothing of slopes of 1e5."""
HELD = [
    (n, c) for n in SHAPES for c in validity.CHECKS_WITHOUT_NETWORK if (n, c) != STEEP
]


@pytest.mark.parametrize(("name", "check"), HELD)
def test_a_validity_function_holds_to_its_contract(name, check):
    f, dims, _ = SHAPES[name]
    check(f, dims)


# one variable ---------------------------------------------------------------------


def test_log_sigmoids_with_borders_that_fall_are_refused():
    with pytest.raises(ValueError, match=r"borders .* must rise, got \[0.8, 0.2\]"):
        LogSigmoids(array([0.8, 0.2]), array(1.0))


def test_log_sigmoids_are_one_half_at_every_border():
    f = sigmoids(200.0)
    phi = np.asarray(weights(f, array(BORDERS[None]), array(np.ones(4, bool))))
    for border in range(3):
        # The next border is at least 0.25 away: exp(-50) is the most it adds.
        pair = phi[border : border + 2, border]
        np.testing.assert_allclose(pair, 0.5, rtol=0, atol=1e-12)


def test_log_sigmoids_go_on_beyond_the_training_range():
    ends = array([[-1e6, 1e6]])
    phi = np.asarray(weights(sigmoids(), ends, array(np.ones(4, bool))))
    np.testing.assert_array_equal(phi, [[1, 0], [0, 0], [0, 0], [0, 1]])


def test_log_sigmoids_follow_the_formula():
    z = np.linspace(-0.5, 1.5, 41)
    gates = 1 / (1 + np.exp(-30.0 * (z[None] - BORDERS[:, None])))
    steps = np.vstack([np.ones(41), gates, np.zeros(41)])
    expected = steps[:-1] - steps[1:]
    phi = weights(sigmoids(), array(z[None]), array(np.ones(4, bool)))
    np.testing.assert_allclose(phi, expected, rtol=0, atol=1e-14)


def test_limits_keep_the_borders_in_order():
    low, high = sigmoids().limits((0.5, 2.0))
    np.testing.assert_allclose(low.border, [0.0, 0.325, 0.625], atol=1e-15)
    np.testing.assert_allclose(high.border, [0.325, 0.625, 1.0], atol=1e-15)
    np.testing.assert_allclose(np.exp(low.log_steepness), 15.0, rtol=1e-14)
    np.testing.assert_allclose(np.exp(high.log_steepness), 60.0, rtol=1e-14)


# boxes ----------------------------------------------------------------------------


def test_boxes_are_indicators_and_outside_the_nearest_one_speaks():
    f, _, models = SHAPES["boxes"]
    z = np.random.default_rng(2).uniform(-1, 2, size=(2, 400))
    phi = np.asarray(weights(f, array(z), array(np.ones(models, bool))))
    held = np.clip(z, 0.0, 1.0 - 1e-12).T[:, None]
    inside = np.all((held >= LOW) & (held < HIGH), axis=2)
    outside = np.any((z < 0) | (z > 1), axis=0)
    np.testing.assert_array_equal(phi.T[~outside], inside[~outside])
    assert set(np.unique(phi)) == {0.0, 1.0}
    away = np.maximum(np.maximum(LOW - z.T[:, None], z.T[:, None] - HIGH), 0).max(
        axis=2
    )
    chosen = away[np.arange(400), phi.argmax(axis=0)]
    np.testing.assert_array_equal(chosen, away.min(axis=1))


# bounded support ------------------------------------------------------------------


def test_compact_curves_end_at_their_bounds():
    margin = 0.08
    z = np.random.default_rng(3).uniform(size=(2, 600))
    phi = np.asarray(weights(compact(margin), array(z), array(np.ones(6, bool))))
    away = np.maximum(LOW - z.T[:, None], z.T[:, None] - HIGH).max(axis=2)
    beyond, within = away >= margin, away <= -margin
    np.testing.assert_array_equal(phi.T[beyond], 0.0)
    # Where one curve is whole all others have ended: borders are shared.
    np.testing.assert_allclose(phi.T[within], 1.0, rtol=0, atol=1e-15)
    assert beyond.any() and within.any() and np.any((phi > 0.1) & (phi < 0.9))


def test_compact_curves_do_not_reactivate():
    # DESIGN section 5: the wide Gaussian of two has weight one again at 0.9.
    at = array([[0.2, 0.9]])
    low, high = array([[0.0], [0.35]]), array([[0.35], [1.0]])
    f = Compact(low, high, array(np.log([[0.2], [0.05]])))
    g = Gaussians(array([[0.2], [0.5]]), array(np.log([[0.2], [0.05]])))
    both = array(np.ones(2, bool))
    np.testing.assert_allclose(weights(g, at, both)[0], [1.0, 1.0], atol=1e-6)
    # One curve over itself: a rounding error of one.
    np.testing.assert_allclose(weights(f, at, both)[0], [1.0, 0.0], rtol=1e-15)


def test_a_gap_between_compact_curves_belongs_to_the_nearest():
    low, high = array([[0.0], [0.8]]), array([[0.2], [1.0]])
    f = Compact(low, high, array(np.full((2, 1), np.log(0.05))))
    z = array([[0.3, 0.45, 0.55, 0.7]])
    phi = weights(f, z, array(np.ones(2, bool)))
    np.testing.assert_array_equal(phi[0], [1.0, 1.0, 0.0, 0.0])
    both = array(np.ones(2, bool))
    slope = jax.jit(jax.grad(lambda f: jnp.sum(f(z, both)[0])))(f)
    for leaf in jax.tree.leaves(slope):
        np.testing.assert_array_equal(leaf, 0.0)


# files and words ------------------------------------------------------------------


def test_sizes_of_a_file_are_checked():
    with pytest.raises(ValueError, match="border is"):
        sigmoids().check(5, 1)
    with pytest.raises(ValueError, match="one variable, not 2"):
        sigmoids().check(4, 2)
    with pytest.raises(ValueError, match="low is"):
        compact().check(5, 2)
    for f, dims, models in SHAPES.values():
        f.check(models, dims)


def test_regions_are_told_in_physical_units():
    offset, span = np.array([1000.0]), np.array([2000.0])
    found = sigmoids().regions(["speed[t]"], offset, span)
    assert found == [
        {"speed[t]": {"below": pytest.approx(1400.0)}},
        {"speed[t]": {"above": pytest.approx(1400), "below": pytest.approx(1900)}},
        {"speed[t]": {"above": pytest.approx(1900), "below": pytest.approx(2600)}},
        {"speed[t]": {"above": pytest.approx(2600.0)}},
    ]
    names, two = ["speed[t]", "load[t]"], np.array([2000.0, 1.0])
    (first, *_) = compact().regions(names, np.array([1000.0, 0.0]), two)
    assert first == {
        "speed[t]": {"above": 1000.0, "below": pytest.approx(1600)},
        "load[t]": {"above": 0.0, "below": 0.5},
    }
