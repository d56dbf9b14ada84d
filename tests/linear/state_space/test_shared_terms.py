"""Normal equations of networks in which everything computed has the same terms."""

import dataclasses
from functools import cache

import jax
import numpy as np
import pytest
from state_plants import made, plant, records

from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.linear import increase_degree, set_state_ranges, state_network
from jaxnarx.linear.state_space.gates import add_gates
from jaxnarx.linear.state_space.regions import pad_models
from jaxnarx.models import AdditiveGates, Network
from jaxnarx.refinement import shared_terms
from jaxnarx.refinement._refine import make_task
from jaxnarx.refinement.gauss_newton import normal_equations
from jaxnarx.refinement.initial import initial_conditions
from jaxnarx.refinement.layout import freeze, make_layout
from jaxnarx.refinement.shared_terms import shares_terms

BAND = (0.5, 2.0)


@cache
def data_of(kind: str) -> Dataset:
    """Of two outputs, or of one."""
    data = records()
    if kind != "two outputs":
        return data
    ys = [np.concatenate([r.y, r.y[::-1]], axis=1) for r in data]
    return made([r.u for r in data], ys)


@cache
def network(kind: str) -> Network:
    """Two hidden states, with products, with gates, or with gates of delayed inputs."""
    data = data_of(kind)
    if kind == "two outputs":
        one = plant()
        both = {name: np.tile(getattr(one, name), (2, 1)) for name in ("c", "d")}
        both["output_offset"] = np.tile(one.output_offset, 2)
        two = dataclasses.replace(one, **both)
        net = set_state_ranges(state_network(two, data, (0, 1), window=15), data)
        return add_gates(net, data, 3, 1)
    delayed = [(0, 3)] if kind == "delayed" else None
    net = state_network(plant(), data, (0,), window=15, delayed=delayed)
    net = set_state_ranges(net, data)
    if kind == "products":
        return increase_degree(net, 2)
    return net if kind == "linear" else add_gates(net, data, 3, 1)


@pytest.mark.parametrize(
    "kind", ["linear", "products", "gates", "delayed", "two outputs"]
)
@pytest.mark.parametrize("held", [False, True])
def test_they_are_those_of_any_network(kind, held):
    """`held`: the states leave their range now and then."""
    net, data = network(kind), data_of(kind)
    if held:
        upper = np.array(net.upper)
        upper[len(net.modelled) :] *= 0.3
        net = dataclasses.replace(net, upper=jax.device_put(upper))
    task, _ = make_task(net, data)
    task = task.with_hidden_starts(net)
    initial = initial_conditions(net, task, measured=kind == "products")
    layout = make_layout(net, None, BAND, initial, every=True, dense=True)
    assert shares_terms(layout)
    rng = np.random.default_rng(4)
    u = np.asarray(layout.gather(net))
    u = u + 0.05 * rng.normal(size=u.size)
    at = task.drive, task.anchors(None), task.weight
    plain = normal_equations(layout, u, *at)
    shared = dataclasses.replace(layout, shared_terms=True)
    for found, known in zip(normal_equations(shared, u, *at), plain, strict=True):
        scale = np.abs(known).max()
        np.testing.assert_allclose(found, known, rtol=1e-11, atol=1e-13 * scale)


def test_of_long_runs_the_gram_is_that_of_every_kth_sample(monkeypatch):
    net, data = network("gates"), data_of("gates")
    task, _ = make_task(net, data)
    layout = make_layout(net, None, BAND, dense=True)
    shared = dataclasses.replace(layout, shared_terms=True)
    u = np.asarray(layout.gather(net))
    at = task.drive, task.anchors(None)
    whole = normal_equations(shared, u, *at, task.weight)
    weight = np.asarray(task.weight)
    some = np.zeros_like(weight)
    some[:, ::3] = 3 * weight[:, ::3]
    few = normal_equations(shared, u, *at, jax.device_put(some))
    size = task.weight[..., 0].size // 3
    monkeypatch.setattr(shared_terms, "GRAM_SAMPLES", size)
    jax.clear_caches()
    found = normal_equations(shared, u, *at, task.weight)
    jax.clear_caches()
    for one, known in zip(found, (*whole[:2], few[2]), strict=True):
        scale = np.abs(known).max()
        np.testing.assert_allclose(one, known, rtol=1e-11, atol=1e-13 * scale)


def test_coefficients_that_no_term_uses_have_no_entry():
    net = network("gates")
    layout = make_layout(net, None, BAND, dense=True)
    # Of every output four coefficients and three constants; three gates of three.
    assert layout.parameters == 3 * (4 + 3) + 3 * 3 + 3
    u = np.asarray(layout.gather(net))
    again = layout.place(u)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(net), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-14)
    wide = make_layout(net, None, BAND)
    assert wide.parameters == 3 * 4 * 4 + 3 * 3 + 3
    assert len(layout.coefficients()) == 21 and len(wide.coefficients()) == 48


@pytest.mark.parametrize("delayed", [[(1, 0)], [(0, -1)], [(0, 0), (0, 1)], []])
def test_delayed_inputs_that_are_none_are_refused(delayed):
    with pytest.raises(SpecError, match="delayed must name one of 1 inputs"):
        state_network(plant(), records(), (0,), delayed=delayed)


def test_other_networks_do_not_share_terms():
    net = network("gates")
    assert shares_terms(make_layout(net, None, BAND, dense=True))
    frozen = freeze(net, partition=False)
    assert not shares_terms(make_layout(net, frozen, BAND, dense=True))
    regions = pad_models(network("linear"), 2)
    assert not shares_terms(make_layout(regions, None, BAND))
    gates = net.models[1].validity
    assert isinstance(gates, AdditiveGates)
    other = np.array(gates.direction) + 0.1
    moved = dataclasses.replace(gates, direction=jax.device_put(other))
    model = dataclasses.replace(net.models[1], validity=moved)
    apart = dataclasses.replace(net, models=(net.models[0], model, net.models[2]))
    assert not shares_terms(make_layout(apart, None, BAND))
