"""Networks made of linear state-space models: the same runs, and room for products."""

import dataclasses
import math
from functools import cache

import jax
import numpy as np
import pytest
from hidden_problems import GAIN, WINDOW, X1, network, truth
from state_plants import made

from jaxnarx.data import Dataset
from jaxnarx.data.batch import stack_records
from jaxnarx.errors import SpecError
from jaxnarx.linear import increase_degree, set_state_ranges, state_network
from jaxnarx.linear.state_space.model import StateSpace, simulate_states
from jaxnarx.linear.state_space.network import FREE_DEVIATIONS, products
from jaxnarx.models._assemble import OUTPUT_MARGIN
from jaxnarx.simulation import first_anchor, make_drive, make_masks, run, simulate


@cache
def model() -> StateSpace:
    """Three states, two inputs, two outputs far from zero and of other sizes."""
    rng = np.random.default_rng(11)
    a = np.array([[0.7, 0.3, 0.0], [-0.3, 0.6, 0.1], [0.0, 0.0, 0.8]])
    b, c, d = (0.3 * rng.normal(size=s) for s in ((3, 2), (2, 3), (2, 2)))
    scale = np.array([[300.0], [0.02]])
    offsets = np.array([0.1, 0.0, -0.2]), np.array([5e3, -0.1])
    return StateSpace(
        a, b, offsets[0], scale * c, scale * d, offsets[1], np.ones((2, 3)), np.ones(1)
    )


@cache
def runs() -> tuple[Dataset, list[np.ndarray]]:
    """Its records, and its states before every sample."""
    rng = np.random.default_rng(12)
    us = [2.0 + rng.normal(size=(n, 2)) for n in (60, 45)]
    xs = [simulate_states(model(), u, np.ones(3)) for u in us]
    one = model()
    ys = [
        x @ one.c.T + u @ one.d.T + one.output_offset
        for x, u in zip(xs, us, strict=True)
    ]
    return made(us, ys), xs


@pytest.mark.parametrize("degree", [1, 2])
def test_its_run_is_that_of_the_model(degree):
    data, xs = runs()
    net = state_network(model(), data, (0, 1), degree=degree, window=20)
    assert (net.hidden, net.window, net.history) == (3, 20, 1)
    batch = stack_records(data)
    drive = make_drive(net, batch)
    measured = np.array(drive.measured)
    for n, x in enumerate(xs):
        # z(t) = x(t + 1): before sample 1 stands x(1).
        measured[n, 0, 2:] = x[1]
    drive = dataclasses.replace(drive, measured=jax.device_put(measured))
    anchor = jax.device_put(first_anchor(make_masks(net, batch)))
    found = np.asarray(run(net, drive, anchor))
    gain = np.asarray(net.gain)[[2, 3]]
    for n, (record, x) in enumerate(zip(data, xs, strict=True)):
        y = found[n, 1 : len(record), :2] * gain
        np.testing.assert_allclose(y, record.y[1:], rtol=1e-11)
        states = found[n, 1 : len(record) - 1, 2:]
        np.testing.assert_allclose(states, x[2:], atol=1e-12)


def test_products_are_all_there_and_begin_at_nothing():
    data, _ = runs()
    linear = state_network(model(), data, (0, 1))
    for degree in (2, 3):
        full = increase_degree(linear, degree)
        direct = state_network(model(), data, (0, 1), degree=degree)
        assert jax.tree.structure(full) == jax.tree.structure(direct)
        for a, b in zip(jax.tree.leaves(full), jax.tree.leaves(direct), strict=True):
            np.testing.assert_array_equal(a, b)
        # Of three states and two inputs.
        assert full.models[0].local.used.shape == (1, math.comb(5 + degree, degree))
        for high, low in zip(full.equations(), linear.equations(), strict=True):
            left = {name: c for name, c in high["terms"] if c != 0}
            assert left == {name: c for name, c in low["terms"] if c != 0}
    with pytest.raises(SpecError, match="has products of degree 3; degree 2 is lower"):
        increase_degree(increase_degree(linear, 3), 2)
    table = {tuple(sorted(row)) for row in products(3, 2).tolist()}
    assert len(table) == len(products(3, 2)) == 10


def test_a_network_can_be_of_some_outputs_and_ranges_are_those_of_the_data():
    data, _ = runs()
    one = dataclasses.replace(
        model(),
        c=model().c[1:],
        d=model().d[1:],
        output_offset=model().output_offset[1:],
    )
    net = state_network(one, data, (1,))
    assert net.output_names == ["w"] and net.computed_names == ["w", "x1", "x2", "x3"]
    y = np.concatenate([r.y[:, 1] for r in data])
    gain = float(net.gain[3])
    np.testing.assert_allclose([net.low[3], net.high[3]], [y.min(), y.max()])
    low, high = y.min() - OUTPUT_MARGIN * np.ptp(y), y.max() + OUTPUT_MARGIN * np.ptp(y)
    np.testing.assert_allclose(net.lower[0] * gain, low, rtol=1e-12)
    np.testing.assert_allclose(net.upper[0] * gain, high, rtol=1e-12)
    np.testing.assert_array_equal(net.upper[1:], FREE_DEVIATIONS)
    np.testing.assert_array_equal(net.low[4:], -2.0)
    np.testing.assert_array_equal(net.gain[4:], 1.0)


@pytest.mark.parametrize("bad", [{"degree": 0}, {"window": 0}])
def test_degree_and_window_are_one_at_least(bad):
    with pytest.raises(SpecError, match="at least 1"):
        state_network(model(), runs()[0], (0, 1), **bad)


# the ranges of hidden channels ----------------------------------------------------


def test_settled_holds_hidden_channels_to_where_the_data_drive_them():
    net, given = network(), truth()
    found = set_state_ranges(net, given.data)
    states = [run[1:] for run in simulate(net, given.data).value.hidden]
    low, high = (f(np.concatenate(states), axis=0) for f in (np.min, np.max))
    np.testing.assert_allclose(found.low[X1:], low, rtol=1e-12)
    np.testing.assert_allclose(found.high[X1:], high, rtol=1e-12)
    wider, gain = OUTPUT_MARGIN * (high - low), GAIN[X1:]
    # Bounds are of scaled values.
    np.testing.assert_allclose(found.lower[2:] * gain, low - wider, rtol=1e-12)
    np.testing.assert_allclose(found.upper[2:] * gain, high + wider, rtol=1e-12)
    for name, count in (("low", 4), ("high", 4), ("lower", 2), ("upper", 2)):
        old, new = (np.asarray(getattr(n, name))[:count] for n in (net, found))
        np.testing.assert_array_equal(new, old)
    before, after = (simulate(n, given.data).value for n in (net, found))
    for a, b in zip(before.outputs, after.outputs, strict=True):
        # Windows are estimated with another prior, see `tests/simulation`.
        np.testing.assert_allclose(b, a, atol=3e-4)


def test_records_too_short_to_run_and_samples_before_the_begin_do_not_widen_it():
    net, data = network(), truth(lengths=(60, WINDOW)).data
    found, run = set_state_ranges(net, data), simulate(net, data)
    assert run.status_name == "too_short"
    states = run.value.hidden[0][1:]
    np.testing.assert_allclose(found.low[X1:], states.min(axis=0), atol=1e-9)
    np.testing.assert_allclose(found.high[X1:], states.max(axis=0), atol=1e-9)
