"""Subspace identification against known plants."""

import numpy as np
import pytest
import scipy.signal

from jaxnarx.arrays import factorisation
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear.state_space.model import (
    StateSpace,
    simulate_state_space,
    simulate_states,
    stabilise,
)
from jaxnarx.linear.state_space.regression import Segment
from jaxnarx.linear.state_space.subspace import (
    CHAIN_POLES,
    chain_model,
    hankel_triangle,
    identify_subspace,
    subspace_models,
)

B, A = [0.0, 1.0, 0.5], [1.0, -1.5, 0.7]
LENGTHS = (150, 111)


def plant() -> StateSpace:
    """Three states, two inputs and outputs, offsets; poles .79 +- .43i and .7."""
    rng = np.random.default_rng(3)
    turn = 0.9 * np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    a = np.zeros((3, 3))
    a[:2, :2], a[2, 2] = turn, 0.7
    mix = rng.normal(size=(3, 3))
    b, c, d = rng.normal(size=(3, 2)), rng.normal(size=(2, 3)), rng.normal(size=(2, 2))
    offsets = np.array([1.0, 0.3, -2.0]), np.array([10.0, -5.0])
    a = mix @ a @ np.linalg.inv(mix)
    return StateSpace(a, b, offsets[0], c, d, offsets[1], np.eye(1, 3), np.ones(1))


def records() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Two records of the plant, from states far from rest, without noise."""
    rng = np.random.default_rng(4)
    us = [3 + rng.normal(size=(n, 2)) for n in LENGTHS]
    return us, [simulate_state_space(plant(), u, 5 * rng.normal(size=3)) for u in us]


def markov(model: StateSpace, count: int = 12) -> np.ndarray:
    """D, CB, CAB, ...: what every coordinates of the state have in common."""
    powers = [np.linalg.matrix_power(model.a, k) for k in range(count)]
    return np.stack([model.d, *(model.c @ p @ model.b for p in powers)])


def free_run_error(model: StateSpace, us, ys) -> float:
    runs = zip(us, ys, model.start, strict=True)
    return max(np.abs(simulate_state_space(model, u, x) - y).max() for u, y, x in runs)


def noisy(seed: int, samples: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """B/A u without noise, and with `noise` of its standard deviation."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(samples, 1))
    w = np.asarray(scipy.signal.lfilter(B, A, u, axis=0))
    return u, w + noise * w.std() * rng.normal(size=w.shape)


def test_a_plant_is_recovered_from_two_records():
    us, ys = records()
    model = identify_subspace(us, ys, 3)
    # 1e-6: rounding, times the condition of the windows, and the ridge of 1e-10.
    expected = np.sort_complex(np.linalg.eigvals(plant().a))
    np.testing.assert_allclose(np.sort_complex(model.poles), expected, atol=1e-6)
    np.testing.assert_allclose(markov(model), markov(plant()), atol=1e-6)
    assert free_run_error(model, us, ys) < 1e-6
    # Three values above what rounding makes of a zero.
    assert model.singular[2] > 1e-2 * model.singular[0] > 1e9 * model.singular[3]


@pytest.mark.parametrize("form", ["balanced", "modal"])
def test_states_have_mean_zero_and_unit_deviation_in_either_form(form):
    us, ys = records()
    model = identify_subspace(us, ys, 3, form=form)
    runs = zip(us, model.start, strict=True)
    states = np.concatenate([simulate_states(model, u, x) for u, x in runs])
    np.testing.assert_allclose(states.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(states.std(axis=0), 1.0, rtol=1e-9)
    assert free_run_error(model, us, ys) < 1e-6
    if form == "modal":
        entries = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]])
        np.testing.assert_array_equal(model.a != 0, entries)


def test_one_factorisation_gives_what_each_order_gives_alone():
    u, y = noisy(0, 300, 0.1)
    found = subspace_models([u], [y], (1, 2, 4), block_rows=8)
    assert list(found) == [1, 2, 4]
    alone = identify_subspace([u], [y], 2, block_rows=8)
    np.testing.assert_array_equal(found[2].a, alone.a)
    np.testing.assert_array_equal(found[2].start, alone.start)


def test_the_triangle_in_blocks_is_that_of_the_whole_matrix(monkeypatch):
    monkeypatch.setattr(factorisation, "ROWS_AT_ONCE", 17)
    monkeypatch.setattr("jaxnarx.linear.state_space.subspace.ROWS_AT_ONCE", 17)
    us, ys = records()
    rows, dense = 3, []
    for u, y in zip(us, ys, strict=True):
        for t in range(rows, len(u) - rows + 1):
            past, future = slice(t - rows, t), slice(t, t + rows)
            window = (u[future], u[past], y[past], y[future])
            dense.append(np.concatenate([[1.0], *(w.ravel() for w in window)]))
    pieces = [Segment(0, u, y) for u, y in zip(us, ys, strict=True)]
    found = hankel_triangle([*pieces, Segment(1, us[0][:5], ys[0][:5])], rows)
    expected = np.stack(dense)
    # The Gram matrix has no signs to choose; rounding is of the order of its entries.
    gram = expected.T @ expected
    np.testing.assert_allclose(found.T @ found, gram, atol=1e-12 * np.abs(gram).max())
    assert found.shape == gram.shape
    assert not np.any(np.tril(found, -1))


def test_records_are_cut_at_missing_samples():
    us, ys = records()
    valid = [np.ones(n, bool) for n in LENGTHS]
    # A piece of two samples at the front, too short for any window.
    valid[0][[2, 60, 61]] = False
    for u, y, good in zip(us, ys, valid, strict=True):
        u[~good], y[~good] = np.nan, 1e6
    model = identify_subspace(us, ys, 3, valid=valid)
    np.testing.assert_allclose(markov(model), markov(plant()), atol=1e-6)
    # Two samples of two outputs tell the three states at the first record's start.
    last = simulate_state_space(model, us[1], model.start[1])
    np.testing.assert_allclose(last, ys[1], atol=1e-6)
    first = simulate_state_space(model, us[0][:2], model.start[0])
    np.testing.assert_allclose(first, ys[0][:2], atol=1e-5)


def test_with_noise_the_free_run_is_near_the_plant():
    u, y = noisy(1, 1500, 0.05)
    model = identify_subspace([u], [y], 2)
    noise = 0.05 * y.std()
    error = (simulate_state_space(model, u, model.start[0]) - y).std()
    # Three standard deviations of the scatter of a standard deviation, 1/sqrt(2 N).
    assert error == pytest.approx(noise, rel=0.06)
    # Eight parameters of 1500 samples: .07 of the noise by least squares; thrice that.
    fresh, clean = noisy(2, 500, 0.0)
    run = simulate_state_space(model, fresh, model.start[0])
    assert (run - clean)[100:].std() < 0.2 * noise


def test_starting_states_of_short_noisy_records_are_bounded():
    pairs = [noisy(seed, 40, 0.3) for seed in range(10)] + [noisy(20, 6, 0.3)]
    us, ys = map(list, zip(*pairs, strict=True))
    # Twice the order of the plant: two states are noise, which nothing else bounds.
    model = identify_subspace(us, ys, 4)
    assert model.start.shape == (11, 4)
    assert np.abs(model.start).max() < 10


def test_poles_come_inside_the_unit_circle():
    turn = np.array([[np.cos(1), -np.sin(1)], [np.sin(1), np.cos(1)]])
    mix = np.random.default_rng(5).normal(size=(5, 5))
    a = np.zeros((5, 5))
    a[:2, :2] = 1.25 * turn
    a[2:, 2:] = np.diag([0.9995, -0.5, -2.0])
    a = mix @ a @ np.linalg.inv(mix)
    pair = 0.8 * np.exp(1j * np.array([1, -1]))
    for integrating, slow in ((False, 0.999), (True, 1.0)):
        found = np.linalg.eigvals(stabilise(a, integrating=integrating))
        expected = np.sort_complex(np.append(pair, [slow, -0.5, -0.5]))
        # The two at -.5 split by the root of rounding.
        np.testing.assert_allclose(np.sort_complex(found), expected, atol=1e-6)
    delay = np.eye(4, k=1)
    np.testing.assert_array_equal(stabilise(delay), delay)


def test_an_unstable_plant_gives_a_stable_model():
    u = np.random.default_rng(6).normal(size=(80, 1))
    y = np.asarray(scipy.signal.lfilter([0, 1], [1, -1.04], u, axis=0))
    model = identify_subspace([u], [y], 1)
    np.testing.assert_allclose(model.poles, [1 / 1.04], atol=1e-6)


def test_an_integrator_is_kept_when_asked_for():
    u = 0.2 + np.random.default_rng(7).normal(size=(400, 1))
    y = 7 + np.asarray(scipy.signal.lfilter([0, 0.1], [1, -1], u - 0.05, axis=0))
    held = identify_subspace([u], [y], 1)
    np.testing.assert_allclose(held.poles, [0.999], rtol=1e-12)
    free = identify_subspace([u], [y], 1, integrating=True)
    assert free.poles[0] == 1.0
    assert free_run_error(free, [u], [y]) < 1e-6 < free_run_error(held, [u], [y])


def test_a_dead_time_has_no_modal_form_and_needs_none():
    u = np.random.default_rng(8).normal(size=(300, 1))
    y = np.asarray(scipy.signal.lfilter([0, 0, 0, 0, 1], [1, -0.8], u, axis=0))
    model = identify_subspace([u], [y], 4, feedthrough=False)
    assert free_run_error(model, [u], [y]) < 1e-6
    assert not model.d.any()
    with pytest.raises(DataError, match="coincide.*form='balanced'"):
        identify_subspace([u], [y], 4, form="modal")


def test_an_input_that_does_not_change_has_no_effect():
    u, y = noisy(9, 200, 0.0)
    wide = np.column_stack([u, np.full(len(u), 3e3)])
    model = identify_subspace([wide], [y], 2)
    assert not model.b[:, 1].any() and not model.d[:, 1].any()
    assert free_run_error(model, [wide], [y]) < 1e-6


def test_what_cannot_be_used_is_told():
    u, y = noisy(10, 60, 0.0)
    # 5 block rows of two channels: 21 windows of 10 samples are 30 samples in a row.
    with pytest.raises(DataError, match="20 windows .* 21 are .* 30 samples"):
        identify_subspace([u[:29]], [y[:29]], 2, block_rows=5)
    with pytest.raises(DataError, match="0 windows"):
        identify_subspace([u[:7]] * 20, [y[:7]] * 20, 2)
    with pytest.raises(SpecError, match="orders up to 4, got 5"):
        identify_subspace([u], [y], 5, block_rows=5)
    with pytest.raises(DataError, match="record 1 .* first row 3"):
        identify_subspace(
            [u, u], [y, np.where(np.arange(60) == 3, np.nan, y[:, 0])[:, None]], 2
        )
    with pytest.raises(DataError, match="do not change"):
        identify_subspace([u], [np.ones_like(y)], 2)
    with pytest.raises(SpecError, match="same channels"):
        identify_subspace([u, np.hstack([u, u])], [y, y], 2)
    with pytest.raises(SpecError, match="form"):
        identify_subspace([u], [y], 2, form="observer")


# chains of lags -------------------------------------------------------------------


def chain(pole: float, us) -> list[np.ndarray]:
    """Three tanks behind one another, of which the first input fills the last and the
    second one the one in the middle; not at rest at first."""
    ys = []
    for u in us:
        z, y = np.array([1.0, -2.0, 0.5]), np.zeros((len(u), 1))
        for t in range(len(u)):
            y[t] = z[0] + 4.0
            new = pole * z + (1 - pole) * np.append(z[1:], 2.0 * u[t, 0])
            new[1] += 0.3 * u[t, 1]
            z = new
        ys.append(y)
    return ys


@pytest.mark.parametrize("feedthrough", [True, False])
def test_a_chain_of_lags_is_found_from_two_records(feedthrough):
    us, _ = records()
    pole = 1 - np.geomspace(*CHAIN_POLES)[4]
    ys = chain(pole, us)
    model = chain_model(us, ys, 3, feedthrough=feedthrough)
    # A threefold pole splits by the third root of rounding.
    np.testing.assert_allclose(model.poles, pole, atol=1e-4)
    # Starts far from the mean are pulled to it, as if there were noise.
    assert free_run_error(model, us, ys) < 2e-3 * ys[0].std()
    assert feedthrough or not model.d.any()
    runs = zip(us, model.start, strict=True)
    states = np.concatenate([simulate_states(model, u, x) for u, x in runs])
    np.testing.assert_allclose(states.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(states.std(axis=0), 1.0, rtol=1e-9)


def test_between_the_poles_that_are_tried_the_nearer_one_is_taken():
    us, _ = records()
    tried = 1 - np.geomspace(*CHAIN_POLES)
    ys = chain((tried[5] + 3 * tried[6]) / 4, us)
    model = chain_model(us, ys, 3)
    np.testing.assert_allclose(model.poles, tried[6], atol=1e-4)
    # What does not count is not looked at, whatever it is.
    valid = [np.arange(len(u)) != 20 for u in us]
    for u, y, good in zip(us, ys, valid, strict=True):
        u[~good], y[~good] = np.nan, 1e6
    again = chain_model(us, ys, 3, valid=valid)
    np.testing.assert_allclose(again.poles, tried[6], atol=1e-4)


def test_a_chain_has_one_output_and_a_state_at_least():
    us, ys = records()
    with pytest.raises(SpecError, match="a chain has one output, got 2"):
        chain_model(us, ys, 2)
    with pytest.raises(SpecError, match="order"):
        chain_model(us, [y[:, :1] for y in ys], 0)
