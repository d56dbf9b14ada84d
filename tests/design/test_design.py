"""Optimal design: dense algebra, sensitivities, known optima, limits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from common import CHANNELS, PARTS, VARIABLES, compilations, device, named, network

from jaxnarx.design import (
    ResponseSensitivity,
    adjust,
    criteria,
    network_sensitivity,
)
from jaxnarx.design._criteria import objective
from jaxnarx.errors import SpecError
from jaxnarx.excitation import AprbsPlan, aprbs_plan, check_plan, render
from jaxnarx.settings import OptimalDesign
from jaxnarx.settings.tree import from_dict

LENGTH = 240


@eqx.filter_jit
def figures(slope, reference, power=None):
    return criteria(slope, reference, power=power)


@eqx.filter_jit
def shown(sensitivity, plan):
    """What a plan shows, compiled."""
    return sensitivity(render(plan))


def plan_of(key, *, rate=None, length=LENGTH) -> AprbsPlan:
    """A plan for the two inputs of the shared networks."""
    spans = {"a": (-3.0, 3.0), "b": (-0.8, 0.8)}
    return aprbs_plan(key, length, inputs=spans, hold=(6, 20), rate=rate, shorten=True)


def quadratic(p, u):
    """y = p_0 + p_1 u + p_2 u^2 for one input, at once."""
    return p[0] + p[1] * u + p[2] * u**2


def static_response(degree: int) -> ResponseSensitivity:
    """The sensitivity of a static polynomial, noise one."""

    def response(p, u):
        return quadratic(jnp.zeros(3).at[: degree + 1].set(p), u)

    ones = device(np.ones(degree + 1)), device(np.ones(1))
    return ResponseSensitivity(response, *ones)


LINE, PARABOLA = static_response(1), static_response(2)


@pytest.fixture
def plan(key):
    return plan_of(key)


@pytest.fixture(scope="module")
def one_step():
    return network_sensitivity(named("by inputs"), noise={"y": 2.0}, lead=30)


@pytest.fixture(scope="module")
def free_run():
    return network_sensitivity(
        named("by inputs"), noise={"y": 2.0}, one_step=False, lead=30
    )


# criteria -------------------------------------------------------------------------


def test_criteria_are_those_of_the_dense_matrix():
    rng = np.random.default_rng(5)
    slope, reference = rng.normal(size=(40, 2, 5)), rng.normal(size=(30, 2, 5))
    slope[..., 3] *= 1e-6  # badly scaled parameters are no matter
    reference[..., 3] *= 1e-6
    information = np.einsum("top,toq->pq", slope, slope)
    inverse = np.linalg.inv(information)
    variance = np.einsum("sop,pq,soq->s", reference, inverse, reference)
    found = figures(slope, reference)
    # Rounding of the inverse: its scaled condition is about 10.
    np.testing.assert_allclose(found.log_det, np.linalg.slogdet(information)[1], 1e-9)
    np.testing.assert_allclose(found.trace, np.trace(inverse), 1e-9)
    np.testing.assert_allclose(found.largest, variance.max(), 1e-9)


def test_smooth_maximum_lies_between_mean_and_maximum_and_tends_to_it():
    rng = np.random.default_rng(6)
    slope, reference = rng.normal(size=(40, 2, 5)), rng.normal(size=(30, 2, 5))
    top = float(figures(slope, reference).largest)
    smooth = [float(figures(slope, reference, power=p).largest) for p in (1, 16, 1024)]
    assert smooth[0] < smooth[1] < smooth[2] <= top
    # (1/n)^(1/p) bounds the gap.
    assert smooth[2] >= top * 30 ** (-1 / 1024)


def test_what_an_experiment_does_not_show_is_not_determined():
    rows = np.random.default_rng(7).normal(size=(40, 2, 5))
    rows[..., 2] = rows[..., 0] - rows[..., 1]
    found = figures(rows, rows[:30])
    assert found.log_det == -np.inf


# sensitivities --------------------------------------------------------------------


def test_one_step_sensitivity_is_the_weighted_regressors(one_step, plan):
    # y is linear in the coefficients at given lags: a large step shows the derivative.
    slope = np.asarray(shown(one_step, plan))
    p = one_step.parameters
    assert slope.shape == (LENGTH, 1, p.size)
    own = slope @ np.asarray(p) * 2.0
    run = eqx.filter_jit(lambda s, plan: s._run(s.network, render(plan))[2])
    y = np.asarray(run(one_step, plan)) * 10.0
    # The run reproduces itself: sum of coefficient times regressor is its output.
    np.testing.assert_allclose(own, y, rtol=1e-9, atol=1e-9)


def test_free_run_sensitivity_equals_central_differences(free_run, plan):
    inputs = render(plan)
    slope = np.asarray(shown(free_run, plan))
    p = free_run.parameters

    @jax.jit
    def outputs(p):
        return free_run._run(free_run.place(p), inputs)[2][:, 0] * 10.0 / 2.0

    h, here = 1e-5, np.asarray(p)
    for j in (0, 4, here.size - 1):
        step = h * (np.arange(here.size) == j)
        ends = [np.asarray(outputs(device(here + s))) for s in (step, -step)]
        difference = (ends[0] - ends[1]) / (2 * h)
        # Central differences: error of order h^2 = 1e-10 and rounding/h = 1e-10.
        np.testing.assert_allclose(slope[:, 0, j], difference, rtol=1e-6, atol=1e-7)


def test_a_network_that_needs_measured_outputs_is_refused():
    net = network([PARTS["own"]], (0,), variables=VARIABLES)  # w[t-1] is an input
    with pytest.raises(SpecError, match="does not model"):
        network_sensitivity(net)


def test_noise_must_name_the_modelled_outputs():
    with pytest.raises(SpecError, match="standard deviation for y"):
        network_sensitivity(named("by inputs"), noise={"w": 1.0})


# adjustment -----------------------------------------------------------------------


def test_gradient_by_levels_equals_central_differences(free_run, plan):
    reference = shown(free_run, plan)

    @jax.jit
    @jax.value_and_grad
    def value_and_slope(level):
        moved = eqx.tree_at(lambda p: p.level, plan, level)
        return objective(free_run(render(moved)), reference, OptimalDesign())

    def value(level):
        return float(value_and_slope(device(level))[0])

    here = np.asarray(plan.level)
    gradient = np.asarray(value_and_slope(plan.level)[1])
    direction = np.random.default_rng(8).normal(size=here.shape)
    h = 1e-6
    difference = value(here + h * direction) - value(here - h * direction)
    # Error of order h^2 and rounding/h, 1e-9 each; a factor of a thousand for margin.
    np.testing.assert_allclose(
        np.sum(gradient * direction), difference / (2 * h), rtol=1e-6
    )


@pytest.mark.slow
def test_line_goes_to_the_ends_of_its_range(key):
    plan = aprbs_plan(key, 120, inputs={"u": (-1.0, 1.0)}, hold=(6, 6))
    found = adjust(plan, LINE, OptimalDesign(max_steps=200))
    level = np.asarray(found.value.level)[:20]
    np.testing.assert_allclose(np.abs(level), 1.0, atol=1e-3)
    # det M of a line is n^2 (mean u^2 - mean(u)^2) <= n^2, equality for equal halves.
    assert found.status_name == "ok"
    assert found.stats["end"].log_det > 2 * np.log(120) - 0.2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("criterion", "share"), [("D", 1 / 3), ("A", 1 / 2)], ids=["D", "A"]
)
def test_parabola_has_the_known_optimal_shares(key, criterion, share):
    # Three points -1, 0, 1; shares of 0: D one third, A one half (Pukelsheim 1993).
    plan = aprbs_plan(key, 360, inputs={"u": (-1.0, 1.0)}, hold=(3, 3))
    method = OptimalDesign(criterion, max_steps=300)
    found = adjust(plan, PARABOLA, method)
    weight = np.array([(1 - share) / 2, share, (1 - share) / 2]) * 360
    best = jnp.asarray(np.sqrt(weight)[:, None, None] * _parabola([-1, 0, 1]))
    optimum = float(objective(best, best, method))
    reached = float(objective(_slope(found), _slope(found), method))
    start = float(objective(_slope_of(plan), _slope_of(plan), method))
    # Levels are few and settle where they stand: close to the optimum from above.
    assert optimum <= reached <= optimum + 0.1 * (start - optimum)


def _parabola(points) -> np.ndarray:
    return np.array([[[1.0, x, x * x]] for x in points])


def _slope(solution):
    return _slope_of(solution.value)


def _slope_of(plan):
    return shown(PARABOLA, plan)


RATE = {"a": 0.4, "b": 0.1}


@pytest.fixture(scope="module")
def limited_pair(one_step):
    plan = plan_of(jax.random.key(3), rate=RATE)
    return plan, adjust(plan, one_step, OptimalDesign(max_steps=30))


def test_information_grows_within_the_limits(limited_pair):
    plan, found = limited_pair
    assert found.status_name == "ok"
    assert found.stats["end"].log_det > found.stats["start"].log_det
    u = np.asarray(render(found.value))
    assert u.shape == (LENGTH, 2)
    for j, (name, (low, high)) in enumerate({"a": (-3, 3), "b": (-0.8, 0.8)}.items()):
        assert u[:, j].min() >= low - 1e-12 and u[:, j].max() <= high + 1e-12
        assert np.abs(np.diff(u[:, j])).max() <= RATE[name] * (1 + 1e-9)
    np.testing.assert_array_equal(found.value.hold, plan.hold)
    check_plan(found.value)


@pytest.mark.slow
@pytest.mark.parametrize(("criterion", "figure"), [("A", "trace"), ("G", "largest")])
def test_the_other_criteria_improve_too(key, criterion, figure):
    plan = aprbs_plan(key, 120, inputs={"u": (-1.0, 1.0)}, hold=(6, 6))
    found = adjust(plan, PARABOLA, OptimalDesign(criterion, max_steps=60))
    start, end = found.stats["start"], found.stats["end"]
    assert found.status_name == "ok"
    assert getattr(end, figure) < 0.9 * getattr(start, figure)


@pytest.mark.slow
def test_a_plan_whose_holds_end_early_lasts_to_the_end(key):
    plan = aprbs_plan(key, 120, inputs={"u": (-1.0, 1.0)}, hold=(6, 6))
    cut = eqx.tree_at(
        lambda p: [p.level, p.hold], plan, [plan.level[:8], plan.hold[:8]]
    )
    found = adjust(cut, PARABOLA, OptimalDesign(max_steps=20))
    own = figures(_slope(found), _slope_of(cut))
    np.testing.assert_allclose(found.stats["end"], own, rtol=1e-9)


def test_figures_are_those_of_the_returned_plan(one_step, limited_pair):
    plan, found = limited_pair
    own = figures(shown(one_step, found.value), shown(one_step, plan))
    np.testing.assert_allclose(found.stats["end"], own, rtol=1e-9)
    gain = found.stats["end"].log_det - found.stats["start"].log_det
    np.testing.assert_allclose(
        found.stats["efficiency"], np.exp(gain / one_step.parameters.size), rtol=1e-9
    )
    assert "as if" in found.detail


@pytest.mark.slow
def test_without_steps_the_plan_stays(one_step, plan):
    found = adjust(plan, one_step, OptimalDesign(max_steps=0))
    assert found.status_name == "no_improvement"
    # Through shares of the range and back: some units in the last place.
    np.testing.assert_allclose(found.value.level, plan.level, rtol=0, atol=1e-14)


def test_a_plan_for_other_inputs_is_refused(one_step, key):
    plan = aprbs_plan(key, 60, inputs={"b": (0.0, 1.0), "a": (0.0, 1.0)}, hold=(6, 9))
    with pytest.raises(SpecError, match="inputs are a, b; plan all"):
        adjust(plan, one_step)


def test_a_plan_that_shows_too_little_is_said_so(key):
    still = plan_of(key, length=LENGTH)
    none = device(np.zeros(still.level.shape))
    still = eqx.tree_at(lambda p: p.level, still, none)
    found = adjust(still, PARABOLA)
    assert found.status_name == "unidentifiable"
    assert "more levels" in found.detail


def test_a_search_compiles_once(one_step, limited_pair):
    plan, found = limited_pair
    moved = eqx.tree_at(lambda p: p.level, plan, found.value.level)
    method = OptimalDesign(max_steps=30)
    assert compilations(lambda: adjust(moved, one_step, method)) == 0


@pytest.mark.slow
def test_a_network_stands_for_its_sensitivity(plan):
    net = named("by inputs")
    assert CHANNELS.input_names == ["a", "b"]
    found = adjust(plan, net, OptimalDesign(max_steps=0))
    other = adjust(plan, network_sensitivity(net), OptimalDesign(max_steps=0))
    np.testing.assert_allclose(found.stats["end"], other.stats["end"], rtol=1e-12)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"criterion": "E"}, "criterion"),
        ({"max_steps": -1}, "max_steps"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"power": float("nan")}, "power"),
    ],
)
def test_settings_out_of_range_are_refused(options, field):
    with pytest.raises(SpecError) as error:
        from_dict(OptimalDesign, options)
    assert error.value.field == field
