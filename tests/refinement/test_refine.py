"""Refinement on simulation error: its derivatives, and what `refine` promises.

The settings and stages of the search may change; tested is the contract: exact normal
equations, recovery of a known system, never worse than the start where it is judged,
padding and frozen parameters untouched, a status for every end.
"""

from functools import cache

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from common import A, Y, some

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import Gaussians, Network
from jaxnarx.refinement import freeze, refine
from jaxnarx.refinement._refine import make_task
from jaxnarx.refinement.gauss_newton import loss, normal_equations
from jaxnarx.refinement.layout import make_layout
from jaxnarx.settings import SimulationError
from jaxnarx.simulation import run, simulate

SPARE = {"spare_models": 1, "spare_slots": 1}
"""Every network here carries padding, and shares its programs with the others."""
BAND = (0.5, 2.0)


@cache
def data() -> Dataset:
    return common.dataset()


# derivatives ----------------------------------------------------------------------


@cache
def prepared(kind: str):
    net = common.named(kind, **SPARE)
    task, _ = make_task(net, data())
    return task


@cache
def layout_of(kind: str, bound: float):
    return make_layout(common.named(kind, bound=bound, **SPARE), None, BAND)


def equations(kind: str, bound: float, horizon: int | None):
    """Loss, J'r and J'J at the start, found and by central differences."""
    task, layout = prepared(kind), layout_of(kind, bound)
    u = np.asarray(layout.gather(layout.base))
    anchor = task.anchors(horizon)
    found = normal_equations(layout, jnp.asarray(u), task.drive, anchor, task.weight)
    root, measured = np.sqrt(task.weight), np.asarray(task.drive.measured)

    def residual(u):
        y = run(layout.place(u), task.drive, anchor)
        return root * (np.asarray(y) - measured)

    hessian, gradient = oracles.normal_equations(residual, u)
    value = loss(layout, jnp.asarray(u), task.drive, anchor, task.weight)
    np.testing.assert_allclose(found[0], value, rtol=1e-12)
    return found, (np.sum(residual(u) ** 2), gradient, hessian)


KINDS = ["coupled", "coupled, by own output"]
"""Both paths of a run, two outputs, partitions by inputs and by an output."""


@pytest.mark.parametrize("horizon", [None, 7], ids=["free run", "windows"])
@pytest.mark.parametrize("bound", [50.0, 0.25], ids=["free", "limited"])
@pytest.mark.parametrize("kind", KINDS)
def test_normal_equations_are_those_of_the_central_differences(kind, bound, horizon):
    (value, gradient, gram), expected = equations(kind, bound, horizon)
    np.testing.assert_allclose(value, expected[0], rtol=1e-12)
    # Central differences with h = 1e-6 leave 1e-9 of the largest derivative; entries
    # far below it are compared with that.
    for found, plain in ((gradient, expected[1]), (gram, expected[2])):
        scale = np.abs(plain).max()
        np.testing.assert_allclose(found, plain, rtol=1e-5, atol=1e-7 * scale)
    assert scale > 1e-2
    np.testing.assert_array_equal(np.asarray(gram), np.asarray(gram).T)


@pytest.mark.parametrize("kind", KINDS)
def test_padding_carries_no_information(kind):
    layout = layout_of(kind, 50.0)
    task = prepared(kind)
    u = layout.gather(layout.base)
    _, gradient, gram = normal_equations(
        layout, u, task.drive, task.anchors(None), task.weight
    )
    # Mark what is padding in a network, and look the marks up in the vector.
    marked = jax.tree.map(lambda leaf: leaf, layout.base)
    for o, model in enumerate(layout.base.models):
        models = len(model.active) - 1
        empty = ~model.local.used | ~model.active[:, None]
        marked = eqx.tree_at(
            lambda n, o=o: n.models[o].local.coefficient,
            marked,
            jnp.where(empty, -1e9, model.local.coefficient),
        )
        assert not model.active[models]
    padding = np.asarray(layout.gather(marked)) < -1e8
    assert padding.any() and not padding.all()
    np.testing.assert_array_equal(np.asarray(gradient)[padding], 0.0)
    np.testing.assert_array_equal(np.asarray(gram)[padding], 0.0)
    informed = np.diagonal(np.asarray(gram)) > 0
    real = common.named(kind)
    leaves = [leaf for m in real.models for leaf in jax.tree.leaves(m.validity)]
    used = sum(int(m.local.used.sum()) for m in real.models)
    assert informed.sum() == used + sum(leaf.size for leaf in leaves)


def test_one_program_serves_every_horizon():
    task, layout = prepared("coupled"), layout_of("coupled", 50.0)
    u = layout.gather(layout.base)

    def evaluate(horizon):
        anchor = task.anchors(horizon)
        return lambda: normal_equations(layout, u, task.drive, anchor, task.weight)

    evaluate(None)()
    assert common.compilations(evaluate(5)) == 0
    assert common.compilations(evaluate(30)) == 0


def test_windows_restart_at_measured_histories_only():
    rows = [common.rows_of(data(), n) for n in range(4)]
    rows[0][20:24, Y] = np.nan
    net = common.named("by inputs", **SPARE)
    task, _ = make_task(net, common.from_rows(rows))
    anchor = np.asarray(task.anchors(6))
    # From sample 2 every sixth, except where one of two lags is missing.
    expected = [n for n in range(2, 60, 6) if not 21 <= n <= 25]
    assert np.flatnonzero(anchor[0][:60]).tolist() == expected
    # A free run has one start; what follows a record's end does not matter.
    free = np.asarray(task.anchors(None))
    assert np.flatnonzero(free[1][:45]).tolist() == [2]


def test_the_loss_is_the_mean_squared_error_over_the_variance():
    net = common.named("coupled", **SPARE)
    solution = refine(net, data(), SimulationError(horizons=(), max_steps=0))
    assert solution.status_name == "budget_spent"
    trajectories = simulate(net, data()).value
    shares = []
    for o in range(2):
        pairs = [
            (trajectories[n][s[:, o], o], data().records[n].y[s[:, o], o])
            for n, s in enumerate(trajectories.scored)
        ]
        found, measured = (np.concatenate(a) for a in zip(*pairs, strict=True))
        shares.append(np.mean((found - measured) ** 2) / np.var(measured))
    np.testing.assert_allclose(solution.stats["loss_start"], np.mean(shares), rtol=1e-9)
    assert solution.stats["loss"] == solution.stats["loss_start"]


# recovery -------------------------------------------------------------------------


def made_by(net: Network, *, seed: int = 0, noise: float = 0.0) -> Dataset:
    """The network's own free runs as measurements."""
    source = common.dataset(seed=seed)
    outputs = simulate(net, source).value
    rng = np.random.default_rng(seed)
    rows = [common.rows_of(source, n) for n in range(len(source))]
    for n, r in enumerate(rows):
        for o, signal in enumerate(net.signals):
            r[:, signal] = outputs[n][:, o]
        r[:, Y:] += noise * common.GAIN[Y:] * rng.normal(size=r[:, Y:].shape)
    return common.from_rows(rows)


def perturbed(net: Network, size: float, seed: int = 0) -> Network:
    """Every coefficient, centre and width moved at random, padding too."""
    rng = np.random.default_rng(seed)

    def moved(leaf):
        leaf = np.asarray(leaf)
        return jax.device_put(leaf + size * rng.normal(size=leaf.shape))

    def shift(model):
        return eqx.tree_at(
            lambda m: [m.local.coefficient, m.validity.centre, m.validity.log_width],
            model,
            replace_fn=moved,
        )

    return eqx.tree_at(lambda n: n.models, net, tuple(map(shift, net.models)))


def free_run_error(net: Network, data: Dataset, reference: Dataset) -> float:
    """Mean over outputs of the mean squared free-run error on `data`, as a share of the
    variance in `reference`; by the verb `simulate`.
    """
    found = simulate(net, data).value
    known = simulate(net, reference).value.scored
    shares = []
    for o, column in enumerate(net.modelled):
        error = [(found[n][:, o] - r.y[:, column]) for n, r in enumerate(data)]
        error = [e[s[:, o]] for e, s in zip(error, found.scored, strict=True)]
        y = [r.y[s[:, o], column] for r, s in zip(reference, known, strict=True)]
        shares.append(np.mean(np.concatenate(error) ** 2) / np.var(np.concatenate(y)))
    return float(np.mean(shares))


def used(net: Network, o: int = 0) -> np.ndarray:
    local = net.models[o].local
    mask = np.asarray(local.used) & np.asarray(net.models[o].active)[:, None]
    return np.asarray(local.coefficient)[mask]


def test_the_coefficients_of_one_model_are_recovered():
    truth = common.named("one model", **SPARE)
    start = perturbed(truth, 0.1)
    measured = made_by(truth)
    assert free_run_error(start, measured, measured) > 1e-3
    # Hardly any pull to the wrong start: the data are exact.
    solution = refine(start, measured, SimulationError(horizons=(10,), ridge=1e-12))
    assert solution.is_okay
    assert free_run_error(solution.value, measured, measured) < 1e-14
    np.testing.assert_allclose(used(solution.value), used(truth), rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", some(KINDS, "coupled, by own output"))
def test_a_perturbed_network_comes_back_on_new_data(kind):
    truth = common.named(kind, **SPARE)
    start = perturbed(truth, 0.1, seed=2)
    method = SimulationError(horizons=(10,), max_steps=25, window_steps=10)
    solution = refine(start, made_by(truth, noise=1e-4), method)
    assert solution.is_okay
    fresh = made_by(truth, seed=5)
    before, after = (free_run_error(n, fresh, fresh) for n in (start, solution.value))
    assert after < before / 100


# never worse than the start -------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_never_worse_than_the_start_on_validation(seed):
    # The validation records come from a quite different system.
    truth = common.named("coupled", **SPARE)
    start = perturbed(truth, 0.05, seed=seed)
    other = made_by(perturbed(truth, 0.2, seed=seed + 10), seed=3, noise=0.1)
    training = made_by(truth, noise=0.3, seed=seed)
    solution = refine(
        start,
        training,
        SimulationError(horizons=(5,), max_steps=6, window_steps=3, patience=2),
        validation=other,
    )
    before, after = (free_run_error(n, other, other) for n in (start, solution.value))
    assert after <= before * (1 + 1e-9)
    # What the search reports is what the verb `simulate` gives.
    np.testing.assert_allclose(solution.stats["loss_start"], before, rtol=1e-9)
    np.testing.assert_allclose(solution.stats["loss"], after, rtol=1e-9)
    # Every step was scored there, and the best of them is what comes back.
    scores = [row["validation"] for row in solution.stats["history"]]
    assert min([*scores, solution.stats["loss_start"]]) == solution.stats["loss"]


def test_training_data_judge_where_no_validation_is_given():
    start = perturbed(common.named("coupled", **SPARE), 0.05)
    method = SimulationError(horizons=(8,), max_steps=3, window_steps=2)
    solution = refine(start, data(), method)
    assert solution.stats["loss"] < solution.stats["loss_start"]
    before, after = (free_run_error(n, data(), data()) for n in (start, solution.value))
    np.testing.assert_allclose(solution.stats["loss_start"], before, rtol=1e-9)
    np.testing.assert_allclose(solution.stats["loss"], after, rtol=1e-9)


def test_validation_ends_a_search_that_no_longer_helps():
    truth = common.named("coupled", **SPARE)
    solution = refine(
        truth,
        made_by(perturbed(truth, 0.1, seed=4), noise=0.2),
        SimulationError(horizons=(), max_steps=40, patience=2),
        validation=made_by(truth, seed=6),
    )
    assert solution.status_name == "no_improvement"
    assert solution.is_okay
    # Nothing gets better: the last stage ends after as many steps as patience says.
    assert solution.stats["history"][-1]["stage_step"] == 2
    # The start is the true system there: nothing can beat it.
    np.testing.assert_allclose(used(solution.value), used(truth), rtol=0, atol=1e-12)


# what is left alone ---------------------------------------------------------------


QUICK = SimulationError(horizons=(6,), max_steps=2, window_steps=2)


@cache
def start_and_data():
    truth = common.named("coupled", **SPARE)
    return perturbed(truth, 0.1, seed=3), made_by(truth, noise=0.05)


def partition_of(net: Network, o: int = 0) -> Gaussians:
    validity = net.models[o].validity
    assert isinstance(validity, Gaussians)
    return validity


@cache
def refined():
    start, measured = start_and_data()
    return refine(start, measured, QUICK)


def test_padding_is_returned_as_it_came():
    start, _ = start_and_data()
    end = refined().value
    before, after = start.models[0], end.models[0]
    empty = ~np.asarray(before.local.used) | ~np.asarray(before.active)[:, None]
    np.testing.assert_array_equal(
        np.asarray(after.local.coefficient)[empty],
        np.asarray(before.local.coefficient)[empty],
    )
    # The bounded map and its inverse leave a rounding.
    for name in ("centre", "log_width"):
        a, b = (getattr(partition_of(n), name)[-1] for n in (end, start))
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(after.active, before.active)
    np.testing.assert_array_equal(after.local.index, before.local.index)
    assert np.all(used(end) != used(start))


def test_nothing_but_trained_parameters_changes():
    start, _ = start_and_data()
    end = refined().value
    trained = jax.tree.leaves(freeze(start))
    pairs = zip(jax.tree.leaves(start), jax.tree.leaves(end), trained, strict=True)
    for before, after, changes in pairs:
        if not changes:
            np.testing.assert_array_equal(before, after)
    assert jax.tree.structure(start) == jax.tree.structure(end)
    assert sum(trained) == 6


def test_frozen_kinds_and_single_leaves_stay():
    start, measured = start_and_data()
    tree = freeze(start, coefficients=False)
    tree = eqx.tree_at(lambda n: n.models[0].validity.centre, tree, False)
    solution = refine(start, measured, QUICK, trainable=tree)
    end = solution.value
    assert solution.stats["loss"] < solution.stats["loss_start"]
    for o in range(2):
        np.testing.assert_array_equal(used(end, o), used(start, o))
    (first, second), (end_first, end_second) = (
        [partition_of(n, o) for o in range(2)] for n in (start, end)
    )
    np.testing.assert_array_equal(end_first.centre, first.centre)
    assert np.all(end_first.log_width[:3] != first.log_width[:3])
    assert np.all(end_second.centre[:2] != second.centre[:2])
    assert np.all(end_second.log_width[:2] != second.log_width[:2])


@pytest.mark.parametrize("coefficients", [True, False])
@pytest.mark.parametrize("partition", [True, False])
def test_freeze_switches_whole_kinds(coefficients, partition):
    tree = freeze(start_and_data()[0], coefficients=coefficients, partition=partition)
    model = tree.models[0]
    assert model.local.coefficient is coefficients
    assert jax.tree.leaves(model.validity) == [partition, partition]
    # Of two outputs.
    assert sum(jax.tree.leaves(tree)) == 2 * (coefficients + 2 * partition)


def test_what_cannot_be_trained_is_refused():
    start, measured = start_and_data()
    nothing = freeze(start, coefficients=False, partition=False)
    with pytest.raises(SpecError, match="nothing is trainable") as caught:
        refine(start, measured, QUICK, trainable=nothing)
    assert caught.value.field == "trainable"
    gain = eqx.tree_at(lambda n: n.gain, freeze(start), True)
    with pytest.raises(SpecError, match="only coefficients and validity") as caught:
        refine(start, measured, QUICK, trainable=gain)
    assert caught.value.field == "trainable"


def test_one_model_has_no_partition_to_train():
    tree = freeze(common.named("one model"))
    assert jax.tree.leaves(tree.models[0].validity) == [False, False]
    assert tree.models[0].local.coefficient is True


def test_centres_stay_in_the_range_and_widths_in_their_band():
    start, _ = start_and_data()
    # Data that no such network explains pull hard on everything.
    method = SimulationError(
        horizons=(), max_steps=10, ridge=1e-12, width_band=(0.8, 1.25)
    )
    solution = refine(start, data(), method)
    before, after = partition_of(start), partition_of(solution.value)
    assert np.all((after.centre >= 0.0) & (after.centre <= 1.0))
    ratio = np.exp(np.asarray(after.log_width - before.log_width))
    assert np.all((ratio >= 0.8 - 1e-12) & (ratio <= 1.25 + 1e-12))
    assert np.any(np.abs(np.log(ratio)) > 0.1)


# statuses -------------------------------------------------------------------------


def test_a_spent_budget_is_a_normal_end():
    start, measured = start_and_data()
    rows = []
    solution = refine(start, measured, QUICK, progress=rows.append)
    assert solution.status_name == "budget_spent"
    assert solution.is_okay
    # Progress was told once for every accepted step, as it is in the history.
    assert rows == solution.stats["history"]
    # Two in windows, two of the coefficients on full records, two of everything.
    assert len(rows) == solution.stats["steps"] == 6
    assert [row["horizon"] for row in rows] == [6, 6, *[None] * 4]


def test_a_tolerance_that_is_reached_is_ok():
    start, measured = start_and_data()
    method = SimulationError(horizons=(), max_steps=30, tolerance=0.5)
    assert refine(start, measured, method).status_name == "ok"


def test_a_network_already_at_its_best_is_no_failure():
    truth = common.named("one model", **SPARE)
    measured = made_by(truth)
    method = SimulationError(horizons=(10,), ridge=1e-12)
    best = refine(perturbed(truth, 0.1), measured, method).value
    for net in (best, truth):
        again = refine(net, measured, method)
        assert again.is_okay, again.status_name
        np.testing.assert_allclose(used(again.value), used(truth), atol=1e-6)


def test_a_minimum_of_noisy_data_is_no_failure():
    truth = common.named("one model", **SPARE)
    measured = made_by(truth, noise=0.1)
    method = SimulationError(horizons=(), ridge=0.0, tolerance=0.0, max_steps=100)
    best = refine(truth, measured, method)
    assert best.is_okay, best.status_name
    again = refine(best.value, measured, method)
    assert again.is_okay, again.status_name
    np.testing.assert_allclose(used(again.value), used(best.value), rtol=1e-6)


def test_no_effect_of_any_parameter_is_unidentifiable():
    # The only term is of a, and a rests at zero.
    rows = [common.rows_of(data(), n) for n in range(4)]
    for r in rows:
        r[:, A] = 0.0
    still = common.network(
        [common.Part([[((1,), 0.5)]])], variables=((A, 0), (Y, 1)), bound=50.0
    )
    solution = refine(still, common.from_rows(rows), QUICK)
    assert solution.status_name == "unidentifiable"
    assert not solution.is_okay
    np.testing.assert_array_equal(used(solution.value), [0.5])


def unstable(start: Network) -> Network:
    """Feedback y(t-1) of 1.3 in every local model."""
    local = start.models[0].local
    feedback = np.flatnonzero((np.asarray(local.factor) == [0, 3]).all(axis=1))
    value = jnp.where(local.index == feedback[0], 1.3, local.coefficient)
    return eqx.tree_at(lambda n: n.models[0].local.coefficient, start, value)


@pytest.mark.parametrize("kind", ["one model", "coupled"])
def test_an_unstable_start_ends_finite_and_says_so(kind):
    truth = common.named(kind, bound=3.0, **SPARE)
    measured = made_by(truth, noise=0.01)
    start = unstable(truth)
    assert simulate(start, measured).status_name == "diverged"
    solution = refine(start, measured, SimulationError(horizons=(3, 10, 30)))
    assert solution.stats["start_diverged"]
    for leaf in jax.tree.leaves(eqx.filter(solution.value, eqx.is_inexact_array)):
        assert np.all(np.isfinite(leaf))
    assert np.isfinite(solution.stats["loss"])
    ends = simulate(solution.value, measured).status_name
    assert (ends == "diverged") == (solution.status_name == "start_diverged")
    # Short windows lead back to the system that made the data.
    assert solution.is_okay
    assert free_run_error(solution.value, measured, measured) < 1e-2
    assert "start diverged" in solution.detail


def test_data_without_one_complete_history_are_refused():
    rows = [common.rows_of(data(), n) for n in range(4)]
    for r in rows:
        # Never two measured outputs in a row.
        r[1::2, Y] = np.nan
    with pytest.raises(DataError, match="no record has 2 valid samples in a row"):
        refine(common.named("one model", **SPARE), common.from_rows(rows), QUICK)


def test_unscored_samples_do_not_pull():
    start, measured = start_and_data()
    rows = [common.rows_of(measured, n) for n in range(4)]
    # Without its input a sample is not scored; windows of 6 do not start behind it.
    rows[0][10, A] = np.nan
    spoilt = [r.copy() for r in rows]
    spoilt[0][10, Y:] = 1e3
    ends = [refine(start, common.from_rows(a), QUICK).value for a in (rows, spoilt)]
    np.testing.assert_allclose(used(ends[0]), used(ends[1]), rtol=1e-10)
    assert np.any(used(ends[0]) != used(start))


def test_channels_are_matched_by_name():
    start, measured = start_and_data()
    swapped = Dataset.from_arrays(
        [r.u[:, ::-1] for r in measured],
        [r.y[:, ::-1] for r in measured],
        inputs=["b", "a"],
        outputs=["w", "y"],
        sample_time=0.1,
    )
    plain, other = (refine(start, d, QUICK).value for d in (measured, swapped))
    np.testing.assert_array_equal(used(plain), used(other))


@pytest.mark.parametrize(
    "settings",
    [{"horizons": (1,)}, {"max_steps": -1}, {"width_band": (1.1, 2.0)}],
    ids=str,
)
def test_impossible_settings_are_refused(settings):
    with pytest.raises(SpecError) as caught:
        SimulationError(**settings)
    assert caught.value.field in settings
