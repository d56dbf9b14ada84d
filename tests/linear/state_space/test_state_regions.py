"""Hidden states in regions: room, divisions, and a plant with a corner found again."""

import dataclasses

import jax
import numpy as np
import pytest
from state_plants import made, plant, records

from jaxnarx.data.batch import stack_records
from jaxnarx.linear import fit_states, set_state_ranges, state_network
from jaxnarx.linear.state_space.regions import (
    drop_inactive,
    pad_models,
    split_candidates,
)
from jaxnarx.models import SigmoidTree, load, save, weights_at
from jaxnarx.settings import HiddenStates
from jaxnarx.simulation import first_anchor, make_drive, make_masks, run, simulate

MOST = 3


@pytest.fixture(scope="module")
def linear():
    """The plant itself, with the ranges of its states."""
    data = records()
    return set_state_ranges(state_network(plant(), data, (0,), window=15), data)


def runs(network) -> np.ndarray:
    """Scaled free runs in which hidden states begin at zero."""
    batch = stack_records(records())
    anchor = jax.device_put(first_anchor(make_masks(network, batch)))
    return np.asarray(run(network, make_drive(network, batch), anchor))


def test_room_for_regions_changes_nothing(linear):
    room = pad_models(linear, MOST)
    assert [m.active.tolist() for m in room.models] == [[True, False, False]] * 3
    np.testing.assert_allclose(runs(room), runs(linear), rtol=1e-8)
    bare = drop_inactive(room)
    assert all(m.local.coefficient.shape == (1, 4) for m in bare.models)
    np.testing.assert_allclose(runs(bare), runs(linear), rtol=1e-8)


def test_what_has_no_tree_is_not_trimmed(linear):
    assert drop_inactive(linear) is linear


def test_a_division_is_through_the_middle_across_every_axis(linear):
    data = records()
    every = list(split_candidates(pad_models(linear, MOST), data))
    assert len(every) == len(linear.variables) == 3
    hidden = simulate(linear, data).value.hidden
    # Scored samples: behind the window and the sample of history before it.
    first = linear.before
    x = [
        np.concatenate([h[first - 1 : -1], r.u[first:]], axis=1)
        for h, r in zip(hidden, data, strict=True)
    ]
    points = np.concatenate(x)
    for dim, one in enumerate(every):
        np.testing.assert_allclose(runs(one), runs(linear), rtol=1e-8)
        for model in one.models:
            assert model.active.tolist() == [True, True, False]
            tree = model.validity
            assert isinstance(tree, SigmoidTree)
            np.testing.assert_array_equal(tree.direction[0], np.eye(3)[dim])
            border = float(model.offset[dim] + model.span[dim] * tree.border[0])
            assert border == pytest.approx(points[:, dim].mean(), rel=1e-6)
            # Two standard deviations above the middle the gate is open to 98 %.
            up = points.mean(0) + 2 * points.std(0) * np.eye(3)[dim]
            below, above = weights_at(model, up[None])[:, 0]
            assert above == pytest.approx(1 / (1 + np.exp(-4.0)), rel=1e-6)
            assert below + above == pytest.approx(1.0)


def test_the_worst_region_is_divided_next(linear):
    data = records()
    once = list(split_candidates(pad_models(linear, MOST), data))[2]  # by the input
    # The upper leaf gets another offset: its errors are the larger ones.
    models = list(once.models)
    local = models[0].local
    coefficient = np.array(local.coefficient)
    coefficient[1, 0] += 0.5
    moved = dataclasses.replace(local, coefficient=jax.device_put(coefficient))
    models[0] = dataclasses.replace(models[0], local=moved)
    twice = next(
        split_candidates(dataclasses.replace(once, models=tuple(models)), data)
    )
    for model in twice.models:
        assert model.active.all()
        assert isinstance(model.validity, SigmoidTree)
        path = np.asarray(model.validity.path).tolist()
        assert path == [[-1, 0], [1, -1], [1, 1]]
        leaves = np.asarray(model.local.coefficient)
        np.testing.assert_array_equal(leaves[1], leaves[2])
    assert len(drop_inactive(twice).models[0].active) == MOST


def corner(length: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A lag of the input, of which one sees the magnitude."""
    rng = np.random.default_rng(seed)
    u, x = np.repeat(rng.uniform(-1, 1, length // 8 + 1), 8)[:length], 0.2
    y = np.zeros(length)
    for t in range(length):
        x = 0.8 * x + 0.3 * u[t]
        y[t] = abs(x)
    return u[:, None], y[:, None]


def test_a_plant_with_a_corner_is_found_in_two_regions(tmp_path):
    every = [corner(n, s) for s, n in enumerate((300, 200, 300, 200))]
    us, ys = ([one[k] for one in every] for k in (0, 1))
    data, fresh = made(us[:2], ys[:2]), made(us[2:], ys[2:])
    method = HiddenStates(
        states=1,
        degree=1,
        regions=2,
        shrink=(0.1, 1e-3),
        window=15,
        max_steps=25,
        start="subspace of 10 block rows",
    )
    assert method.stages == ((2, 0.1), (2, 1e-3))
    fit = fit_states(data, method)
    assert len(fit.stats["path"]) == 2 and fit.stats["path"][-1] is fit.value
    assert all(m.active.tolist() == [True, True] for m in fit.value.models)

    def error(network) -> float:
        run = simulate(network, fresh).value
        parts = zip(run.outputs, fresh, run.scored, strict=True)
        wrong = np.concatenate([(y - r.y)[s] for y, r, s in parts])
        spread = np.concatenate([r.y for r in fresh]).std()
        return float(np.sqrt(np.mean(wrong**2)) / spread)

    # One linear model sees nothing of a magnitude; smooth gates leave a little of it.
    assert fit.stats["starts"][method.start] > 0.8
    assert error(fit.value) < 0.1
    save(fit.value, tmp_path / "corner.safetensors")
    again = simulate(load(tmp_path / "corner.safetensors"), fresh).value
    ours = simulate(fit.value, fresh).value
    for a, b in zip(again.outputs, ours.outputs, strict=True):
        np.testing.assert_array_equal(a, b)


def test_every_number_of_regions_from_two_on_is_a_stage():
    method = HiddenStates(regions=3, shrink=(0.1, 0.01))
    assert method.stages == ((2, 0.1), (2, 0.01), (3, 0.1), (3, 0.01))
    assert HiddenStates(shrink=(0.1,)).stages == ((1, 0.1),)
