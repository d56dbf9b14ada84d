"""Sigmoid states: gates that all outputs and states share, drawn, trained, exported."""

import dataclasses
from functools import cache

import equinox as eqx
import jax
import numpy as np
import oracles
import pytest
from state_plants import made, plant, records

import jaxnarx as jnx
from jaxnarx.arrays.programs import program
from jaxnarx.confidence import apply_release_limits
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear import fit_states, set_state_ranges, state_network
from jaxnarx.linear.state_space import fit as fit_module
from jaxnarx.linear.state_space.gates import add_gates
from jaxnarx.models import AdditiveGates, Network, load, save
from jaxnarx.refinement import certificate, stability, stays_bounded
from jaxnarx.refinement._refine import make_task
from jaxnarx.refinement._stability._certificate import _blocks
from jaxnarx.refinement._stability.slopes import GatedSlopes, slopes_of
from jaxnarx.refinement.gauss_newton import loss, normal_equations
from jaxnarx.refinement.initial import initial_conditions
from jaxnarx.refinement.labels import label
from jaxnarx.refinement.layout import make_layout
from jaxnarx.settings import HiddenStates, SimulationError
from jaxnarx.simulation import run, simulate

GATES = 3


@pytest.fixture(scope="module")
def linear() -> Network:
    """The plant itself, with the ranges of its states."""
    data = records()
    return set_state_ranges(state_network(plant(), data, (0,), window=15), data)


@pytest.fixture(scope="module")
def gated(linear) -> Network:
    """With gates that do something."""
    network = add_gates(linear, records(), GATES, 1)
    rng, models = np.random.default_rng(0), []
    for model in network.models:
        theta = np.array(model.local.coefficient)
        theta[1:, 0] = 0.2 * rng.normal(size=GATES)
        local = dataclasses.replace(model.local, coefficient=jax.device_put(theta))
        models.append(dataclasses.replace(model, local=local))
    return dataclasses.replace(network, models=tuple(models))


def gates_of(network: Network) -> list[AdditiveGates]:
    found = [model.validity for model in network.models]
    assert all(isinstance(one, AdditiveGates) for one in found)
    return [one for one in found if isinstance(one, AdditiveGates)]


def test_gates_change_nothing_at_first_and_follow_from_their_number(linear):
    data = records()
    network = add_gates(linear, data, GATES, 1)
    before, after = (simulate(n, data).value for n in (linear, network))
    for a, b in zip(before.outputs, after.outputs, strict=True):
        np.testing.assert_allclose(b, a, rtol=0, atol=1e-10)
    first, *others = gates_of(network)
    assert first.direction.shape == (GATES, 3) and len(others) == 2
    again = gates_of(add_gates(linear, data, GATES, 1))[0]
    other = gates_of(add_gates(linear, data, GATES, 2))[0]
    np.testing.assert_array_equal(first.direction, again.direction)
    assert np.any(np.asarray(first.direction) != np.asarray(other.direction))


def test_a_run_is_that_of_the_equations(gated):
    """Sample by sample from the states that the network begins with."""
    data, found = records(), simulate(gated, records()).value
    low, span = (np.asarray(a) for a in (gated.models[0].offset, gated.models[0].span))
    gain = np.asarray(gated.gain)
    gates = gates_of(gated)[0]
    direction, border = np.asarray(gates.direction), np.asarray(gates.border)
    theta = [np.asarray(m.local.coefficient) for m in gated.models]
    for record, hidden, y in zip(data, found.hidden, found.outputs, strict=True):
        x = hidden[gated.before - 1]
        for t in range(gated.before, len(record)):
            z = np.concatenate([x, record.u[t]])
            s = 1 / (1 + np.exp(-(direction @ ((z - low) / span) - border)))
            scaled = z / gain[[2, 3, 0]]
            made_by = [c[0, 0] + c[0, 1:] @ scaled + c[1:, 0] @ s for c in theta]
            assert made_by[0] * gain[1] == pytest.approx(y[t, 0], rel=1e-9, abs=1e-9)
            x = np.array(made_by[1:]) * gain[2:]
            np.testing.assert_allclose(x, hidden[t], rtol=1e-9, atol=1e-9)


def jacobians(network: Network, points: int) -> np.ndarray:
    """Of all that is computed by itself, at random states and inputs far and near."""
    rng, first = np.random.default_rng(7), network.models[0]
    low, span = (np.asarray(a) for a in (first.offset, first.span))
    gain, gates = np.asarray(network.gain), gates_of(network)[0]
    direction, border = np.asarray(gates.direction), np.asarray(gates.border)
    theta = [np.asarray(m.local.coefficient) for m in network.models]

    def step(x, u):
        z = np.concatenate([x[1:] * gain[2:], u])
        s = 1 / (1 + np.exp(-(direction @ ((z - low) / span) - border)))
        scaled = z / gain[[2, 3, 0]]
        return np.array([c[0, 0] + c[0, 1:] @ scaled + c[1:, 0] @ s for c in theta])

    found = []
    for _ in range(points):
        size = 10.0 ** rng.uniform(-2, 1)
        x, u = size * rng.normal(size=len(theta)), size * rng.normal(size=1)
        e = 1e-5 * np.eye(len(x))
        found.append([(step(x + d, u) - step(x - d, u)) / 2e-5 for d in e])
    return np.swapaxes(np.array(found), 1, 2)


def test_a_certificate_holds_for_the_slopes_of_all_states(gated):
    found = certificate(gated)
    assert found is not None and found.rate < 1 and stays_bounded(gated)
    # Weak gates hardly change the rate of the linear model.
    alone = np.abs(np.linalg.eigvals(plant().a)).max()
    assert alone < found.rate
    slopes = jacobians(gated, 200)
    turned = found.factor @ slopes @ np.linalg.inv(found.factor)
    sizes = np.linalg.norm(turned, 2, axis=(1, 2))
    assert sizes.max() <= found.rate + 1e-6
    free = apply_release_limits(gated)
    assert free.certificate is not None and free.outside == "flag"


def test_gates_of_another_scale_have_slopes_of_their_own(gated):
    model = gated.models[-1]
    wider = dataclasses.replace(model, span=1.5 * model.span)
    other = dataclasses.replace(gated, models=(*gated.models[:-1], wider))
    for net, owners in ((gated, (0, 0, 0)), (other, (0, 0, 2))):
        slopes = slopes_of(net)
        assert isinstance(slopes, GatedSlopes) and slopes.owners == owners
        (corners,) = [m for _, m in _blocks(net) or []]
        assert len(corners) == 2 ** (GATES * len(set(owners)))


def test_strong_gates_have_none_but_stay_bounded(gated):
    models = []
    for model in gated.models:
        theta = np.array(model.local.coefficient)
        theta[1:] *= 50
        local = dataclasses.replace(model.local, coefficient=jax.device_put(theta))
        models.append(dataclasses.replace(model, local=local))
    strong = dataclasses.replace(gated, models=tuple(models))
    assert certificate(strong) is None and stays_bounded(strong)
    assert np.abs(np.linalg.eigvals(jacobians(strong, 50))).max() > 1
    data = records()
    told = stability(strong, data)
    assert told.stats["bounded"] and "stays bounded" in told.value.summary
    loud = dataclasses.replace(
        data, records=tuple(dataclasses.replace(r, u=100 * r.u) for r in data)
    )
    free = apply_release_limits(strong)
    run = simulate(free, loud).value
    assert not np.any(run.diverged) and np.isfinite(np.concatenate(run.hidden)).all()
    # Trained on, a network has its bounds again.
    assert free.is_unbounded.any() and not strong.is_unbounded.any()
    few = SimulationError(horizons=(5,), max_steps=1, window_steps=1)
    assert not jnx.refine(free, data, few).value.is_unbounded.any()
    # Beside a linear model that is not stable nothing is proven.
    first = dataclasses.replace(plant(), a=2 * np.asarray(plant().a))
    raised = add_gates(state_network(first, data, (0,), window=15), data, GATES, 1)
    assert not stays_bounded(raised) and certificate(raised) is None


@program
def begun_run(layout, u, drive, anchor):
    """Free runs of the network at `u` from the offsets there."""
    begun = layout.begin(u, drive.measured)
    drive = eqx.tree_at(lambda d: d.measured, drive, begun)
    return run(layout.place(u), drive, anchor)


def test_normal_equations_of_shared_gates_are_those_of_central_differences(gated):
    task, _ = make_task(gated, records())
    task = task.with_hidden_starts(gated)
    initial = initial_conditions(gated, task, measured=True)
    layout = make_layout(gated, None, (0.5, 2.0), initial)
    assert layout.owners == (0, 0, 0) and layout.initial is not None
    # 3 x 4 coefficients, 3 x 3 constants and padding, 3 x 3 directions, 3 borders.
    names = label(gated, layout).names
    assert sum("direction" in n for n in names) == 9
    assert layout.parameters == len(names) == 3 * 4 * (1 + GATES) + 9 + GATES
    rng = np.random.default_rng(3)
    u = np.asarray(layout.gather(gated))
    u = u + 0.03 * rng.normal(size=u.size)
    at = task.drive, task.anchors(None), task.weight
    own = np.asarray(layout.initial.weight)
    offsets = layout.parameters + np.arange(own.size)
    root, measured = np.sqrt(task.weight), np.asarray(task.drive.measured)

    def residual(u):
        r = root * (np.asarray(begun_run(layout, u, *at[:2])) - measured)
        return np.concatenate([r.ravel(), np.sqrt(own.ravel()) * u[offsets]])

    value, gradient, gram = normal_equations(layout, u, *at)
    hessian, slope = oracles.normal_equations(residual, u)
    np.testing.assert_allclose(loss(layout, u, *at), value, rtol=1e-12)
    for found, plain in ((gradient, slope), (gram, hessian)):
        scale = np.abs(plain).max()
        np.testing.assert_allclose(found, plain, rtol=1e-6, atol=1e-7 * scale)
    placed = gates_of(layout.place(u))
    for other in placed[1:]:
        np.testing.assert_array_equal(other.direction, placed[0].direction)
        np.testing.assert_array_equal(other.border, placed[0].border)


def bent(length: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A lag whose output saturates softly."""
    rng = np.random.default_rng(seed)
    u, x, y = np.repeat(rng.uniform(-1, 1, length // 8 + 1), 8)[:length], 0.0, []
    for t in range(length):
        x = 0.8 * x + 0.4 * u[t]
        y.append(np.tanh(2 * x))
    return u[:, None], np.array(y)[:, None]


@cache
def saturating() -> tuple[jnx.Dataset, jnx.Dataset]:
    us, ys = zip(*(bent(n, s) for s, n in enumerate((300, 200, 300, 200))), strict=True)
    return made(us[:2], ys[:2]), made(us[2:], ys[2:])


@cache
def trained() -> jnx.Solution:
    method = HiddenStates(
        states=1,
        degree=1,
        gates=2,
        draw=1,
        shrink=(0.1, 1e-2, 1e-4),
        window=15,
        max_steps=25,
        start="subspace of 10 block rows",
    )
    return fit_states(saturating()[0], method)


def test_a_saturation_is_found_and_gates_stay_shared():
    fit, fresh = trained(), saturating()[1]
    first, second = gates_of(fit.value)
    np.testing.assert_array_equal(first.direction, second.direction)
    found = simulate(fit.value, fresh).value
    parts = zip(found.outputs, fresh, found.scored, strict=True)
    wrong = np.concatenate([(y - r.y)[s] for y, r, s in parts])
    spread = np.concatenate([r.y for r in fresh]).std()
    error = float(np.sqrt(np.mean(wrong**2)) / spread)
    # The best linear model leaves several times as much.
    assert fit.stats["starts"]["subspace of 10 block rows"] ** 0.5 > 0.1
    assert error < 0.03


def test_it_is_saved_loaded_reported_and_exported_with_a_proof(tmp_path):
    network, fresh = trained().value, saturating()[1]
    save(network, tmp_path / "m.safetensors")
    loaded = load(tmp_path / "m.safetensors")
    for a, b in zip(
        simulate(network, fresh).value.outputs,
        simulate(loaded, fresh).value.outputs,
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)
    told = jnx.report(network, fresh, horizons=(), stability=False, diagnostics=False)
    nrmse = told.pooled_row("y").nrmse
    assert nrmse is not None and nrmse < 0.03
    told.to_html(tmp_path / "page.html")
    proven = jnx.export(network, fresh, to=["python", "c"], precision="double")
    assert not proven.failed and proven.difference["python"] < 1e-12


def test_gates_need_one_linear_region():
    with pytest.raises(SpecError, match="gates must be at least 0, and need degree 1"):
        HiddenStates(states=1, degree=2, gates=4)
    with pytest.raises(SpecError, match="gates"):
        HiddenStates(states=1, degree=1, regions=3, gates=4)
    with pytest.raises(SpecError, match="gates"):
        HiddenStates(states=1, degree=1, gates=-1)


def test_many_first_steps_are_taken_where_the_first_of_them_give_hope(monkeypatch):
    data, asked = records(), []
    train = fit_module._train

    def counted(network, data, method, steps, shrink, progress):
        gates = len(network.models[0].active) > 1
        asked.append(steps) if gates else None
        return train(network, data, method, 1 if gates else steps, shrink, progress)

    monkeypatch.setattr(fit_module, "_train", counted)
    method = HiddenStates(
        states=2, degree=1, gates=GATES, first_steps=20, max_steps=4, shrink=(0.1,)
    )
    fit_states(data, method)
    assert asked == [15, 5, 4]
    asked.clear()
    with pytest.raises(DataError, match="an error in training .* after 15 steps"):
        fit_states(data, method, hopeless=1e-6)
    assert asked == [15]
