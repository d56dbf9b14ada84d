"""Stability: poles and norms with known answers, bounds that must hold for any run."""

import itertools
from functools import cache

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from common import VARIABLES, A, Part

from jaxnarx.data.batch import stack_records
from jaxnarx.errors import DataError
from jaxnarx.models import Network, general_step
from jaxnarx.refinement._stability import (
    find_metric,
    first_horizon,
    largest_local_pole,
    penalty,
    penalty_points,
    penalty_residuals,
    slowest,
    stability,
)
from jaxnarx.refinement._stability.bound import ALL_WORDS, RUN_WORDS
from jaxnarx.refinement._stability.hull import hull, power, product
from jaxnarx.refinement._stability.norm import contracting_norm, norms
from jaxnarx.refinement._stability.points import choose_points, companion, jacobians
from jaxnarx.refinement.layout import make_layout
from jaxnarx.simulation import first_anchor, make_drive, make_masks, run

LENGTHS = (150, 120, 140)


@cache
def data():
    return common.dataset(LENGTHS)


def prepared(net: Network):
    batch = stack_records(data())
    return make_drive(net, batch), make_masks(net, batch)


def pair(
    first: tuple[float, float], second: tuple[float, float] | None = None, bound=1e6
) -> Network:
    """y = a1 y[t-1] + a2 y[t-2] + 0.1 a, one (a1, a2) for low inputs, one for high."""
    models = [
        [((0, 1), 0.1), ((0, 3), a1), ((0, 4), a2)]
        for a1, a2 in (first, second or first)
    ]
    part = Part(
        models,
        scheduling=((A, 0),),
        offset=(-4.0,),
        span=(8.0,),
        centre=((0.45,), (0.55,)),
        width=((0.01,), (0.01,)),
    )
    return common.network([part], bound=bound, variables=VARIABLES[:4])


def from_poles(radius: float, angle: float) -> tuple[float, float]:
    """Coefficients of a complex pair radius exp(+-i angle)."""
    return 2 * radius * np.cos(angle), -(radius**2)


# the norm -------------------------------------------------------------------------


@pytest.mark.parametrize("n", [2, 5])
def test_the_norm_of_scaled_rotations_is_found(n):
    # Each is 0.9 times a rotation in one hidden norm: no norm does better than 0.9.
    rng = np.random.default_rng(n)
    hidden = np.triu(rng.normal(size=(n, n))) + 2 * np.eye(n)
    turns = np.linalg.qr(rng.normal(size=(300, n, n)))[0]
    m = 0.9 * np.linalg.inv(hidden) @ turns @ hidden
    assert norms(np.eye(n), m).max() > 1
    rate = norms(contracting_norm(m), m).max()
    # The ridge gives up 1e-4 of log cond, the search 2 % of 1 - rate.
    assert 0.9 - 1e-9 <= rate < 0.9 + 0.003


def test_norms_of_matrices_are_spectral_and_survive_what_is_not_finite():
    rng = np.random.default_rng(0)
    m, l = rng.normal(size=(5, 3, 3)), np.triu(rng.normal(size=(3, 3)) + 3)  # noqa: E741
    expected = np.linalg.norm(l @ m @ np.linalg.inv(l), 2, axis=(1, 2))
    np.testing.assert_allclose(norms(l, m), expected, rtol=1e-9)
    m[2, 0, 0] = np.nan
    assert np.isinf(norms(l, m)[2])
    assert np.isfinite(contracting_norm(m)).all()


def test_nilpotent_and_zero_matrices_need_no_norm_without_end():
    shift = np.eye(3, k=-1)[None]
    l = contracting_norm(np.concatenate([shift, shift]))  # noqa: E741
    assert norms(l, shift)[0] < 0.12 and np.linalg.cond(l) < 150
    np.testing.assert_array_equal(contracting_norm(0 * shift), np.eye(3))


# poles ----------------------------------------------------------------------------


@pytest.mark.parametrize("radius", [0.5, 0.95])
def test_the_poles_of_linear_models_are_known(radius):
    other = (0.5 + 0.2, -0.5 * 0.2)  # poles 0.5 and 0.2
    value = stability(pair(from_poles(radius, 0.7), other), data()).value
    first, second, whole = value.poles
    for row, modulus in ((first, radius), (second, 0.5)):
        figures = (row.median, row.high, row.largest)
        np.testing.assert_allclose(figures, modulus, rtol=1e-7)
        assert row.unstable == 0 and row.output == "y"
        # Sampled at 0.1 s.
        np.testing.assert_allclose(row.time_constant, -0.1 / np.log(modulus), rtol=1e-6)
    assert (first.model, second.model, whole.model) == (1, 2, None)
    assert 0.5 - 1e-9 < whole.median and whole.largest < radius + 1e-9
    assert str(value).count("\n") > 5 and value.summary in str(value)


@pytest.mark.parametrize("radius", [0.5, 1.019])
def test_the_largest_local_pole_is_seen_without_records(radius):
    found = largest_local_pole(pair(from_poles(radius, 0.7), (0.4, 0.0)))
    np.testing.assert_allclose(found, radius, rtol=1e-7)
    spare = {"spare_models": 1, "spare_slots": 1}
    plain = largest_local_pole(common.named("by inputs"))
    assert largest_local_pole(common.named("by inputs", **spare)) == plain > 0


def test_padding_has_no_poles():
    plain, spare = (
        stability(common.named("by inputs", **extra), data(), samples=150).value
        for extra in ({}, {"spare_models": 1, "spare_slots": 1})
    )
    for a, b in zip(plain.poles, spare.poles, strict=True):
        assert (a.model, a.samples) == (b.model, b.samples)
        np.testing.assert_allclose(
            (a.median, a.high, a.largest), (b.median, b.high, b.largest), rtol=1e-9
        )


def test_unstable_models_are_told_with_place_and_status():
    net = pair((1.5, 0.0), (0.9, 0.0), bound=20.0)
    solution = stability(net, data())
    assert solution.status_name == "diverged" and solution.channel == "y"
    value = solution.value
    assert value.poles[0].unstable == 1 and np.isinf(value.poles[0].time_constant)
    bound = value.bound
    assert not value.contracts and bound.rate >= 1.5 - 1e-9
    assert np.isinf(value.time_constant)
    # It fails where the first model leads, and there only.
    low, high = bound.region["a[t]"]
    assert low < high < 0.2
    assert bound.worst.record in data().names and bound.worst.scheduling["a[t]"] < 0.2
    assert bound.worst.time == pytest.approx(0.1 * bound.worst.step)
    below = np.concatenate([r.u[2:, 0] < 0 for r in data()])
    assert bound.fails == pytest.approx(below.mean(), abs=0.03)
    assert "No contraction bound" in value.summary and "a[t]" in value.summary


# bounds ---------------------------------------------------------------------------


@pytest.mark.parametrize(("radius", "angle"), [(0.6, 0.4), (0.9, 0.3), (0.3, 1.0)])
def test_the_bound_of_a_linear_model_is_its_pole(radius, angle):
    a1, a2 = from_poles(radius, angle)
    value = stability(pair((a1, a2)), data(), samples=200).value
    assert value.contracts and value.bound.kind == ALL_WORDS
    assert (value.bound.samples, value.bound.of) == (200, sum(LENGTHS) - 6)
    # Limits at arbitrary times leave a common quadratic norm where Re H < 1 on the unit
    # circle, and only there (circle criterion, by the Kalman-Yakubovich-Popov lemma).
    z = np.exp(-1j * np.linspace(0, np.pi, 2000))
    crossing = np.max((a1 * z + a2 * z**2).real)
    assert abs(crossing - 1) > 0.05
    assert value.bound.limits == (crossing < 1)
    assert value.bound.rate >= radius - 1e-9
    if not value.bound.limits:
        # The ridge's price, and 2 % of 1 - rate.
        assert value.bound.rate < radius + 0.01


def test_two_stable_models_that_switch_into_instability_get_no_bound():
    first, second = (1.8, -0.9), (-1.8, -0.9)
    m = [companion(np.array(a).reshape(1, 1, 1, 2))[0] for a in (first, second)]
    product_radius = np.abs(np.linalg.eigvals(m[0] @ m[1])).max() ** 0.5
    assert product_radius > 1.5
    value = stability(pair(first, second, bound=50.0), data()).value
    assert max(row.largest for row in value.poles[:2]) < 1
    # No norm can be below the growth of the product.
    assert not value.contracts and value.bound.rate >= product_radius - 1e-9


def test_models_affine_in_their_outputs_are_proven_for_any_bound():
    nets = [pair((0.6, 0.1), (0.3, -0.3), bound) for bound in (1.0, 1e6)]
    rates = [stability(net, data()).value.bound for net in nets]
    assert rates[0].kind == rates[1].kind == ALL_WORDS
    assert rates[0].rate == pytest.approx(rates[1].rate, rel=1e-9)


def worst_ratio(net: Network, bound) -> float:
    """Over random pairs of runs: largest distance over what the bound allows."""
    drive, masks = prepared(net)
    rng = np.random.default_rng(1)
    runs = []
    for _ in range(2):
        start = rng.uniform(-1, 1, drive.measured.shape) * np.asarray(net.upper)
        other = eqx.tree_at(lambda d: d.measured, drive, jnp.asarray(start))
        y = np.array(run(net, other, jnp.asarray(first_anchor(masks))))
        for n, first in enumerate(masks.start):
            y[n, :first] = start[n, :first]
        runs.append(y)
    distance = runs[0] - runs[1]
    ratios = []
    for n, first in enumerate(masks.start):
        d = distance[n, first - 2 : LENGTHS[n]]
        state = np.sqrt(np.sum(d[1:] ** 2 + d[:-1] ** 2, axis=1))
        allowed = bound.overshoot * bound.rate ** np.arange(len(state)) * state[0]
        # Once the distance is rounding error the bound means nothing.
        ratios.append(np.max((state / allowed)[allowed > 1e-12]))
    return max(ratios)


@pytest.mark.parametrize("kind", ["by inputs", "coupled"])
def test_any_two_runs_approach_each_other_as_proven(kind):
    net = common.named(kind, bound=1.0)
    solution = stability(net, data())
    bound = solution.value.bound
    assert bound.kind == ALL_WORDS and bound.holds and bound.limits
    assert bound.average <= bound.rate < 1 <= bound.overshoot
    assert worst_ratio(net, bound) <= 1
    # The limits do act.
    y = np.asarray(run(net, *_free(net)))
    assert np.mean(np.abs(y) >= 1) > 0.005


def _free(net: Network):
    drive, masks = prepared(net)
    return drive, jnp.asarray(first_anchor(masks))


def test_a_bound_that_needs_the_run_says_so():
    # Wide limits: the products of lagged outputs are then unstable somewhere.
    value = stability(common.named("by inputs", bound=50.0), data()).value
    assert value.contracts and value.bound.kind == RUN_WORDS
    assert RUN_WORDS in value.summary
    # Scheduled on its own output: never more than sampled.
    own = stability(common.named("by own output", bound=1.0), data()).value
    assert {b.kind for b in own.bounds} == {RUN_WORDS}


def test_a_model_without_feedback_forgets_at_once():
    part = Part([[((0, 1), 1.0), ((1, 2), 0.5)]])
    net = common.network([part], variables=VARIABLES[:4])
    value = stability(net, data(), samples=150).value
    assert value.contracts and value.bound.rate == 0 and value.time_constant == 0
    assert value.poles[0].largest == 0
    assert value.summary.startswith("Feeds no output back")


# linearisation --------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["coupled", "by own output"])
def test_jacobians_are_those_of_the_general_step(kind):
    net = common.named(kind)
    points = choose_points(net, *prepared(net), count=60)
    step, params = general_step(net), eqx.filter(net, eqx.is_array)
    drive = (points.v.T, tuple(x.T for x in points.x))
    slope = jax.jit(jax.vmap(jax.jacfwd(lambda h, d: step(params, d, h))))
    expected = slope(points.history, drive)
    np.testing.assert_allclose(jacobians(net, points), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ["coupled", "by inputs"])
def test_the_interval_of_a_holds_every_history_of_the_box(kind):
    net = common.named(kind, bound=1.5)
    points = choose_points(net, *prepared(net), count=60)
    centre, radius = hull(net, points)  # pyright: ignore[reportGeneralTypeIssues]
    corners = itertools.product((-1.5, 1.5), repeat=points.history[0].size)
    boxes = [np.reshape(c, points.history.shape[1:]) for c in corners]
    rng = np.random.default_rng(0)
    boxes += list(rng.uniform(-1.5, 1.5, (5, *points.history.shape[1:])))
    found = []
    for h in boxes:
        moved = jnp.broadcast_to(jnp.asarray(h)[None], points.history.shape)
        at = eqx.tree_at(lambda p: p.history, points, moved)
        found.append(jacobians(net, at))
    low, high = np.min(found, axis=0), np.max(found, axis=0)
    # Terms of degree two: slopes are affine, so that each end is some corner's.
    np.testing.assert_allclose(low, centre - radius, rtol=0, atol=1e-12)
    np.testing.assert_allclose(high, centre + radius, rtol=0, atol=1e-12)


def test_intervals_of_powers_and_products():
    assert power(-2.0, 1.0, 0) == (1.0, 1.0)
    assert power(-2.0, 1.0, 2) == (0.0, 4.0)
    assert power(-2.0, 1.0, 3) == (-8.0, 1.0)
    assert power(1.0, 3.0, 2) == (1.0, 9.0)
    assert product((-2.0, 1.0), (3.0, 4.0)) == (-8.0, 4.0)


# the first horizon ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("first", "second", "samples", "horizon"),
    [
        (0.95, 0.5, -1 / np.log(0.95), 19),
        (0.5, 0.5, -1 / np.log(0.5), 5),
        (0.999, 0.5, -1 / np.log(0.999), 148),
        (1.1, 0.95, -1 / np.log(0.95), 10),
        (1.1, 1.2, np.inf, 5),
    ],
)
def test_the_first_horizon_is_the_slowest_time_constant(
    first, second, samples, horizon
):
    net = pair((first, 0.0), (second, 0.0))
    assert slowest(net, *prepared(net)) == pytest.approx(samples, rel=1e-6)
    assert first_horizon(net, *prepared(net)) == horizon


def test_data_without_one_complete_window_are_refused():
    net = pair((0.5, 0.0))
    batch = stack_records(common.from_rows([common.signals(2)]))
    with pytest.raises(DataError, match="stability needs"):
        first_horizon(net, make_drive(net, batch), make_masks(net, batch))


# the penalty ----------------------------------------------------------------------


@cache
def penalised(kind: str):
    net = common.named(kind, spare_models=1, spare_slots=1)
    points = penalty_points(net, *prepared(net), count=40)
    layout = make_layout(net, None, (0.5, 2.0))
    return net, points, layout, find_metric(net, points)


compiled = eqx.filter_jit(penalty_residuals)


@eqx.filter_jit
def forward_jacobian(layout, u, points, metric, target):
    return jax.jacfwd(lambda u: penalty_residuals(layout, u, points, metric, target))(u)


@pytest.mark.parametrize(
    "kind",
    ["by inputs", pytest.param("coupled, by own output", marks=pytest.mark.slow)],
)
def test_penalties_are_hinges_of_the_norm_with_exact_slopes(kind):
    net, points, layout, metric = penalised(kind)
    u = layout.gather(net)
    a = jacobians(net, points)
    parts = [
        (np.asarray(factor), companion(a[:, np.array(g)[:, None], np.array(g)[None]]))
        for g, factor in zip(metric.groups, metric.factor, strict=True)
    ]
    factor = np.concatenate([norms(*part) for part in parts])
    # In the widest gap, so that no residual lies at its hinge.
    order = np.sort(factor)
    at = np.argmax(np.diff(order))
    target = float(order[at : at + 2].mean())
    expected = np.maximum(factor - target, 0)
    args = points, metric, target
    found = compiled(layout, u, *args)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert 0 < np.sum(expected > 0) < len(expected)

    jacobian = np.asarray(forward_jacobian(layout, u, *args))
    assert np.abs(jacobian).max() > 1e-2
    rng, h = np.random.default_rng(0), 1e-6
    for _ in range(4):
        along = jnp.asarray(rng.normal(size=u.shape))
        ends = [np.asarray(compiled(layout, u + s * along, *args)) for s in (h, -h)]
        slope = (ends[0] - ends[1]) / (2 * h)
        # Central differences with h = 1e-6 leave 1e-9 of the slope's own bend.
        np.testing.assert_allclose(jacobian @ along, slope, rtol=1e-5, atol=1e-7)

    value, gradient, gram = penalty(layout, u, *args)
    np.testing.assert_allclose(value, np.sum(expected**2), rtol=1e-9)
    np.testing.assert_allclose(gradient, expected @ jacobian, rtol=0, atol=1e-10)
    np.testing.assert_allclose(gram, jacobian.T @ jacobian, rtol=0, atol=1e-9)


def test_nothing_is_penalised_below_the_target():
    net, points, layout, metric = penalised("by inputs")
    value, gradient, gram = penalty(layout, layout.gather(net), points, metric, 100.0)
    assert value == 0
    assert not np.any(gradient) and not np.any(gram)


def test_descending_the_penalty_stabilises():
    # A pole of 1.05 comes below 0.98 along the Gauss-Newton direction.
    net = pair((1.05, 0.0), (0.5, 0.0))
    points = penalty_points(net, *prepared(net), count=40)
    layout = make_layout(net, None, (0.5, 2.0))
    metric = find_metric(net, points)
    u = layout.gather(net)
    for _ in range(10):
        _, gradient, gram = penalty(layout, u, points, metric, 0.97)
        damped = (
            gram + 1e-3 * jnp.trace(gram) * jnp.eye(len(u)) + 1e-9 * jnp.eye(len(u))
        )
        u = u - jnp.linalg.solve(damped, gradient)
    value = stability(layout.place(u), data()).value
    assert value.poles[-1].largest < 0.98
