"""Training of networks with hidden channels: derivatives, starts, what is refused."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import oracles
import pytest
from hidden_problems import FREE, GAIN, WINDOW, X1, X2, begun_at, network, truth

from jaxnarx.arrays.programs import program
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import PRIOR_WEIGHT, scales
from jaxnarx.refinement import refine
from jaxnarx.refinement._refine import make_task
from jaxnarx.refinement._stability import penalty_points
from jaxnarx.refinement.gauss_newton import loss, normal_equations
from jaxnarx.refinement.initial import initial_conditions
from jaxnarx.refinement.layout import make_layout
from jaxnarx.settings import PredictionError, SimulationError
from jaxnarx.simulation import run, simulate

BAND = (0.5, 2.0)
TOP = 0.5
QUICK = SimulationError(max_steps=6, ridge=0)


# derivatives ----------------------------------------------------------------------


@cache
def prepared(kind: str, top: float, measured: bool):
    """Task and layout of the model with other coefficients, so that there is an
    error, and the vector with offsets that are not zero.

    Not `measured`: from the true hidden values."""
    net, given = network(kind, top=top), truth(kind)
    task, _ = make_task(net, given.data)
    task = (
        task.with_hidden_starts(net)
        if measured
        else replace(task, drive=begun_at(net, given))
    )
    initial = initial_conditions(net, task, measured=measured)
    layout = make_layout(net, None, BAND, initial, every=True)
    rng = np.random.default_rng(7)
    u = np.asarray(layout.gather(net))
    return task, layout, u + 0.03 * rng.normal(size=u.size)


@program
def begun_run(layout, u, drive, anchor):
    """Free runs of the network at `u` from the offsets there."""
    begun = layout.begin(u, drive.measured)
    drive = eqx.tree_at(lambda d: d.measured, drive, begun)
    return run(layout.place(u), drive, anchor)


KINDS = [("plain", FREE, False), ("scheduled", TOP, True)]


@pytest.mark.parametrize(("kind", "top", "measured"), KINDS, ids=["plain", "held"])
def test_normal_equations_are_those_of_the_central_differences(kind, top, measured):
    task, layout, u = prepared(kind, top, measured)
    at = task.drive, task.anchors(None), task.weight
    assert layout.initial is not None
    own = np.asarray(layout.initial.weight)
    # One value before the start for every record: two hidden ones, and y and w.
    assert own.shape == (2, 1, 4) and np.all(own[..., 2:] > 0)
    assert np.all((own[..., :2] > 0) == measured)
    offsets = layout.parameters + np.arange(own.size)

    root, measured = np.sqrt(task.weight), np.asarray(task.drive.measured)

    def residual(u):
        r = root * (np.asarray(begun_run(layout, u, *at[:2])) - measured)
        return np.concatenate([r.ravel(), np.sqrt(own.ravel()) * u[offsets]])

    value, gradient, gram = normal_equations(layout, u, *at)
    hessian, slope = oracles.normal_equations(residual, u)
    np.testing.assert_allclose(value, np.sum(residual(u) ** 2), rtol=1e-12)
    np.testing.assert_allclose(loss(layout, u, *at), value, rtol=1e-12)
    # Central differences with h = 1e-6 leave 1e-9 of the largest derivative.
    for found, plain in ((gradient, slope), (gram, hessian)):
        scale = np.abs(plain).max()
        assert scale > 1e-3
        np.testing.assert_allclose(found, plain, rtol=1e-6, atol=1e-7 * scale)
    informed = np.diagonal(hessian)
    assert np.all(informed[: layout.parameters] > 0)
    assert np.all((informed[offsets] > 0) == (own.ravel() > 0))
    y = np.asarray(begun_run(layout, u, *at[:2]))
    assert np.any(y[..., 2] * GAIN[X1] >= top) == (top == TOP)


def test_a_start_pays_for_its_departure_as_the_prior_says():
    task, layout, _ = prepared("plain", FREE, False)
    net = network("plain")
    assert layout.initial is not None
    sigma = np.asarray(scales(net)[1])
    unit = np.asarray(task.weight).max(axis=(0, 1))[:2] * sigma[:2] ** 2
    expected = PRIOR_WEIGHT * unit.max() / sigma[2:] ** 2
    for own in np.asarray(layout.initial.weight)[:, 0, 2:]:
        np.testing.assert_allclose(own, expected, rtol=1e-12)


# what training does ---------------------------------------------------------------


@pytest.fixture(scope="module")
def spoiled():
    """The model with coefficients some percent off."""
    rng = np.random.default_rng(3)
    net = network()
    leaves = [m.local.coefficient for m in net.models]
    leaves = [x * jnp.asarray(1 + 0.05 * rng.normal(size=x.shape)) for x in leaves]
    return eqx.tree_at(lambda n: [m.local.coefficient for m in n.models], net, leaves)


def test_a_spoiled_model_is_found_again_with_its_starts(spoiled):
    data = truth().data
    fit = refine(spoiled, data, replace(QUICK, max_steps=15))
    assert fit.is_okay or fit.status_name == "stalled"
    before, after = (simulate(n, data).value for n in (spoiled, fit.value))
    errors = [
        np.concatenate([y - r.y for y, r in zip(v.outputs, data, strict=True)])
        for v in (before, after)
    ]
    # What is left is the prior's.
    assert np.abs(errors[0]).max() > 0.3 and np.abs(errors[1]).max() < 2e-3
    fresh = truth(seed=5)
    value = simulate(fit.value, fresh.data).value
    left = zip(value.outputs, fresh.computed, value.scored, strict=True)
    assert max(np.abs(y - c[:, :2])[s].max() for y, c, s in left) < 0.02
    assert fit.stats["initial"].shape == (2, 1, 4)
    assert fit.stats["history"][-1]["loss"] < 1e-6


def test_validation_records_are_judged_behind_their_windows(spoiled):
    given, extra = truth(), truth(seed=8)
    one = refine(spoiled, given.data, QUICK, validation=extra.data)
    score = one.stats["history"][-1]["validation"]
    run = simulate(one.value, extra.data).value
    parts = zip(run.outputs, extra.data, run.scored, strict=True)
    errors, counted = [], []
    for y, record, s in parts:
        errors.append((y - record.y)[s[:, 0]])
        counted.append(record.y[WINDOW + 1 :])
    # The loss: the mean of both outputs' squared NRMSE.
    square = np.mean(np.concatenate(errors) ** 2, axis=0)
    spread = np.concatenate(counted).std(axis=0)
    best = min(row["validation"] for row in one.stats["history"])
    assert best == pytest.approx(np.mean(square / spread**2), rel=1e-6)
    assert best <= score


def test_folds_leave_groups_out_of_training_and_judge_them(spoiled):
    fit = refine(spoiled, truth(lengths=(64, 64)).data, replace(QUICK, folds=4))
    errors = fit.stats["cross_validation"]
    assert np.all(np.isfinite(errors)) and errors[-1] < 0.1 * errors[0]
    assert 0 < fit.stats["limit"] == np.argmin(errors)


def test_a_hidden_channel_that_no_output_depends_on_stays_where_it_is():
    net = network(told=False)
    fit = refine(net, truth().data, QUICK)
    assert fit.status_name in ("ok", "budget_spent", "stalled")
    for leaf in jax.tree.leaves(eqx.filter(fit.value, eqx.is_array)):
        assert np.all(np.isfinite(leaf))
    # x2 has no information: no step moves it.
    np.testing.assert_array_equal(
        fit.value.models[3].local.coefficient, net.models[3].local.coefficient
    )
    history = fit.stats["history"]
    assert history[-1]["loss"] < history[0]["loss"]


def test_the_penalty_on_stability_sees_hidden_channels_of_the_run():
    net, given = network(), truth()
    task = make_task(net, given.data)[0].with_hidden_starts(net)
    points = penalty_points(net, task.drive, task.masks)
    every = given.computed
    places = zip(points.record, points.step, points.history, strict=True)
    for n, step, history in places:
        expected = every[n][step - 1, 2:] / GAIN[[X1, X2]]
        # From an estimated start: the prior.
        np.testing.assert_allclose(history[2:, 0], expected, atol=2e-2)
    rows = [row for row, (s, _) in enumerate(net.variables) if s in (X1, X2)]
    np.testing.assert_array_equal(
        points.v[np.array(rows) + 1], points.history[:, 2:, 0].T
    )


def test_random_starts_move_the_partition_and_nothing_runs_away(spoiled):
    method = replace(QUICK, max_steps=2, starts=2)
    fit = refine(spoiled, truth().data, method)
    losses = [row["loss"] for row in fit.stats["history"]]
    names = {row.get("start", "") for row in fit.stats["history"]}
    assert any("random start 1" in name for name in names)
    # A model that says the mean has one.
    assert np.all(np.isfinite(losses)) and max(losses) < 2


# what there is not ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "solver"),
    [(PredictionError(), None), (SimulationError(), optax.adam(0.01))],
    ids=["one", "w"],
)
def test_methods_that_begin_anew_at_measurements_are_refused(method, solver):
    with pytest.raises(SpecError, match="trained on free runs of whole records"):
        refine(network(), truth().data, method, solver=solver)


def test_records_without_a_window_cannot_train():
    with pytest.raises(DataError, match=f"no record has {1 + WINDOW} valid samples"):
        refine(network(), truth(lengths=(WINDOW, 8)).data, QUICK)
