"""Local models that are fed back their own outputs: output-error models of a region, or
several that share one."""

import dataclasses
import itertools
from functools import cache, partial

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from common import some
from kinds import OWN, own_feedback

import jaxnarx as jnx
from jaxnarx.confidence.information import sums, variances
from jaxnarx.data.batch import stack_records
from jaxnarx.errors import ModelFileError
from jaxnarx.models import Network, advance, load, save
from jaxnarx.refinement import refine, stability
from jaxnarx.refinement._stability.points import choose_points, jacobians
from jaxnarx.refinement.gauss_newton import normal_equations
from jaxnarx.refinement.layout import make_layout
from jaxnarx.refinement.training_data import make_task
from jaxnarx.settings import SimulationError
from jaxnarx.simulation import first_anchor, make_drive, make_masks, run, states


@cache
def data() -> jnx.Dataset:
    return common.dataset((60, 45, 52))


def validity(model, signals: np.ndarray, t: int) -> np.ndarray:
    x = np.array([signals[t - d, s] for s, d in model.scheduling.rows])
    z = (x - np.asarray(model.offset)) / np.asarray(model.span)
    centre, width = model.validity.centre, np.exp(model.validity.log_width)
    return oracles.validity(z[None], np.asarray(centre), np.asarray(width))[0]


def to_root(model, group: int, y):
    if model.root is None or not model.root.squares[group]:
        return y
    far = y - float(model.root.floor[group])
    return np.sign(far) * np.sqrt(np.abs(far))


def to_output(model, group: int, r):
    if model.root is None or not model.root.squares[group]:
        return r
    return float(model.root.floor[group]) + r * np.abs(r)


def plain_run(net: Network, rows: np.ndarray, start: int, k: int | None = None):
    """Free run of one record from `start`, or k samples from it, sample by sample.

    A table of signals for the network, and one for every group in which its own output
    stands in the place of the network's.
    """
    gain = np.asarray(net.gain)
    shared = rows.copy()
    alone = {
        (o, g): rows.copy()
        for o, model in enumerate(net.models)
        if model.own is not None
        for g in range(len(model.own))
    }
    for t in range(start, len(rows) if k is None else start + k):
        new = {}
        for o, model in enumerate(net.models):
            s, total = net.signals[o], 0.0
            phi = validity(model, shared, t)
            theta = np.asarray(model.local.dense())
            table = np.zeros((0, len(phi))) if model.own is None else model.own
            value = np.zeros(len(phi))
            for m in range(len(phi)):
                seen = shared.copy()
                for g in np.flatnonzero(np.asarray(table)[:, m]).tolist():
                    own = alone[o, g][:, s]
                    seen[:, s] = gain[s] * to_root(model, g, own / gain[s])
                v = [1.0, *(seen[t - d, c] / gain[c] for c, d in net.variables.rows)]
                factor = np.asarray(model.local.factor)
                terms = [np.prod([v[i] for i in row]) for row in factor]
                value[m] = theta[m] @ np.array(terms)
                if not np.asarray(table)[:, m].any():
                    total += phi[m] * value[m]
            for g, members in enumerate(np.asarray(table)):
                if members.any():
                    mean = np.average(value, weights=phi * members)
                    new[o, g] = to_output(model, g, mean)
                    total += np.sum(phi * members) * new[o, g]
            new[o] = total
        for key, value in new.items():
            o = key[0] if isinstance(key, tuple) else key
            s = net.signals[o]
            held = np.clip(value, net.lower[o], net.upper[o]) * gain[s]
            (alone[key] if isinstance(key, tuple) else shared)[t, s] = held
    return shared[:, list(net.signals)]


@pytest.mark.parametrize("bound", [50.0, 0.3], ids=["free", "limited"])
@pytest.mark.parametrize("name", OWN)
def test_a_free_run_is_the_sample_by_sample_one(name, bound):
    net = own_feedback(name, bound)
    found = jnx.simulate(net, data()).value
    for n in range(len(data())):
        expected = plain_run(net, common.rows_of(data(), n), net.history)
        np.testing.assert_allclose(
            found[n][net.history :], expected[net.history :], rtol=1e-9, atol=1e-9
        )


def test_own_feedback_acts():
    """Fed back the network's output instead, the same local models run elsewhere."""
    net = own_feedback("by inputs")
    plain = dataclasses.replace(
        net, models=tuple(dataclasses.replace(m, own=None) for m in net.models)
    )
    ours, theirs = (jnx.simulate(n, data()).value[0] for n in (net, plain))
    assert np.abs(ours - theirs).max() > 0.1 * theirs.std()
    # One step from measurements there is no difference: the past is the measured one.
    ours, theirs = (jnx.predict(n, data()).value[0] for n in (net, plain))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_prediction_over_several_steps_starts_from_measured_outputs():
    net, k = own_feedback("both"), 4
    found = jnx.predict(net, data(), k=k).value
    rows = common.rows_of(data(), 0)
    for t in (10, 23, 40):
        expected = plain_run(net, rows, t - k + 1, k)[t]
        np.testing.assert_allclose(found[0][t], expected, rtol=1e-9)


compiled_run = eqx.filter_jit(run)


@pytest.mark.parametrize(
    ("name", "bound"),
    some(
        itertools.product(("both", "shared"), (50.0, 0.3)),
        *(("both", 0.3), ("shared", 50.0)),
    ),
)
def test_normal_equations_are_those_of_the_central_differences(name, bound):
    net = own_feedback(name, bound)
    task, _ = make_task(net, data())
    layout = make_layout(net, None, (0.5, 2.0))
    u = np.asarray(layout.gather(net))
    anchor = task.anchors(None)
    found = normal_equations(layout, jnp.asarray(u), task.drive, anchor, task.weight)
    root = jnp.sqrt(task.weight)

    def residual(u):
        y = compiled_run(layout.place(jnp.asarray(u)), task.drive, anchor)
        return np.asarray(root * (y - task.drive.measured))

    hessian, gradient = oracles.normal_equations(residual, u)
    # Central differences with h = 1e-6 leave 1e-9 of the largest derivative.
    for ours, plain in ((found[1], gradient), (found[2], hessian)):
        scale = np.abs(plain).max()
        np.testing.assert_allclose(ours, plain, rtol=1e-5, atol=1e-7 * scale)
    assert scale > 1e-2


def test_a_perturbed_network_comes_back():
    """Data of a network with both kinds; its coefficients, moved by 5 %, return."""
    true = own_feedback("by inputs")
    made = common.from_rows(
        [
            np.column_stack(
                [rows[:, :2], jnx.simulate(true, data()).value[n], rows[:, 3]]
            )
            for n in range(len(data()))
            for rows in [common.rows_of(data(), n)]
        ]
    )
    where = lambda n: n.models[0].local.coefficient  # noqa: E731
    moved = eqx.tree_at(where, true, where(true) * 1.05)
    method = SimulationError(horizons=(), max_steps=40, ridge=0.0)
    fit = refine(moved, made, method, trainable=jnx.freeze(moved, partition=False))
    used = np.asarray(true.models[0].local.used)
    np.testing.assert_allclose(
        np.asarray(where(fit.value))[used], np.asarray(where(true))[used], atol=1e-6
    )
    np.testing.assert_array_equal(fit.value.models[0].own, true.models[0].own)


def test_sensitivities_by_parameters_and_by_the_start():
    """J'J by coefficients is that of the refinement; H, by the measured samples before
    the start, has the squared norms of central differences."""
    net = own_feedback("shared")
    task, _ = make_task(net, data())
    layout = make_layout(net, None, (0.5, 2.0))
    anchor, start = task.anchors(None), jnp.asarray(task.masks.start)
    inputs = layout, task.drive, anchor, start
    found = sums(net, *inputs, task.weight, np.zeros((1, 0)))
    u = layout.gather(net)
    gram = normal_equations(layout, u, task.drive, anchor, task.weight)[2]
    # others are by what stands in the network there, here by a map of it
    own = np.ix_(layout.coefficients(), layout.coefficients())
    bread, gram = np.asarray(found.bread)[own], np.asarray(gram)[own]
    assert bread.any()
    np.testing.assert_allclose(bread, gram, rtol=1e-9, atol=1e-12)

    params, lags = u.shape[0], 2
    root = jnp.eye(params + lags)[:, params:]
    square = variances(net, *inputs, root)
    slopes = []
    for lag in range(lags):
        at = (np.arange(len(data())), task.masks.start - 1 - lag, 0)
        sides = [
            compiled_run(
                net,
                dataclasses.replace(
                    task.drive, measured=task.drive.measured.at[at].add(h)
                ),
                anchor,
            )
            for h in (1e-6, -1e-6)
        ]
        slopes.append((sides[0] - sides[1]) / 2e-6)
    expected = np.sum(np.square(slopes), axis=0)
    for n, first in enumerate(task.masks.start):
        length = len(data().records[n])
        np.testing.assert_allclose(
            square[n, first:length], expected[n, first:length], rtol=1e-5, atol=1e-9
        )


def test_slopes_are_numbers_far_from_all_regions():
    """Sizes of weights whose squares are too small for a number."""
    net = own_feedback("both", bound=1e4)
    slopes = jax.jit(jax.jacfwd(net.models[0].shares))
    for size in (1e-170, 1e-300):
        assert np.isfinite(slopes(np.array([1.0, size, 0.0]))).all()


def test_poles_and_contraction_are_those_of_the_whole_state():
    """The state has an entry for the output and one for every local model; slopes by
    all of its past equal central differences of a step."""
    net = own_feedback("by inputs")
    found = stability(net, data()).value
    batch = stack_records(data())
    masks, drive = make_masks(net, batch), make_drive(net, batch)
    every = np.asarray(states(net, drive, jnp.asarray(first_anchor(masks))))
    assert every.shape[2] == 1 + 3
    points = choose_points(net, drive, masks, count=6, outputs=every)
    slopes, h = jacobians(net, points), 1e-6
    step, history = jax.jit(partial(advance, net)), np.asarray(points.history)
    for i, d in np.ndindex(4, 2):
        to = np.zeros((1, 4, 2))
        to[0, i, d] = h
        one, two = (
            np.asarray(step(points.v, points.x, np.moveaxis(past, 0, -1)))
            for past in (history + to, history - to)
        )
        expected = (one - two).T / (2 * h)
        np.testing.assert_allclose(slopes[:, :, i, d], expected, atol=1e-7)
    blended = [row for row in found.poles if row.model is None]
    assert blended and 0 < blended[0].median < 1
    assert found.contracts


def same(one: Network, other: Network) -> bool:
    """Whether two networks are equal, looked at on the host."""
    on_host = [jax.tree.map(np.asarray, net) for net in (one, other)]
    return bool(eqx.tree_equal(*on_host, typematch=True))


@pytest.mark.parametrize("name", ["both", "shared"])
def test_it_is_kept_in_a_file_of_its_own_format(name, tmp_path):
    net = own_feedback(name)
    save(net, tmp_path / "m.safetensors")
    assert same(net, load(tmp_path / "m.safetensors"))


@pytest.mark.parametrize(
    "own",
    [
        [[True, False]],
        [[True, True, False], [False, True, False]],
        [[True, True, False], [False] * 3, [False] * 3],
    ],
    ids=["too few", "one in two", "square, and two share one"],
)
def test_a_file_with_groups_that_cannot_be_is_damaged(own, tmp_path):
    wrong = eqx.tree_at(
        lambda n: n.models[0].own, own_feedback("shared"), jnp.array(own)
    )
    with pytest.raises(ModelFileError, match="not written"):
        save(wrong, tmp_path / "m.safetensors")


def test_a_list_of_local_models_in_a_file_of_format_four_is_read(tmp_path):
    net = own_feedback("by inputs")
    save(net, tmp_path / "m.safetensors")
    flat = eqx.tree_at(
        lambda n: n.models[0].own, net, jnp.diag(jnp.asarray(net.models[0].own))
    )
    save(flat, tmp_path / "m.safetensors")
    assert same(net, load(tmp_path / "m.safetensors"))


def test_equations_say_whose_past_they_take():
    first, second, _ = own_feedback("by inputs").equations()
    assert first["feedback"] == "own" and second["feedback"] == "network"
    assert first["text"].startswith("y_1[t] =") and "y_1[t-1]" in first["text"]
    assert second["text"].startswith("y[t] =") and "y[t-1]" in second["text"]
