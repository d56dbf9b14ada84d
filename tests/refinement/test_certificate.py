"""Certificates of contraction: by products of matrices, and by pairs of runs."""

import dataclasses

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from common import A

import jaxnarx as jnx
from jaxnarx.confidence import apply_release_limits, attach_domain_and_intervals
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.models import (
    FLAG,
    HOLD,
    LINEAR,
    AbstractValidity,
    LogSigmoids,
    hold_to_range,
)
from jaxnarx.refinement import attach_certificate, certificate, rate_of
from jaxnarx.refinement._stability._certificate import _blocks

LOW, HIGH = np.array([-1.0, -1.0, -5.0, -2.0]), np.array([1.0, 1.0, 5.0, 2.0])


def local(a1: float, a2: float, more: tuple = ()):
    """y = a1 y1 + a2 y2 + u, and further terms."""
    return [((0, 3), a1), ((0, 4), a2), ((0, 1), 1.0), *more]


VARIABLES = ((A, 0), (A, 1), (2, 1), (2, 2))
"""a(t), a(t-1), y(t-1), y(t-2) as x_1 ... x_4."""


def network(models, outside=LINEAR, scheduling=((A, 0),)):
    part = common.Part(
        models,
        scheduling=scheduling,
        offset=(-4.0,) * len(scheduling),
        span=(8.0,) * len(scheduling),
        centre=[(0.2 + 0.5 * m,) * len(scheduling) for m in range(len(models))],
        width=[(0.2,) * len(scheduling)] * len(models),
    )
    net = common.network([part], variables=VARIABLES)
    low, high = jax.device_put((LOW, HIGH))
    net = dataclasses.replace(net, low=low, high=high)
    return hold_to_range(net, None, outside=outside)


def test_a_network_that_shares_its_feedback_has_one():
    net = network([local(1.2, -0.5)] * 2)
    found = certificate(net)
    assert found is not None
    modulus = np.abs(np.roots([1, -1.2, 0.5])).max()
    assert modulus <= found.rate < 1.05 * modulus


class Negative(AbstractValidity):
    """Weights (1.5, -0.5): they sum to one and are no average."""

    trained = ()
    spare: jax.Array

    def __call__(self, z, active):
        return jnp.stack([1.5 + 0 * z[0], -0.5 + 0 * z[0]])

    def limits(self, width_band):
        return self, self

    def check(self, models, dims):
        pass

    def regions(self, names, offset, span):
        return [{}, {}]


def test_weights_that_are_no_average_have_none():
    net = network([local(1.2, -0.5)] * 2)
    borders = LogSigmoids(jnp.array([0.4]), jnp.array(3.0))
    for validity, known in ((borders, True), (Negative(jnp.zeros(1)), False)):
        model = dataclasses.replace(net.models[0], validity=validity)
        other = dataclasses.replace(net, models=(model,))
        assert (certificate(other) is not None) == known
        assert (rate_of(attach_certificate(other)) < 1) == known


def test_borders_that_were_moved_past_one_another_have_none():
    net = network([local(1.2, -0.5)] * 3)
    borders = LogSigmoids(jnp.array([0.2, 0.8]), jnp.array(3.0))
    model = dataclasses.replace(net.models[0], validity=borders)
    net = dataclasses.replace(net, models=(model,))
    assert certificate(net) is not None
    turned = eqx.tree_at(
        lambda n: n.models[0].validity.border, net, borders.border[::-1]
    )
    assert certificate(turned) is None


def test_every_product_of_mixtures_shrinks_as_it_says():
    net = network([local(1.2, -0.5), local(0.4, 0.3)])
    found = certificate(net)
    assert found is not None and found.rate < 1
    blocks = _blocks(net)
    assert blocks is not None and len(blocks) == 1
    _, matrices = blocks[0]
    rng = np.random.default_rng(0)
    inverse = np.linalg.inv(found.factor)
    for _ in range(200):
        whole = np.eye(2)
        for k in range(1, 12):
            share = rng.dirichlet(np.ones(len(matrices)))
            whole = np.einsum("m,mij->ij", share, matrices) @ whole
            size = np.linalg.norm(found.factor @ whole @ inverse, 2)
            assert size <= found.rate**k * (1 + 1e-9)
    assert found.overshoot == pytest.approx(np.linalg.cond(found.factor))


def test_two_that_are_stable_alone_and_not_in_turn_have_none():
    one, other = local(1.8, -0.9), local(-1.8, -0.9)
    for models in ([one], [other]):
        assert certificate(network([models[0]] * 2)) is not None
    a, b = (np.array([[s * 1.8, -0.9], [1, 0]]) for s in (1, -1))
    assert np.abs(np.linalg.eigvals(a @ b)).max() > 1
    assert certificate(network([one, other])) is None


def test_none_is_told_where_the_past_decides():
    square = local(0.5, 0.1, more=(((3, 3), 0.01),))
    assert certificate(network([square])) is None
    own = network([local(0.5, 0.1)] * 2, scheduling=((2, 1),))
    assert certificate(own) is None
    unstable = network([local(1.01, 0.0)])
    assert certificate(unstable) is None


@pytest.mark.parametrize(("slope", "there"), [(0.15, True), (0.35, False)])
def test_past_outputs_times_inputs_are_followed_to_the_ends_of_the_range(slope, there):
    # gain of a is 2: scaled inputs reach from -1/2 to 1/2
    times_input = local(0.8, 0.0, more=(((1, 3), 2 * slope),))
    for outside in (HOLD, LINEAR):
        found = certificate(network([times_input], outside))
        assert (found is not None) == there
        if found is not None:
            assert found.rate == pytest.approx(0.8 + slope, rel=1e-6)
    assert certificate(network([times_input], FLAG)) is None


def test_runs_meet_at_least_as_fast_whatever_the_inputs():
    product = local(0.5, 0.2, more=(((1, 3), 0.4), ((1, 1), 0.3)))
    net = attach_certificate(network([local(1.0, -0.3), product], LINEAR))
    rate = rate_of(net)
    assert rate < 1
    factor = np.asarray(net.certificate)
    rng = np.random.default_rng(1)
    u = 3 * rng.uniform(-1, 1, (60, 2))
    names = {"inputs": ["a", "b"], "outputs": ["y", "w"], "sample_time": 0.1}
    runs = []
    for start in (-4.0, 4.0):
        y = np.full((60, 2), start)
        data = Dataset.from_arrays(u, y, **names)
        runs.append(jnx.simulate(net, data).value.outputs[0][:, 0])
    gap = (runs[0] - runs[1]) / float(np.asarray(net.gain)[2])
    state = np.stack([gap[1:], gap[:-1]])
    size = np.linalg.norm(factor @ state, axis=0)
    assert np.all(size[1:] <= rate * size[:-1] + 1e-12)


def test_a_file_keeps_it_and_a_merged_network_has_none(tmp_path):
    net = attach_certificate(network([local(1.2, -0.5), local(0.4, 0.3)]))
    jnx.save(net, tmp_path / "model.safetensors")
    again = jnx.load(tmp_path / "model.safetensors")
    assert rate_of(again) == rate_of(net) < 1
    assert rate_of(network([local(1.2, -0.5)])) == np.inf


def test_what_has_one_may_follow_its_inputs_far_beyond():
    data = common.from_rows([common.signals(200, seed) for seed in range(3)])
    net = network([local(0.5, 0.1)] * 2)
    found = attach_domain_and_intervals(apply_release_limits(net), data)
    assert found.certificate is not None and found.domain is not None
    assert found.outside == FLAG
    assert float(found.upper[0]) > 50 * float(net.high[2]) / float(net.gain[2])
    few = jnx.SimulationError(horizons=(), window_steps=0, max_steps=1)
    again = jnx.refine(found, data, few).value
    width = float(again.high[2] - again.low[2]) / float(again.gain[2])
    assert again.certificate is None
    assert float(again.upper[0] - again.lower[0]) == pytest.approx(1.5 * width)
    own = network([local(0.5, 0.1)] * 2, scheduling=((2, 1),))
    found = attach_domain_and_intervals(apply_release_limits(own), data)
    assert found.certificate is None and found.outside == LINEAR
    np.testing.assert_array_equal(found.upper, own.upper)


def answered(net, noise: float = 0.0) -> Dataset:
    """Records of what a network answers to steps within its ranges."""
    rng = np.random.default_rng(4)
    names = {"inputs": ["a", "b"], "outputs": ["y", "w"], "sample_time": 0.1}
    u = [np.repeat(rng.uniform(-1, 1, (15, 2)), 20, axis=0) for _ in range(2)]
    still = [np.zeros((300, 2)) for _ in u]
    run = jnx.simulate(net, Dataset.from_arrays(u, still, **names)).value.outputs
    y = [np.concatenate([one, one], axis=1) for one in run]
    y = [one + noise * rng.normal(size=one.shape) for one in y]
    return Dataset.from_arrays(u, y, **names)


def test_refinement_keeps_a_certificate_that_it_would_lose():
    truth = network([local(1.2, -0.6), local(-1.2, -0.6)])
    start = attach_certificate(network([local(0.5, -0.2), local(-0.5, -0.2)]))
    assert start.certificate is not None and certificate(truth) is None
    data = answered(truth, noise=0.01)
    few = jnx.SimulationError(horizons=(10,), max_steps=6, window_steps=4)
    free = jnx.refine(start, data, few).value
    assert certificate(free) is None and free.certificate is None
    kept = jnx.refine(start, data, dataclasses.replace(few, stable=True))
    assert rate_of(kept.value) < 1
    assert kept.value.upper == start.upper
    errors = [
        sum(
            float(np.sum((r.y[:, :1] - y)[s] ** 2))
            for r, y, s in zip(data, run.outputs, run.scored, strict=True)
        )
        for run in (jnx.simulate(n, data).value for n in (start, kept.value, free))
    ]
    assert errors[2] < errors[1] < errors[0]


def test_a_start_without_a_certificate_cannot_keep_one():
    bare = network([local(1.8, -0.9), local(-1.8, -0.9)])
    with pytest.raises(SpecError, match="no certificate to keep"):
        jnx.refine(bare, answered(bare), jnx.SimulationError(stable=True))
