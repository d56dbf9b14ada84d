"""The state-space form of networks: step by step it is the free run, for every kind."""

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from common import some
from kinds import EVERY, problem

import jaxnarx as jnx
from jaxnarx.errors import SpecError

ROUNDING = 1e-11
"""Forty stable steps on values of order ten."""


NAMES = some(
    EVERY,
    *("coupled, by own output", "own feedback", "filters beyond", "hold", "hidden"),
)


def record(name: str):
    """Inputs, outputs and the reported free run of the record."""
    net, data = problem(name)
    rows = common.rows_of(data, 0)
    inputs = [s for s in range(2)] + [s for s in net.used if s >= 2]
    outputs = np.array([2 + o for o in net.modelled])
    return net, rows[:, inputs], rows[:, outputs], jnx.simulate(net, data).value[0]


@pytest.mark.parametrize("name", NAMES)
def test_a_call_is_the_free_run(name):
    net, u, y, run = record(name)
    found = eqx.filter_jit(lambda net, u, y: net(u, y))(net, u, y[: net.before])
    assert np.nanstd(run) > 0.1
    common.assert_said(found, run, ROUNDING)


@pytest.mark.parametrize("name", NAMES)
def test_steps_behind_a_measured_start_are_the_free_run(name):
    net, u, y, run = record(name)
    first = net.before

    @eqx.filter_jit
    def both(net, u, y):
        state = net.init(y[:first], u[:first])
        steps = jax.lax.scan(lambda x, u: net.step(x, u), state, u[first:])[1]
        return state, steps, net(u[first:], state)

    state, steps, call = both(net, u, y)
    common.assert_said(steps, run[first:], ROUNDING)
    common.assert_said(call, run[first:], ROUNDING)
    names = jnx.state_space(net).names
    assert len(names) == len(set(names)) == len(state)
    # What is named after a lag is that lag.
    channels = net.channels.names
    for channel, column in (("a", 0), ("b", 1)):
        assert channels[column] == channel
        for lag in (1, 2):
            if f"{channel}[t-{lag}]" in names:
                at = names.index(f"{channel}[t-{lag}]")
                assert state[at] == u[first - lag, column]


@pytest.mark.parametrize("name", ["by own output", "own feedback", "filters beyond"])
def test_at_rest_nothing_moves(name):
    net, u, y, _ = record(name)
    form = jnx.state_space(net)

    @eqx.filter_jit
    def rest(net, u):
        form = jnx.state_space(net)
        x, found = form.equilibrium(u)
        return x, found, form.f(x, u), net(jnp.tile(u, (300, 1)), "steady")

    x, found, again, steady = rest(net, 0.5 * u[3])
    assert found
    np.testing.assert_allclose(again, x, atol=1e-8)
    np.testing.assert_allclose(steady, np.tile(steady[:1], (300, 1)), atol=1e-7)
    # From zero outputs it comes to rest there, if it is the only one.
    zeros = eqx.filter_jit(lambda net, u: net(u, "zeros"))(
        net, np.tile(0.5 * u[3], (300, 1))
    )
    np.testing.assert_allclose(zeros[-1], steady[0], atol=1e-6)
    assert form.outputs == net.output_names and form.inputs[:2] == ["a", "b"]


@pytest.mark.parametrize("name", ["own feedback", "filters beyond"])
def test_jacobians_are_central_differences(name):
    net, u, y, _ = record(name)
    first, step = net.before, 1e-5

    @eqx.filter_jit
    def found(net, u, y):
        form = jnx.state_space(net)
        x = net.init(y[:first], u[:first])
        at = u[first]
        both = lambda x, u: jnp.concatenate([form.f(x, u), form.h(x, u)])  # noqa: E731
        by_x = jnp.stack(
            [
                (both(x + e, at) - both(x - e, at)) / (2 * step)
                for e in step * jnp.eye(len(x))
            ],
            axis=1,
        )
        by_u = jnp.stack(
            [
                (both(x, at + e) - both(x, at - e)) / (2 * step)
                for e in step * jnp.eye(len(at))
            ],
            axis=1,
        )
        return form.jacobians(x, at), by_x, by_u

    (a, b, c, d), by_x, by_u = found(net, u, y)
    np.testing.assert_allclose(np.concatenate([a, c]), by_x, atol=1e-6)
    np.testing.assert_allclose(np.concatenate([b, d]), by_u, atol=1e-6)


def test_what_does_not_fit_is_refused():
    net, u, y, _ = record("coupled")
    with pytest.raises(SpecError, match="a column for each of a, b"):
        net(u[:, :1], y)
    with pytest.raises(SpecError, match="start has 1 samples of the outputs"):
        net(u, y[:1])
    with pytest.raises(SpecError, match="a column for each of y, w"):
        net(u, y[:, :1])
    with pytest.raises(SpecError, match="make it with network.init"):
        net.step(jnp.zeros(3), u[0])
    with pytest.raises(SpecError, match="'steady' or 'zeros'"):
        net(u, "somewhere")
    with pytest.raises(SpecError, match="the inputs of the same samples"):
        net.init(y[:3], u[:4])
