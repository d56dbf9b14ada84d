"""Predictive control against a general solver, a plain Kalman filter, and on plants."""

import dataclasses

import common
import equinox as eqx
import hidden_problems
import jax
import jax.numpy as jnp
import kinds
import numpy as np
import pytest
from calibration_problems import network_and_cycle
from control_problems import TIME, A, B, linear, shifted, wanted
from scipy.optimize import minimize

import jaxnarx as jnx
from jaxnarx.arrays import program
from jaxnarx.control import Command, OutputLimit, close_loop, mpc, through_casadi
from jaxnarx.control.observer import (
    advance_estimate,
    correct,
    feedback_bounds,
    split_error,
)
from jaxnarx.control.planning import (
    LINEAR,
    SQUARE,
    domain_index,
    keep_bounds,
    plan_of,
    predict_outputs,
)
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import hold_to_range

FREE = {"force": Command(low=-1.0, high=1.0, rate=1.0, effort=0.03)}


def linear_controller(**more):
    return mpc(linear(), FREE, ["speed"], horizon=8, **more).value


def test_a_plan_is_the_least_of_its_cost():
    """Rounds of quadratic programs end where a general solver ends, on a network that
    is not linear, under bounds, rates and a limit that gives way."""
    network, _ = network_and_cycle()
    network = dataclasses.replace(network, domain=None)
    free = {"c": Command(low=-0.9, high=0.8, rate=0.6, effort=0.1)}
    limit = {"heat": OutputLimit(at_most=0.1, guard=0)}
    more = {"rounds": 12, "blocks": range(6), "observe_states": False}
    found = mpc(network, free, {"y": 2.0}, limit, horizon=6, **more)
    controller = found.value
    state = controller.begin([0.3, 0.2], [0.1, 0.2])
    reference = np.linspace(0.2, 0.5, 6)[:, None]
    _, decision = controller.step(state, [0.1, 0.2], reference, [0.3])
    now = correct(
        network,
        controller.statistics,
        state.estimate,
        state.u,
        jnp.array([0.1, 0.2]),
        states=False,
    )
    size, span = np.asarray(controller.size), np.asarray(controller.span)
    run = jax.jit(
        lambda plan: predict_outputs(
            controller, now, plan[:, None], jnp.full((6, 1), 0.3)
        )
    )

    def cost(z):
        plan, excess = z[:6], z[6]
        y = np.asarray(run(plan))
        error = 2.0 * ((y[:, 0] - reference[:, 0]) / size[0]) ** 2
        moves = np.diff(plan, prepend=0.2) / span[0]
        e = excess / size[1]
        return error.mean() + 0.1 * (moves**2).sum() + LINEAR * e + SQUARE * e**2

    limits = [
        {"type": "ineq", "fun": lambda z: z[6] + 0.1 - np.asarray(run(z[:6]))[:, 1]},
        {"type": "ineq", "fun": lambda z: 0.3 - np.diff(z[:6], prepend=0.2)},
        {"type": "ineq", "fun": lambda z: 0.3 + np.diff(z[:6], prepend=0.2)},
    ]
    start = np.append(np.full(6, 0.2), 0.2)
    oracle = minimize(
        cost,
        start,
        method="SLSQP",
        bounds=[(-0.9, 0.8)] * 6 + [(0.0, None)],
        constraints=limits,
        options={"ftol": 1e-13, "maxiter": 300},
    )
    np.testing.assert_allclose(decision.commands[0], oracle.x[0], atol=2e-3)
    np.testing.assert_allclose(decision.excess[0], oracle.x[6], atol=2e-3)


def test_the_observer_is_a_kalman_filter():
    """Over the whole state, of which delayed inputs have no variance and stay."""
    network = linear()
    controller = linear_controller(observe_states=True)
    known = controller.statistics
    names = jnx.state_space(network).names
    state = controller.begin([0.2, -0.1], [0.1, 0.1])
    now, u, measured = state.estimate, np.array([0.3, 0.4]), np.array([0.2, np.nan])
    found = correct(
        network, known, now, jnp.asarray(u), jnp.asarray(measured), states=True
    )
    after = advance_estimate(network, known, found, jnp.asarray(u), states=True)

    form = jnx.state_space(network)
    a, _, c, _ = (np.asarray(m) for m in form.jacobians(now.x, u))
    n = len(names)
    kept = np.array([name.startswith(("speed", "heat")) for name in names])
    at = np.flatnonzero(np.append(kept, [True] * 4))
    h = np.concatenate([c, np.eye(2), np.eye(2)], axis=1)[:1]
    z = np.concatenate([now.x, now.offset, now.fading])
    p = np.zeros((n + 4, n + 4))
    p[np.ix_(at, at)] = now.covariance
    seen = 0.2 - np.asarray(form.h(now.x, u))[0] - now.offset[0] - now.fading[0]
    gain = p @ h.T / (h @ p @ h.T + np.asarray(known.noise)[0])
    z, p = z + gain[:, 0] * seen, p - gain @ h @ p
    whole = np.concatenate([found.x, found.offset, found.fading])
    np.testing.assert_allclose(whole, z, atol=1e-8)
    np.testing.assert_allclose(found.x[~kept], now.x[~kept], atol=0)
    np.testing.assert_allclose(found.covariance, p[np.ix_(at, at)], atol=1e-8)

    f = np.diag(np.concatenate([np.zeros(n), np.ones(2), known.pole]))
    f[:n, :n] = a
    p = (f @ p @ f.T)[np.ix_(at, at)]
    steps = np.concatenate([known.states, known.offset, known.steps])
    np.testing.assert_allclose(after.covariance, p + np.diag(steps), atol=1e-8)


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("states", [True, False])
def test_a_run_at_its_bounds_begins_anew(states, held):
    """Nothing depends on such a state: an observer alone calls all of it an offset."""
    controller = linear_controller(observe_states=states)
    if held:
        network = hold_to_range(controller.network)
        controller = dataclasses.replace(controller, network=network)
    state = controller.begin([0.2, -0.1], [0.1, 0.1])
    near, decision = controller.step(state, [0.1, 0.1], [0.1], [-0.1])
    assert not decision.restarted
    far = state.estimate.x.at[2:4].set(1e3)
    lost = state._replace(estimate=state.estimate._replace(x=far))
    for measured, restarted in (([0.1, 0.1], True), ([0.1, np.nan], False)):
        now, decision = controller.step(lost, measured, [0.1], [-0.1])
        assert bool(decision.restarted) == restarted
        if restarted:
            assert np.abs(decision.disturbance).max() < 0.1
            assert np.abs(now.estimate.x).max() < 1.0
            _, decision = controller.step(now, measured, [0.1], [-0.1])
            assert not decision.restarted


def test_what_a_run_cannot_begin_anew_from():
    """Hidden states, groups of local models and static networks have no feedback of
    measured outputs alone."""
    static = common.network([common.Part([[((0,), 0.3)]])], variables=((0, 0),))
    groups = common.named("coupled, by own output")
    assert feedback_bounds(linear()) is not None
    assert feedback_bounds(groups) is not None
    own = kinds.problem("own feedback")[0]
    for network in (static, own, hidden_problems.network()):
        assert feedback_bounds(network) is None


def test_what_comes_to_rest_at_its_bounds_keeps_its_offset():
    """A run that would be back there at once does not begin anew."""
    controller = linear_controller(observe_states=False)
    network, force = controller.network, 1.0
    tight = dataclasses.replace(network, upper=0.5 * network.upper)
    controller = dataclasses.replace(controller, network=tight)
    y = np.asarray(network.upper * network.gain[2:])
    state = controller.begin([force, 0.0], 0.8 * y)
    _, decision = controller.step(state, 0.8 * y, [0.1], [0.0])
    assert not decision.restarted


def test_a_covariance_that_is_unfit_begins_anew():
    controller = linear_controller(observe_states=True)
    state = controller.begin([0.2, -0.1], [0.1, 0.1])
    cov = state.estimate.covariance
    broken = state._replace(estimate=state.estimate._replace(covariance=-1e9 * cov))
    now, decision = controller.step(broken, [0.1, 0.1], [0.1], [-0.1])
    assert decision.solved and np.isfinite(now.estimate.covariance).all()
    np.testing.assert_allclose(decision.disturbance, state.estimate.offset)


def test_errors_are_split_into_noise_and_what_fades():
    random = np.random.default_rng(0)
    slow = np.zeros(40_000)
    for t in range(1, len(slow)):
        slow[t] = 0.9 * slow[t - 1] + random.normal()
    pole, noise, steps = split_error([slow + 2 * random.normal(size=len(slow))], 1.0)
    assert pole == pytest.approx(0.9, abs=0.02)
    assert noise == pytest.approx(4.0, rel=0.1)
    assert steps == pytest.approx(1.0, rel=0.2)


@pytest.mark.parametrize("shift, strength", [(0.0, 1.0), (0.4, 1.0), (0.2, 0.7)])
def test_no_offset_is_left(shift, strength):
    """On the plant itself and on one that is shifted and weaker."""
    asked = wanted(160, hold=40)
    run = close_loop(linear_controller(), shifted(shift, strength), asked).value
    error = run.outputs[0][:, 0] - run.references[0][:, 0]
    ends = error.reshape(-1, 40)[:, 27:31]  # behind each step, before the next is seen
    assert np.abs(ends).max() < 0.01


def test_bounds_and_rates_are_kept():
    run = close_loop(linear_controller(), shifted(0.3, 0.5), wanted()).value
    u = np.concatenate(run.commands)[:, 0]
    assert u.min() >= -1 - 1e-9 and u.max() <= 1 + 1e-9
    assert np.abs(np.diff(u)).max() <= 1.0 * TIME + 1e-9
    assert all(s.all() for s in run.solved)


def test_a_limit_is_kept_and_gives_way_where_nothing_else_is_left():
    limit = {"speed": OutputLimit(at_most=0.3)}
    controller = linear_controller(limits=limit)
    run = close_loop(controller, linear(), wanted())
    assert run.value.outputs[0][:, 0].max() < 0.3 + 1e-6
    assert not run.detail
    # A plant that is shifted beyond the limit cannot keep it at first.
    found = close_loop(controller, shifted(1.5), wanted())
    assert found.status_name == "ok"
    assert "speed is beyond its limit" in found.detail
    assert found.value.to_dict()["kept"]["speed"] < 1.0


def test_a_command_beyond_its_bounds_comes_back_by_its_rate():
    controller = linear_controller()
    run = close_loop(controller, linear(), wanted(), start={"force": 3.0}).value
    u = run.commands[0][:, 0]
    assert u[0] == pytest.approx(2.5)
    assert np.abs(np.diff(u)).max() <= 0.5 + 1e-9
    assert (u[5:] <= 1.0 + 1e-9).all()


def test_the_domain_is_kept_at_a_price():
    """Of a network with a domain the plan keeps near to where it was trained, and goes
    beyond for what is far away alone."""
    network, _ = network_and_cycle()
    free = {"c": Command(low=-5.0, high=5.0, effort=0.0)}
    bare = dataclasses.replace(network, domain=None)
    index = {}
    for one in (network, bare):
        controller = mpc(one, free, ["heat"], horizon=6, rounds=3).value
        state = controller.begin([0.0, 0.0], [0.0, 0.0])
        for asked in (0.5, 2.0):
            decision = controller.step(state, [0.0, 0.0], [asked], [0.0])[1]
            assert decision.excess.shape == (0,)  # the domain's is none of them
            rows = jnp.stack([jnp.zeros(6), jnp.full(6, decision.commands[0])], axis=1)
            domain = mpc(network, free, ["heat"]).value
            where = domain_index(domain, jnp.zeros(2), rows)
            index[one is network, asked] = float(where[0, 0])
    assert 0.8 < index[True, 0.5] < 1.1
    assert 1.1 < index[True, 2.0] < 0.8 * index[False, 2.0]


def test_commands_keep_their_bounds_exactly():
    """The solution of a quadratic program does so up to its residual alone."""
    controller = mpc(linear(), FREE, ["speed"], horizon=8).value
    steps = np.linspace(9.0, -9.0, len(controller.blocks))[:, None]

    @jax.jit
    def kept(z):
        z = keep_bounds(controller, z, jnp.array([0.8]))
        return plan_of(controller, z)[:, 0]

    down, up = np.asarray(kept(steps)), np.asarray(kept(-steps))
    assert down[0] == 1.0 and down.min() == -1.0 and up.max() == 1.0
    np.testing.assert_allclose(up[0], 0.8 - 1.0 * TIME)


def test_values_that_no_sensor_gives_are_missing():
    controller = mpc(linear(), FREE, ["speed"], horizon=8).value
    runs = []
    decision = None
    for none in (np.nan, 1e30):
        state = controller.begin([0.2, none], [0.1, none])
        for _ in range(2):
            state, decision = controller.step(state, [none, 0.1], [0.2], [none])
        runs.append((state, decision))
    for one, other in zip(*map(jax.tree.leaves, runs), strict=True):
        np.testing.assert_array_equal(one, other)
        assert np.isfinite(one).all()


def test_a_network_in_single_precision_is_taken_in_double():
    def single(leaf):
        return leaf.astype(np.float32) if eqx.is_inexact_array(leaf) else leaf

    network = jax.tree.map(single, linear())
    controller = mpc(network, FREE, ["speed"], horizon=8).value
    decision = controller.step(
        controller.begin([0.2, 0.0], [0.1, 0.1]), [0.1, 0.1], [0.2], [0.0]
    )[1]
    assert decision.solved and decision.commands.dtype == np.float64
    with jax.enable_x64(False), pytest.raises(SpecError, match="double precision"):
        mpc(network, FREE, ["speed"], horizon=8)


def test_a_program_knows_the_memory_of_its_network():
    """Names and domain are no part of a program: what the domain tells of the memory
    is, by which what is reported widens."""
    network = hold_to_range(network_and_cycle()[0])
    high = np.asarray(network.high)[:2]
    over = 2 * high - np.asarray(network.low)[:2]
    x, within = network.init("steady", high[None]), program(type(network).step)
    for u in (over, high, high):
        alone, inside = network.step(x, u), within(network, x, u)
        np.testing.assert_allclose(alone[0], inside[0], rtol=1e-12)
        x = alone[0]


def test_steps_are_pure():
    controller = linear_controller()
    state = controller.begin([0.0, 0.0], [0.0, 0.0])
    _, alone = controller.step(state, [0.1, 0.0], [0.5], [0.2])

    @jax.jit
    def of(measured):
        return controller.step(state, measured, jnp.array([0.5]), jnp.array([0.2]))[1]

    many = jax.vmap(of)(jnp.array([[0.1, 0.0], [-0.3, 0.2]]))
    np.testing.assert_allclose(many.commands[0], alone.commands, atol=1e-9)
    # What is not measured changes nothing.
    _, blind = controller.step(state, [np.nan, np.nan], [0.5], [0.2])
    np.testing.assert_allclose(blind.disturbance, 0.0, atol=1e-12)
    assert np.isfinite(blind.commands).all()


def test_it_follows_a_linear_plant_as_its_inverse_would():
    """Without bounds and prices the next sample is the reference."""
    free = {"force": Command(low=-9.0, high=9.0, effort=0.0)}
    controller = mpc(linear(), free, ["speed"], horizon=1).value
    state = controller.begin([0.0, 0.0], [0.0, 0.0])
    _, decision = controller.step(state, [0.0, 0.0], [0.4], [0.2])
    x = 0.0 * A[0, 0]
    assert decision.commands[0] == pytest.approx((0.4 - x - B[0, 1] * 0.2) / B[0, 0])


def test_the_run_prints_and_saves_its_figures():
    run = close_loop(linear_controller(), linear(), wanted()).value
    assert "speed" in str(run) and "at a bound" in str(run)
    assert run.to_dict()["nrmse"]["speed"] < 0.5
    assert run.target_names == ("speed",)


def test_what_makes_no_sense_is_refused():
    network = linear()
    with pytest.raises(SpecError, match="unknown commands 'forces'"):
        mpc(network, {"forces": Command()}, ["speed"])
    with pytest.raises(SpecError, match="unknown targets 'spead'"):
        mpc(network, FREE, ["spead"])
    with pytest.raises(SpecError, match="unknown limits"):
        mpc(network, FREE, ["speed"], {"x": OutputLimit(at_most=1)})
    with pytest.raises(SpecError, match="horizon must be at least 1"):
        mpc(network, FREE, ["speed"], horizon=0)
    with pytest.raises(SpecError, match="blocks must rise from 0"):
        mpc(network, FREE, ["speed"], blocks=(1, 2))
    with pytest.raises(SpecError, match="leave no room"):
        mpc(network, {"force": Command(low=2.0)}, ["speed"])
    with pytest.raises(SpecError, match="low < high"):
        Command(low=1.0, high=0.0)
    with pytest.raises(SpecError, match="at_least < at_most"):
        OutputLimit(at_most=0.0, at_least=1.0)
    with pytest.raises(SpecError, match="at least one command"):
        mpc(network, {}, ["speed"])


def test_what_is_to_be_known_is_said():
    network = linear()
    wide = mpc(network, {"force": Command(high=3.0)}, ["speed"]).detail
    assert "force may leave the range of the training" in wide
    assert "no certificate" in wide
    with pytest.raises(SpecError, match="the weight of speed must be positive"):
        mpc(network, FREE, {"speed": -1.0})


def test_references_and_plants_that_do_not_fit_are_refused():
    controller, asked = linear_controller(), wanted()
    with pytest.raises(DataError, match="resample"):
        slow = jnx.Dataset.from_arrays(
            np.zeros(30), np.zeros(30), inputs="load", outputs="speed", sample_time=1.0
        )
        close_loop(controller, linear(), slow)
    with pytest.raises(DataError, match="lack load"):
        bare = jnx.Dataset.from_arrays(
            np.zeros(30), np.zeros(30), inputs="z", outputs="speed", sample_time=TIME
        )
        close_loop(controller, linear(), bare)
    with pytest.raises(SpecError, match="the plant has no output 'speed'"):
        other = network_and_cycle()[0]
        close_loop(controller, other, asked)
    with pytest.raises(SpecError, match="noise names 'z'"):
        close_loop(controller, linear(), asked, noise={"z": 1.0})
    with pytest.raises(SpecError, match="start names 'load', no command"):
        close_loop(controller, linear(), asked, start={"load": 1.0})


def test_hidden_states_are_estimated():
    """A plant that begins with other hidden states than the controller believes."""
    network = hidden_problems.network("plain")
    found = mpc(network, {"a": Command(low=-4.0, high=4.0)}, ["y"], horizon=8)
    assert "hidden states are estimated" in found.detail
    assert found.value.observe_states
    reference = np.repeat([4.0, 6.0, 5.0], 25)
    asked = jnx.Dataset.from_arrays(
        np.full(75, 0.2),
        reference,
        inputs="b",
        outputs="y",
        sample_time=float(network.sample_time),
    )
    run = close_loop(found.value, network, asked, start={"a": 1.0}).value
    error = run.outputs[0][:, 0] - reference
    assert np.abs(error.reshape(3, 25)[:, 12:15]).max() < 0.05


def test_a_solver_of_casadi_finds_the_same_commands():
    """Bounds, rates, a limit that gives way, known references and other inputs: after
    some rounds our plan is that of IPOPT, sample by sample."""
    pytest.importorskip("casadi")
    command = Command(low=-0.8, high=0.8, rate=0.4)
    limits = {"heat": OutputLimit(at_most=0.15)}
    with pytest.raises(SpecError, match="observe_states=False"):
        through_casadi(linear_controller())
    more = {"rounds": 8, "observe_states": False}
    ours = mpc(linear(), {"force": command}, ["speed"], limits, horizon=12, **more)
    theirs = through_casadi(ours.value)
    state = ours.value.begin([0.0, 0.0], [0.0, 0.0])
    other = theirs.begin([0.0, 0.0], [0.0, 0.0])
    random, gave = np.random.default_rng(1), 0.0
    for t in range(15):
        known = (
            0.2 * random.normal(size=2),
            [0.5 * np.sin(t / 3)],
            [0.3 * np.cos(t / 4)],
        )
        state, found = ours.value.step(state, *known)
        other, expected = theirs.step(other, *known)
        assert expected.solved
        np.testing.assert_allclose(found.commands, expected.commands, atol=1e-4)
        np.testing.assert_allclose(found.outputs, expected.outputs, atol=1e-4)
        np.testing.assert_allclose(found.excess, expected.excess, atol=1e-4)
        gave = max(gave, float(found.excess[0]))
    assert gave > 0.01
