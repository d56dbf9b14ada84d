"""Models with hidden states from data: plants found again, and data that have none."""

import dataclasses

import jax
import numpy as np
import pytest
from state_plants import METHOD, made, plant, records

import jaxnarx as jnx
from jaxnarx.confidence import apply_release_limits
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear import fit_states, refit_states, set_state_ranges, state_network
from jaxnarx.linear.state_space.starts import linear_starts
from jaxnarx.models import Network, combine_outputs, load, save, set_bounds
from jaxnarx.refinement import stays_bounded
from jaxnarx.settings import HiddenStates
from jaxnarx.simulation import simulate

SHORT = dataclasses.replace(METHOD, shrink=(1e-2,), max_steps=5, first_steps=5)


def matrices(net: Network) -> tuple[np.ndarray, ...]:
    """A, B, C, D of a linear network of one output, in physical units."""
    inputs, states = len(net.channels.inputs), net.hidden
    theta = np.stack([np.asarray(m.local.dense())[0] for m in net.models])
    gain = np.asarray(net.gain)
    own = np.append(gain[list(net.signals)][:1], np.ones(states))
    by_state, by_input = theta[:, 1 : 1 + states], theta[:, 1 + states :]
    by_state = by_state * own[:, None]
    by_input = by_input * own[:, None] / gain[None, :inputs]
    return by_state[1:], by_input[1:], by_state[:1], by_input[:1]


def impulse(a, b, c, d, count: int = 15) -> np.ndarray:
    """D, CB, CAB, ...: what all coordinates of the state have in common."""
    powers = [np.linalg.matrix_power(a, k) for k in range(count)]
    return np.stack([d, *(c @ p @ b for p in powers)])


def error(net: Network, data: Dataset) -> float:
    """Root mean square of the free run over the standard deviation."""
    run = simulate(net, data)
    assert run.is_okay
    parts = zip(run.value.outputs, data, run.value.scored, strict=True)
    wrong = np.concatenate([(y - r.y)[s[:, 0]] for y, r, s in parts])
    return float(np.sqrt(np.mean(wrong**2)) / np.concatenate([r.y for r in data]).std())


def finite(net: Network) -> bool:
    """Whether all coefficients are."""
    return all(np.all(np.isfinite(m.local.coefficient)) for m in net.models)


# plants found again ---------------------------------------------------------------


@pytest.fixture(scope="module")
def linear():
    told: list[dict] = []
    return fit_states(records(), METHOD, progress=told.append), told


def test_a_linear_plant_is_found_up_to_the_coordinates_of_its_state(linear):
    fit, _ = linear
    a, b, c, d = matrices(fit.value)
    true = plant()
    # What is left is the prior on the starts: 1e-4 of their weight.
    expected = np.sort_complex(np.linalg.eigvals(true.a))
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(a)), expected, atol=1e-5
    )
    response = impulse(true.a, true.b, true.c, true.d)
    np.testing.assert_allclose(impulse(a, b, c, d), response, atol=1e-5)
    assert error(fit.value, records(seed=9, size=0.8)) < 1e-5


def test_it_tells_what_it_began_from_and_every_pull(linear):
    fit, told = linear
    assert fit.is_okay and [c.name for c in fit.value.channels.hidden] == ["x1", "x2"]
    assert fit.value.window == METHOD.window
    path = fit.stats["path"]
    assert len(path) == len(METHOD.shrink) and path[-1] is fit.value
    assert fit.stats["start"] == "subspace" and set(fit.stats["starts"]) == {"subspace"}
    assert told and all(np.isfinite(event["loss"]) for event in told)
    # Hidden channels are held to where the records have driven them.
    runs = simulate(fit.value, records()).value.hidden
    low, high = np.asarray(fit.value.low)[2:], np.asarray(fit.value.high)[2:]
    assert np.all(low < high) and np.all(np.asarray(fit.value.upper)[1:] < 8)
    every = np.concatenate([run[1:] for run in runs])
    np.testing.assert_allclose([low, high], [every.min(0), every.max(0)], atol=1e-3)


def test_a_quadratic_plant_is_found_in_free_run_on_a_fresh_record():
    data, fresh = records(bend=1.0), records(seed=20, bend=1.0, size=0.8)
    linear = fit_states(data, SHORT).value
    fit = fit_states(data, dataclasses.replace(METHOD, degree=2))
    assert error(linear, fresh) > 0.05
    # 1e-3: the last value of the pull is not zero.
    assert error(fit.value, fresh) < 1e-3 and error(fit.value, data) < 1e-3
    before, after = fit.stats["path"]
    assert error(after, fresh) <= error(before, fresh)


def test_trained_once_more_it_is_a_model_of_those_data_with_the_ranges_of_both(linear):
    fit, _ = linear
    # Another plant, with a larger signal: it has to move, and farther out.
    other = records(size=1.5)
    halved = [dataclasses.replace(r, y=0.5 * r.y) for r in other]
    again = refit_states(
        fit.value, dataclasses.replace(other, records=tuple(halved)), METHOD, 1e-4
    )
    a, b, c, d = matrices(again)
    true = plant()
    response = 0.5 * impulse(true.a, true.b, true.c, true.d)
    # The pull of 1e-4 to where it stood is a ten thousandth of the way, and the prior.
    np.testing.assert_allclose(impulse(a, b, c, d), response, atol=1e-3)
    for key, wider in (("lower", np.less_equal), ("upper", np.greater_equal)):
        ours, before = (np.asarray(getattr(n, key))[1:] for n in (again, fit.value))
        assert np.all(wider(ours, before))


def test_the_start_of_the_smallest_error_is_taken():
    method = dataclasses.replace(SHORT, start="")
    stats = fit_states(records(), method).stats
    assert len(stats["starts"]) == 5
    assert stats["start"] == min(stats["starts"], key=stats["starts"].get)
    assert stats["starts"]["chain of lags"] > 10 * stats["starts"]["subspace"]


@pytest.mark.slow
def test_one_output_of_several_is_modelled_alone():
    data = records()
    both = made([r.u for r in data], [np.hstack([r.y, r.u**2]) for r in data])
    fit = fit_states(both, dataclasses.replace(SHORT, outputs=("y",)))
    assert fit.value.output_names == ["y"]
    assert fit.value.computed_names == ["y", "x1", "x2"]
    for own, alone in zip(
        simulate(fit.value, both).value.outputs,
        simulate(fit_states(data, SHORT).value, data).value.outputs,
        strict=True,
    ):
        np.testing.assert_allclose(own, alone, atol=1e-4)


def test_an_output_that_there_is_not_is_told_of():
    with pytest.raises(SpecError, match="unknown output 'z'.*Known names: y"):
        fit_states(records(), dataclasses.replace(SHORT, outputs=("z",)))


# data that have none --------------------------------------------------------------


def test_an_unstable_plant_has_stable_starts_and_ends_with_a_model():
    u = np.random.default_rng(6).normal(size=(80, 1))
    y = np.zeros((80, 1))
    for t in range(1, 80):
        y[t] = 1.04 * y[t - 1] + u[t - 1]
    found = dict(linear_starts(made([u], [y]), (0,), 2))
    assert set(found) >= {"subspace", "chain of lags"}
    for model in found.values():
        assert np.abs(model.poles).max() < 1


def test_a_constant_input_leaves_a_model_of_what_is_left():
    data = records()
    still = made([np.full_like(r.u, 3.0) for r in data], [r.y for r in data])
    fit = fit_states(still, SHORT)
    assert finite(fit.value)
    # Not worse than the mean, but for the start.
    assert error(fit.value, still) < 1.05
    moved = made([r.u for r in data], [r.y for r in data])
    run = simulate(fit.value, moved)
    assert all(np.all(np.isfinite(y)) for y in run.value.outputs)


def test_outputs_that_do_not_change_are_told_of():
    data = records()
    flat = made([r.u for r in data], [np.full_like(r.y, 2.0) for r in data])
    with pytest.raises(DataError, match="no start of 2 hidden states"):
        fit_states(flat, SHORT)


def test_records_shorter_than_the_window_are_told_of():
    short = records((30, 30))
    with pytest.raises(DataError, match="2 hidden states: no record has 51 valid"):
        fit_states(short, HiddenStates(states=2, degree=1))
    # With neither a start of that name.
    with pytest.raises(DataError, match="no linear model can be identified"):
        fit_states(short, dataclasses.replace(SHORT, start="another"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("data", "change"),
    [
        (records((30, 30)), {"window": 5}),
        (records((60,)), {"states": 8}),
        (records((60,)), {"states": 5, "degree": 2}),
        (made([np.eye(70, 1)], [np.random.default_rng(1).normal(size=(70, 1))]), {}),
    ],
    ids=["30 samples", "more states than there are", "more terms", "noise"],
)
def test_poor_data_end_with_a_model_that_runs_or_a_sentence(data, change):
    try:
        fit = fit_states(data, dataclasses.replace(SHORT, start="", **change))
    except DataError as trouble:
        assert "no start" in str(trouble) and "\n" not in str(trouble)
        return
    assert finite(fit.value)
    run = simulate(fit.value, data)
    assert all(np.all(np.isfinite(y)) for y in run.value.outputs)
    assert np.all(np.isfinite(fit.value.lower)) and np.all(np.isfinite(fit.value.upper))


@pytest.mark.parametrize("bad", [(), (0.1, 0.1), (0.01, 0.1), (0.1, -0.1)])
def test_the_pull_falls(bad):
    with pytest.raises(SpecError, match="shrink must fall"):
        HiddenStates(shrink=bad)


# states that saturate -------------------------------------------------------------

LEVEL = 0.7


def saturated() -> Network:
    """The plant, driven farther than its states may go."""
    return state_network(plant(), records(), (0,), window=15, saturation=LEVEL)


def plain_run(net: Network, hidden, u) -> np.ndarray:
    """Outputs of the plant whose states stay within the level."""
    p, x, y = plant(), np.array(hidden), np.zeros(len(u))
    for t, now in enumerate(u):
        y[t] = (p.c @ x + p.d @ now + p.output_offset)[0]
        x = np.clip(p.a @ x + p.b @ now + p.state_offset, -LEVEL, LEVEL)
    return y


def test_states_that_saturate_are_a_part_of_the_model():
    net, data = saturated(), records()
    np.testing.assert_array_equal(net.saturates, [False, True, True])
    run = simulate(net, data)
    assert run.is_okay and not any(held.any() for held in run.value.limited)
    for record, hidden, y in zip(
        data, run.value.hidden, run.value.outputs, strict=True
    ):
        assert np.abs(hidden).max() == LEVEL and np.mean(np.abs(hidden) == LEVEL) > 0.1
        first = net.before
        own = plain_run(net, hidden[first - 1], record.u[first:])
        np.testing.assert_allclose(y[first:, 0], own, rtol=1e-9, atol=1e-12)
    free = state_network(plant(), data, (0,), window=15)
    tight = dataclasses.replace(
        free, **{k: getattr(net, k) for k in ("lower", "upper")}
    )
    assert simulate(tight, data).status == jnx.RESULTS.diverged


def test_saturation_stays_whatever_is_done_to_bounds_and_files(tmp_path):
    net, data = saturated(), records()
    save(net, tmp_path / "net.safetensors")
    wide = apply_release_limits(jnx.models.hold_to_range(net))
    for one in (
        load(tmp_path / "net.safetensors"),
        set_bounds(net, 1e3),
        set_state_ranges(net, data),
        wide,
        combine_outputs([net]),
        jax.tree.map(lambda a: a, net),
    ):
        np.testing.assert_array_equal(one.saturates, net.saturates)
        np.testing.assert_array_equal(one.upper[1:], LEVEL)
    assert stays_bounded(net) and wide.outside == "linear"
    raised = dataclasses.replace(plant(), a=2 * np.asarray(plant().a))
    assert stays_bounded(state_network(raised, data, (0,), saturation=LEVEL))
    assert not stays_bounded(state_network(raised, data, (0,)))


def test_exported_code_saturates_too():
    """Proven by runs of the code beside those of the network."""
    found = jnx.export(saturated(), records(), to=["python"]).difference
    assert found and max(found.values()) < 1e-12


def test_training_ends_with_states_that_stay_within_their_level():
    method = dataclasses.replace(SHORT, degree=2, saturation=2.5)
    fit = fit_states(records(bend=0.2), method)
    np.testing.assert_array_equal(fit.value.upper[1:], 2.5)
    np.testing.assert_array_equal(fit.value.high[2:], 2.5)
    again = refit_states(fit.value, records(bend=0.2, seed=3), method, 1e-2)
    np.testing.assert_array_equal(again.upper[1:], 2.5)
    assert error(again, records(bend=0.2, seed=3)) < 0.2
