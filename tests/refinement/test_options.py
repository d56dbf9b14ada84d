"""The options of `refine`: losses, initial conditions, solvers, starts, folds, priors.

Each is held to its own promise: the derivative by central differences, the minimum it
must reach, or what it must leave alone.
"""

import dataclasses
import itertools

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
import oracles
import pytest
from common import Y, some
from test_refine import (
    BAND,
    SPARE,
    free_run_error,
    made_by,
    perturbed,
    unstable,
    used,
)

from jaxnarx.arrays import (
    Driver,
    Levenberg,
    StoppingRules,
    advance,
    begin_levenberg,
    begin_search,
)
from jaxnarx.data import groups
from jaxnarx.errors import DataError, SpecError
from jaxnarx.refinement import freeze, refine
from jaxnarx.refinement.any_solver import any_solver
from jaxnarx.refinement.folds import curve, split_folds
from jaxnarx.refinement.gauss_newton import loss, normal_equations
from jaxnarx.refinement.initial import initial_conditions
from jaxnarx.refinement.layout import make_layout
from jaxnarx.refinement.problem import make_problem
from jaxnarx.refinement.random_windows import random_windows
from jaxnarx.refinement.starts import (
    one_step_least_squares,
    random_start,
    shrink_feedback,
)
from jaxnarx.refinement.training_data import make_task
from jaxnarx.settings import PredictionError, SimulationError
from jaxnarx.simulation import predict, run, simulate

QUICK = {"horizons": (8,), "window_steps": 4, "max_steps": 8}
"""Settings that share the compiled programs of one short search."""


# derivatives ----------------------------------------------------------------------


@eqx.filter_jit
def residual_vector(layout, u, drive, anchor, weight, criterion):
    """sqrt(weight) T'-free errors and the initial offsets' own, as one vector."""
    begun = layout.begin(u, drive.measured)
    y = run(layout.place(u), eqx.tree_at(lambda d: d.measured, drive, begun), anchor)
    e, _ = criterion.errors(y, drive.measured)
    parts = [(jnp.sqrt(weight) * e).reshape(-1)]
    if layout.initial is not None:
        own = jnp.sqrt(layout.initial.weight.reshape(-1))
        parts.append(own * u[layout.parameters :])
    return jnp.concatenate(parts)


def residuals(layout, task, anchor):
    """Of a task, as a function of the parameters."""
    at = task.drive, anchor, task.weight, task.criterion
    return lambda u: np.asarray(residual_vector(layout, jax.device_put(u), *at))


@pytest.mark.parametrize(
    ("kind", "horizon"),
    some(
        itertools.product(("coupled", "coupled, by own output"), (None, 2)),
        *(("coupled", 2), ("coupled, by own output", None)),
    ),
)
def test_initial_conditions_have_exact_derivatives(kind, horizon):
    net = common.named(kind, **SPARE)
    task, _ = make_task(net, common.dataset())
    layout = make_layout(net, None, BAND, initial_conditions(net, task))
    rng = np.random.default_rng(0)
    u = np.array(layout.gather(net))
    assert layout.initial is not None
    assert u.size == layout.parameters + layout.initial.size
    u[layout.parameters :] = 0.1 * rng.normal(size=layout.initial.size)
    anchor = task.anchors(horizon)
    found = normal_equations(layout, jnp.asarray(u), task.drive, anchor, task.weight)
    f = residuals(layout, task, anchor)
    hessian, gradient = oracles.normal_equations(f, u)
    np.testing.assert_allclose(found[0], np.sum(f(u) ** 2), rtol=1e-12)
    # As in test_refine: central differences with h = 1e-6.
    for one, plain in ((found[1], gradient), (found[2], hessian)):
        scale = np.abs(plain).max()
        np.testing.assert_allclose(one, plain, rtol=1e-5, atol=1e-7 * scale)
    starts = np.asarray(found[2])[layout.parameters :, : layout.parameters]
    assert np.abs(starts).max() > 1e-6


def test_transformed_errors_have_exact_derivatives():
    net = common.named("one model", **SPARE)
    data = common.dataset()
    rows = [np.abs(common.rows_of(data, n)) + 0.5 for n in range(len(data))]
    task, _ = make_task(net, common.from_rows(rows), box_cox=0.0)
    layout = make_layout(net, None, BAND)
    u, anchor = np.asarray(layout.gather(net)), task.anchors(None)
    args = (layout, jnp.asarray(u), task.drive, anchor, task.weight, task.criterion)
    value, gradient, gram = normal_equations(*args)
    f = residuals(layout, task, anchor)
    hessian, slope = oracles.normal_equations(f, u)
    np.testing.assert_allclose(value, loss(*args), rtol=1e-12)
    np.testing.assert_allclose(value, np.sum(f(u) ** 2), rtol=1e-12)
    for one, plain in ((gradient, slope), (gram, hessian)):
        scale = np.abs(plain).max()
        np.testing.assert_allclose(one, plain, rtol=1e-5, atol=1e-7 * scale)


# what is minimised ----------------------------------------------------------------


def test_estimated_initial_conditions_find_a_wrong_start():
    truth = common.named("one model", **SPARE)
    clean = made_by(truth)
    rows = [common.rows_of(clean, n) for n in range(len(clean))]
    for r in rows:
        r[: truth.history, Y] += 2.0 * common.GAIN[Y]
    spoilt = common.from_rows(rows)
    start = perturbed(truth, 0.05)
    method = SimulationError(**QUICK, initial_conditions="estimated", ridge=1e-12)
    found = refine(start, spoilt, method)
    # The offsets are those that were added, but for what their own weight costs them.
    offset = found.stats["initial"][:, : truth.history]
    plain = refine(start, spoilt, SimulationError(**QUICK, ridge=1e-12))
    assert np.median(offset[np.abs(offset) > 0]) < -0.5
    error = {
        name: free_run_error(s.value, clean, clean)
        for name, s in (("estimated", found), ("measured", plain))
    }
    assert error["estimated"] < error["measured"]


def test_a_robust_loss_forgives_outliers():
    truth = common.named("one model", **SPARE)
    clean = made_by(truth)
    rows = [common.rows_of(clean, n) for n in range(len(clean))]
    rng = np.random.default_rng(1)
    for r in rows:
        if len(r) > 20:
            at = rng.choice(np.arange(5, len(r)), 3, replace=False)
            r[at, Y] += 8.0 * common.GAIN[Y]
    spoilt, start = common.from_rows(rows), perturbed(truth, 0.05)
    errors = {}
    for name in ("squares", "huber", "log-cosh"):
        method = SimulationError(horizons=(), max_steps=25, loss=name, corner=0.05)
        # Windows would begin at outliers; the free run begins before them.
        errors[name] = free_run_error(refine(start, spoilt, method).value, clean, clean)
    assert errors["huber"] < errors["squares"] / 5
    assert errors["log-cosh"] < errors["squares"] / 5


SOLVERS = {
    "bfgs": optimistix.BFGS(rtol=1e-9, atol=1e-9),
    "lbfgs": optimistix.LBFGS(rtol=1e-9, atol=1e-9),
    "conjugate gradients": optimistix.NonlinearCG(rtol=1e-9, atol=1e-9),
    "dogleg": optimistix.Dogleg(rtol=1e-9, atol=1e-9),
    "windows": optax.adam(0.01),
}


@pytest.mark.parametrize("solver", some(SOLVERS, "bfgs", "dogleg", "windows"))
def test_every_solver_comes_near_the_system(solver):
    truth = common.named("one model", **SPARE)
    measured, start = made_by(truth), perturbed(truth, 0.1)
    before = free_run_error(start, measured, measured)
    method = SimulationError(horizons=(8,), window_steps=25, max_steps=40, ridge=1e-9)
    solution = refine(start, measured, method, solver=SOLVERS[solver])
    assert solution.is_okay, solution.detail
    after = free_run_error(solution.value, measured, measured)
    assert after < before / (20 if solver == "windows" else 1e4)


@pytest.mark.parametrize("name", ["dogleg", "windows"])
def test_a_solver_makes_the_same_steps_inside_a_program(name):
    truth, rules = common.named("one model", **SPARE), StoppingRules(0.0)
    measured, start = made_by(truth), perturbed(truth, 0.1)
    task, layout = make_task(start, measured)[0], make_layout(start, None, BAND)
    problem = make_problem(layout, task, 8)
    driver = Driver(Levenberg(problem), None, rules)
    u = np.asarray(layout.gather(start))
    begun, _ = driver.start(begin_search(begin_levenberg(u)))
    if name == "windows":
        options = {"batch": 4, "seed": 0}
        found = random_windows(problem, begun.state, 8, SOLVERS[name], **options)
    else:
        found = any_solver(problem, begun.state, SOLVERS[name])
    method, state = found
    begun = dataclasses.replace(begun, state=state)

    @eqx.filter_jit
    def inside(method, search):
        def step(_, search):
            return advance(method, None, rules, search)

        return jax.lax.fori_loop(0, 3, step, jax.tree.map(jnp.asarray, search))

    end, _ = Driver(method, None, rules).minimise(begun, 3)
    same = inside(method, begun)
    assert int(end.steps) == int(same.steps) == 3
    np.testing.assert_allclose(end.state.u, same.state.u, 1e-9)
    assert float(end.state.loss) < float(begun.state.loss)


def test_what_is_no_solver_is_refused():
    net = common.named("one model")
    for solver in ("bfgs", 3):
        with pytest.raises(SpecError, match="solver must be a minimiser"):
            refine(net, made_by(net), solver=solver)
    with pytest.raises(SpecError, match="solver of its own"):
        refine(net, made_by(net), PredictionError(), solver=SOLVERS["bfgs"])
    with pytest.raises(SpecError, match="at least one horizon"):
        none = SimulationError(horizons=())
        refine(net, made_by(net), none, solver=SOLVERS["windows"])


def test_windows_may_leave_the_partition_alone():
    truth = common.named("by inputs", **SPARE)
    measured, start = made_by(truth, noise=0.05), perturbed(truth, 0.1)
    method = SimulationError(horizons=(8,), window_steps=4, max_steps=0, train="staged")
    solution = refine(start, measured, method)
    for a, b in zip(
        jax.tree.leaves(solution.value.models[0].validity),
        jax.tree.leaves(start.models[0].validity),
        strict=True,
    ):
        # The bounded map and its inverse leave a rounding.
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)
    assert np.all(used(solution.value) != used(start))
    # The full record follows with the coefficients alone, then with everything.
    longer = refine(start, measured, dataclasses.replace(method, max_steps=2))
    rows = longer.stats["history"]
    assert [row["horizon"] for row in rows] == [8] * 4 + [None] * 4
    assert [row["stage_step"] for row in rows[4:]] == [1, 2] * 2
    end = longer.value.models[0].validity
    moved = jax.tree.leaves(end)[0] - jax.tree.leaves(start.models[0].validity)[0]
    assert np.abs(moved).max() > 1e-4


def test_either_order_is_the_better_of_both():
    truth = common.named("by inputs", **SPARE)
    measured, start = made_by(truth, noise=0.05), perturbed(truth, 0.1)
    orders = ("staged", "joint", "either")
    found = {
        train: refine(
            start,
            measured,
            SimulationError(horizons=(8,), window_steps=4, max_steps=1, train=train),
        )
        for train in orders
    }
    staged, joint, either = (found[train].stats for train in orders)
    assert staged["loss"] != joint["loss"]
    assert either["loss"] == min(staged["loss"], joint["loss"])
    assert either["steps"] == staged["steps"] + joint["steps"]
    names = [row.get("start", "") for row in either["history"]]
    assert names == [""] * staged["steps"] + ["joint"] * joint["steps"]
    method = SimulationError(train="either")
    with pytest.raises(SpecError, match="folds choose a position in one schedule"):
        dataclasses.replace(method, folds=2)


def test_record_weights_choose_what_is_fitted():
    truth = common.named("one model", **SPARE)
    other = perturbed(truth, 0.1, seed=8)
    good, bad = made_by(truth), made_by(other)
    rows = [common.rows_of(bad if n == 0 else good, n) for n in range(len(good))]
    mixed, start = common.from_rows(rows), perturbed(truth, 0.05)
    shares = [0.0, *[1.0] * (len(good) - 1)]
    method = SimulationError(**QUICK, ridge=1e-12)
    solution = refine(start, mixed, method, weights=shares)
    np.testing.assert_allclose(used(solution.value), used(truth), atol=1e-5)
    with pytest.raises(SpecError, match="weights must be one non-negative number"):
        refine(start, mixed, method, weights=[1.0])


def test_a_prior_holds_what_it_is_sure_of():
    truth = common.named("one model", **SPARE)
    measured, start = made_by(truth, noise=0.05), perturbed(truth, 0.1)
    free = jax.tree.map(lambda leaf: leaf, start)
    wide = eqx.tree_at(
        lambda n: n.models[0].local.coefficient,
        free,
        jnp.full_like(start.models[0].local.coefficient, jnp.inf),
    )
    sure = eqx.tree_at(
        lambda n: n.models[0].local.coefficient,
        free,
        jnp.full_like(start.models[0].local.coefficient, jnp.inf).at[0, 0].set(1e-9),
    )
    method = SimulationError(**QUICK)
    plain = refine(start, measured, method)
    same = refine(start, measured, method, deviations=wide)
    np.testing.assert_array_equal(used(plain.value), used(same.value))
    held = used(refine(start, measured, method, deviations=sure).value)
    np.testing.assert_allclose(held[0], used(start)[0], rtol=0, atol=1e-6)
    assert np.all(np.abs(held[1:] - used(start)[1:]) > 1e-6)
    with pytest.raises(SpecError, match="must be positive"):
        refine(start, measured, method, deviations=start)


# starts ---------------------------------------------------------------------------


def test_least_squares_of_one_step_is_that_of_the_rows():
    truth = common.named("by inputs", **SPARE)
    measured, start = made_by(truth), perturbed(truth, 0.3)
    # The partition of the truth, the coefficients of the other.
    start = eqx.tree_at(lambda n: n.models[0].validity, start, truth.models[0].validity)
    task, _ = make_task(start, measured)
    layout = make_layout(start, None, BAND)
    u = np.asarray(layout.gather(start))
    u = one_step_least_squares(layout, task.one_step(), u)
    np.testing.assert_allclose(used(layout.place(jnp.asarray(u))), used(truth), 1e-6)


def test_random_starts_differ_and_stay_inside():
    net = common.named("by inputs", **SPARE)
    task, _ = make_task(net, common.dataset())
    layout = make_layout(net, None, BAND)
    u, rng = np.asarray(layout.gather(net)), np.random.default_rng(0)
    ends = [random_start(layout, task, u, rng) for _ in range(2)]
    assert np.all(np.abs(ends[0]) <= np.asarray(layout.wall()))
    assert np.abs(ends[0] - ends[1]).max() > 0.1


def test_shrunk_feedback_keeps_the_input_terms():
    net = common.named("coupled", **SPARE)
    none = shrink_feedback(net, 0.0)
    rows = common.dataset()
    # Without feedback one step and the free run are the same.
    free, step = (f(none, rows).value for f in (simulate, predict))
    for n, scored in enumerate(step.scored):
        np.testing.assert_allclose(free[n][scored], step[n][scored], rtol=1e-12)
    for a, b in zip(
        jax.tree.leaves(shrink_feedback(net, 1.0)), jax.tree.leaves(net), strict=True
    ):
        np.testing.assert_array_equal(a, b)


def test_a_start_beyond_repair_is_replaced():
    truth = common.named("one model", bound=3.0, **SPARE)
    measured = made_by(truth, noise=0.01)
    # One step on the full record, from an explosion, is not enough.
    method = SimulationError(horizons=(), max_steps=1)
    solution = refine(unstable(truth), measured, method)
    assert solution.stats["start_diverged"] and solution.is_okay
    assert solution.stats["remedy"] == "one-step least squares"
    assert "one-step least squares led to one that does not" in solution.detail
    assert free_run_error(solution.value, measured, measured) < 1e-2
    assert {row.get("start", "") for row in solution.stats["history"]} >= {
        "one-step least squares"
    }


def test_the_best_of_several_starts_goes_on():
    truth = common.named("by inputs", **SPARE)
    measured, start = made_by(truth, noise=0.01), perturbed(truth, 0.3, seed=1)
    method = SimulationError(**QUICK, starts=3, train="joint")
    solution = refine(start, measured, method)
    rows = solution.stats["history"]
    windows = [row for row in rows if row["horizon"] is not None]
    names = ["", "random start 1", "random start 2"]
    assert list(dict.fromkeys(row.get("start", "") for row in windows)) == names
    # The best network of the windows is trained on.
    best = min(windows, key=lambda row: row["validation"])
    (last,) = {row.get("start", "") for row in rows if row["horizon"] is None}
    assert last == best.get("start", "")
    assert solution.stats["loss"] <= best["validation"]


# cross-validation -----------------------------------------------------------------


def brute_anchors(anchors, out, history):
    """Sample by sample: nothing of the history before one may be left out."""
    found = anchors.copy()
    for n, t in zip(*np.nonzero(anchors), strict=True):
        found[n, t] = not out[n, max(t - history, 0) : t].any()
    return found


@pytest.mark.parametrize("lengths", [(60, 52), common.LENGTHS], ids=["blocks", "whole"])
def test_a_task_without_a_group_neither_starts_from_it_nor_scores_it(lengths):
    net, data = common.named("coupled", **SPARE), common.dataset(lengths)
    task, _ = make_task(net, data)
    found = groups(data, folds=3, gap=4)
    assert found.whole == (len(lengths) > 2)
    total = np.asarray(task.weight).sum(axis=(0, 1))
    time = task.masks.anchors.shape[1]

    def stacked(masks):
        return np.stack([np.pad(m, (0, time - len(m))) for m in masks])

    for g, (rest, own) in enumerate(split_folds(task, found, net.history)):
        out = stacked(found.held_out_samples(g))
        label = stacked([label == g for label in found.labels])
        for part in (rest, own):
            weight = np.asarray(part.weight)
            np.testing.assert_allclose(weight.sum(axis=(0, 1)), total, rtol=1e-12)
            np.testing.assert_array_equal(weight > 0, part.masks.scored)
        counted = task.masks.scored[..., 0]
        np.testing.assert_array_equal(own.masks.scored[..., 0], counted & label)
        anchors = brute_anchors(task.masks.anchors, out, net.history)
        for n in range(len(data)):
            free = np.flatnonzero(np.asarray(rest.anchors(None))[n])[0]
            if not (counted[n] & ~out[n]).any():
                assert not rest.masks.scored[n].any()
                assert free == task.masks.start[n]
                continue
            first = np.flatnonzero(anchors[n])[0]
            assert free == rest.masks.start[n] == first
            np.testing.assert_array_equal(rest.masks.anchors[n], anchors[n])
            scored = counted[n] & ~out[n] & (np.arange(time) >= first)
            np.testing.assert_array_equal(rest.masks.scored[n, :, 0], scored)


def test_a_loss_without_a_group_knows_nothing_of_it():
    net, data = common.named("coupled", **SPARE), common.dataset((60, 52))
    found = groups(data, folds=3, gap=4)
    layout = make_layout(net, None, BAND)
    u = jnp.asarray(layout.gather(net))
    rows = [common.rows_of(data, n) for n in range(2)]
    for n, r in enumerate(rows):
        r[found.held_out_samples(1)[n], Y:] += 7.0
    losses = []
    for one in (data, common.from_rows(rows)):
        task, _ = make_task(net, one)
        # The spread of the outputs stays: it is not what is asked here.
        task = dataclasses.replace(make_task(net, data)[0], drive=task.drive)
        rest, own = split_folds(task, found, net.history)[1]
        for horizon in (None, 5):
            for part in (rest, own):
                at = part.drive, part.anchors(horizon), part.weight, part.criterion
                losses.append(float(loss(layout, u, *at)))
    before, after = np.reshape(losses, (2, 2, 2))
    np.testing.assert_array_equal(after[:, 0], before[:, 0])
    assert np.all(after[:, 1] > before[:, 1])


def test_groups_that_cannot_be_left_out_are_passed_over():
    net, data = common.named("one model", **SPARE), common.dataset()
    found = groups(data, folds=4)
    assert len(found) == 4
    task, _ = make_task(net, data, weights=[1.0, 1.0, 1.0, 0.0])
    assert len(split_folds(task, found, net.history)) == 3
    task, _ = make_task(net, data, weights=[1.0, 0.0, 0.0, 0.0])
    with pytest.raises(DataError, match="of 4 groups .* 0 can be left out"):
        split_folds(task, found, net.history)


def test_one_record_is_cross_validated_in_blocks():
    truth = common.named("one model", **SPARE)
    noisy = made_by(truth, noise=1.0)[:1]
    solution = refine(truth, noisy, SimulationError(**QUICK, folds=3, ridge=0.0))
    scores = solution.stats["cross_validation"]
    assert solution.stats["limit"] == int(np.argmin(scores)) < len(scores) - 1
    with pytest.raises(DataError, match="has 60 rows, too few for 9 blocks"):
        refine(truth, noisy, SimulationError(**QUICK, folds=9))


def test_a_curve_goes_on_over_stages_that_ended_early():
    rows = [
        {"done": 1, "validation": 4.0, "diverged": False},
        {"done": 4, "validation": 2.0, "diverged": True},
        {"done": 5, "validation": 3.0, "diverged": False},
    ]
    found = curve((False, 9.0), rows, 6)
    np.testing.assert_array_equal(found, [9.0, 4.0, 4.0, 4.0, np.inf, 3.0, 3.0])


def test_folds_stop_where_left_out_records_stop_to_gain():
    truth = common.named("one model", **SPARE)
    # The truth is the start, and the data are noise: every step is one too many.
    noisy = made_by(truth, noise=1.0)
    method = SimulationError(**QUICK, folds=2, ridge=0.0)
    solution = refine(truth, noisy, method)
    scores = solution.stats["cross_validation"]
    assert len(scores) == 1 + QUICK["window_steps"] + QUICK["max_steps"]
    assert solution.stats["limit"] == int(np.argmin(scores))
    assert solution.stats["steps"] <= solution.stats["limit"]
    with pytest.raises(SpecError, match="folds make validation records"):
        refine(truth, noisy, method, validation=noisy)


# one-step error -------------------------------------------------------------------


def one_step_error(net, data) -> float:
    found = predict(net, data).value
    error, y = [], []
    for n, scored in enumerate(found.scored):
        s = scored[:, 0]
        error.append(found[n][s, 0] - data.records[n].y[s, net.modelled[0]])
        y.append(data.records[n].y[s, net.modelled[0]])
    return float(np.mean(np.concatenate(error) ** 2) / np.var(np.concatenate(y)))


def test_separable_search_finds_the_partition():
    truth = common.named("by inputs", **SPARE)
    measured, start = made_by(truth), perturbed(truth, 0.1)
    method = PredictionError(max_steps=40, ridge=1e-12, tolerance=0.0)
    solution = refine(start, measured, method)
    assert solution.is_okay, solution.detail
    assert solution.stats["loss"] < 1e-6 * solution.stats["loss_start"]
    np.testing.assert_allclose(
        solution.stats["loss"],
        one_step_error(solution.value, measured),
        rtol=1e-6,
        atol=1e-20,
    )


def test_without_a_partition_one_solution_is_all():
    truth = common.named("one model", **SPARE)
    measured, start = made_by(truth), perturbed(truth, 0.3)
    solution = refine(start, measured, PredictionError(ridge=0.0))
    assert solution.status_name == "ok" and solution.stats["steps"] == 1
    np.testing.assert_allclose(used(solution.value), used(truth), rtol=1e-6)


def test_only_what_is_trainable_moves_in_prediction():
    truth = common.named("by inputs", **SPARE)
    measured, start = made_by(truth, noise=0.02), perturbed(truth, 0.05)
    tree = freeze(start, coefficients=False)
    solution = refine(start, measured, PredictionError(max_steps=3), trainable=tree)
    np.testing.assert_array_equal(used(solution.value), used(start))
    assert solution.stats["loss"] < solution.stats["loss_start"]


@pytest.mark.parametrize(
    "settings",
    [
        {"folds": 1},
        {"starts": 0},
        {"corner": 0.0},
        {"stability": -1.0},
    ],
    ids=str,
)
def test_impossible_options_are_refused(settings):
    with pytest.raises(SpecError) as caught:
        SimulationError(**settings)
    assert caught.value.field in settings
