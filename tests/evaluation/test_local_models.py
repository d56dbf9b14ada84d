"""Gains and poles of local models: closed forms, and a step that has settled."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from common import A, B, Part, Y, from_rows, network

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.evaluation.local_models import local_behaviour
from jaxnarx.models import Network, hold_to_range
from jaxnarx.regressors import Laguerre, LowPass, Variables

GAIN = {"a": 2.0, "b": 0.5, "y": 10.0, "w": 3.0}
"""Of `common`: what scaled coefficients belong to."""


@pytest.fixture(scope="module")
def data() -> Dataset:
    rng = np.random.default_rng(4)
    return from_rows([rng.uniform(-1, 1, (80, 4)) * [1.0, 1.0, 3.0, 3.0]])


def two_models() -> Network:
    """x = a(t), b(t-1), y(t-1), y(t-2), w(t-1), scaled; by the sign of a two models.

    First: 0.3 a + 0.4 b + 0.5 y1 + 0.1 y2 + 0.2 w; second: 0.3 a^2 b + 1.2 y1.
    """
    first = [((0, 0, 1), 0.3), ((0, 0, 2), 0.4), ((0, 0, 3), 0.5)]
    first += [((0, 0, 4), 0.1), ((0, 0, 5), 0.2), ((0, 0, 0), 7.0)]
    second = [((1, 1, 2), 0.3), ((0, 0, 3), 1.2)]
    part = Part(
        [first, second],
        scheduling=((A, 0),),
        offset=[-1.0],
        span=[2.0],
        centre=[[0.0], [1.0]],
        width=[[0.2], [0.2]],
    )
    return network([part], spare_models=1)


def test_gains_and_poles_of_a_linear_local_model(data):
    first, second = local_behaviour(two_models(), data)
    assert (first.output, first.model, first.over) == ("y", 1, ("a[t]",))
    left = 1 - 0.5 - 0.1
    for name, theta in {"a": 0.3, "b": 0.4, "w": 0.2}.items():
        expected = theta / left * GAIN["y"] / GAIN[name]
        np.testing.assert_allclose(first.gain[name], expected, rtol=1e-12)
    # z^2 = 0.5 z + 0.1
    pole = (0.5 + np.sqrt(0.25 + 0.4)) / 2
    np.testing.assert_allclose(first.modulus, pole, rtol=1e-12)
    np.testing.assert_allclose(first.time_constant, -0.1 / np.log(pole), rtol=1e-12)
    # Each where it leads, all points together once.
    assert np.all(first.place < 0) and np.all(second.place > 0)
    assert len(first.place) + len(second.place) == 80 - 2
    # The second runs away: it has no gain.
    np.testing.assert_allclose(second.modulus, 1.2, rtol=1e-12)
    assert np.all(np.isinf(second.time_constant))
    assert set(second.gain) == {"a", "b"} and np.all(np.isnan(second.gain["a"]))


def test_a_network_with_limits_is_looked_at_where_it_sees_its_inputs(data):
    """Beyond the range the slopes are those at its edge."""
    net = two_models()
    low, high = jnp.array([-0.4, -0.3, -9, -9]), jnp.array([0.5, 0.6, 9, 9])
    held = hold_to_range(dataclasses.replace(net, low=low, high=high), outside="hold")
    inside = [np.clip(r.u, [-0.4, -0.3], [0.5, 0.6]) for r in data]
    by_hand = from_rows(
        [np.hstack([u, r.y]) for u, r in zip(inside, data, strict=True)]
    )
    for a, b in zip(
        local_behaviour(held, data), local_behaviour(net, by_hand), strict=True
    ):
        np.testing.assert_array_equal(a.place, b.place)
        np.testing.assert_array_equal(a.modulus, b.modulus)
        for name in a.gain:
            np.testing.assert_array_equal(a.gain[name], b.gain[name])


def test_slopes_are_those_of_the_products(data):
    """Without the unstable feedback: d(0.3 a^2 b) by a is 0.6 a b, at every point."""
    net = two_models()
    local = net.models[0].local
    slot = local.used & (jnp.abs(local.coefficient - 1.2) > 1e-9)
    tame = dataclasses.replace(
        net, models=(dataclasses.replace(net.models[0], local=_with(local, slot)),)
    )
    _, second = local_behaviour(tame, data, over=["a[t]", "b[t-1]"], points=50)
    assert second.over == ("a[t]", "b[t-1]")
    a, b = (second.place / [GAIN["a"], GAIN["b"]]).T
    ratio = GAIN["y"] / GAIN["a"]
    np.testing.assert_allclose(second.gain["a"], 0.6 * a * b * ratio, rtol=1e-12)
    expected = 0.3 * a**2 * GAIN["y"] / GAIN["b"]
    np.testing.assert_allclose(second.gain["b"], expected, rtol=1e-12)
    assert np.all(second.modulus == 0) and np.all(second.time_constant == 0)


def _with(local, used):
    return dataclasses.replace(local, used=used)


def test_a_gain_through_filters_is_what_a_step_settles_at(data):
    table = [(A, 0, LowPass(2.0)), (A, 3, Laguerre(1.0, 2)), (B, 0, None), (Y, 1, None)]
    part = Part([[((1,), 0.3), ((2,), 0.2), ((3,), 0.1), ((4,), 0.6)]])
    net = dataclasses.replace(network([part]), variables=Variables.of(table))
    (only,) = local_behaviour(net, data, over=["b[t]"])
    # At frequency zero a low-pass is 1 and a Laguerre function of any order
    # sqrt((1 + p) / (1 - p)), p = exp(-T / time constant).
    pole = np.exp(-0.1)
    settled = 0.3 + 0.2 * np.sqrt((1 + pole) / (1 - pole))
    expected = settled / (1 - 0.6) * GAIN["y"] / GAIN["a"]
    np.testing.assert_allclose(only.gain["a"], expected, rtol=1e-9)


def test_wrong_use_is_told(data):
    net = network([Part([[((1,), 1.0)]])])
    with pytest.raises(SpecError, match="no scheduling variable"):
        local_behaviour(net, data)
    with pytest.raises(SpecError, match="no model of output 'w'"):
        local_behaviour(net, data, output="w")
    with pytest.raises(DataError, match="2 valid ones"):
        local_behaviour(two_models(), _short(data))


def _short(data: Dataset) -> Dataset:
    record = data.records[0]
    short = dataclasses.replace(
        record, u=record.u[:2], y=record.y[:2], valid=record.valid[:2]
    )
    return dataclasses.replace(data, records=(short,))
