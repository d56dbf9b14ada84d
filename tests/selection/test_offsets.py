"""Channels far from zero: the same terms and the same free run, or a status."""

import dataclasses
import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from common import some

from jaxnarx.data import Dataset
from jaxnarx.partition import grow
from jaxnarx.refinement import refine
from jaxnarx.regressors import Pool, evaluate, polynomial_pool
from jaxnarx.regressors.centring import Centring
from jaxnarx.selection import select
from jaxnarx.settings import (
    Backward,
    ForwardOLS,
    Global,
    Lolimot,
    SigmoidTree,
    SimulationError,
    SimulationOLS,
    StepwiseF,
)
from jaxnarx.simulation import simulate
from jaxnarx.solution import RESULTS

OFFSETS = (0.0, 1e2, 1e4, 1e6)
SCALES = (1e-6, 1e6)
METHODS = {
    "forward": ForwardOLS(max_terms=10),
    "stepwise": StepwiseF(max_terms=10),
    "backward": Backward(max_terms=10),
}
PAIRS = [("forward", "u"), ("stepwise", "u"), ("backward", "u")]
PAIRS += [(method, "y") for method, _ in PAIRS]


def data_of(*, u: float = 0.0, y: float = 0.0, scale: float = 1.0) -> Dataset:
    """Two records of a quadratic process, channels moved by multiples of a spread."""
    rng = np.random.default_rng(5)
    inputs, outputs = [], []
    for _ in range(2):
        x = np.repeat(rng.uniform(-1, 1, (41, 2)), 5, axis=0)[:200]
        out = np.zeros(200)
        noise = 0.01 * rng.standard_normal(200)
        for t in range(1, 200):
            a, b, past = x[t - 1, 0], x[t - 1, 1], out[t - 1]
            out[t] = 0.6 * past + 0.3 * a + 0.2 * a * b - 0.05 * past**2 + noise[t]
        inputs.append((x + [u * 0.58, 0.0]) * [scale, 1.0])
        outputs.append((out + y * 0.5)[:, None] * scale)
    return Dataset.from_arrays(
        inputs, outputs, inputs=["u1", "u2"], outputs=["y"], sample_time=1.0
    )


def pool_of(degree: int) -> Pool:
    return polynomial_pool(
        data_of().channels, input_lags=(1, 2), output_lags=(1,), degree=degree
    )


def relative_run(network, data: Dataset) -> np.ndarray:
    """Free run about the mean of the measured output, over its spread."""
    solution = simulate(network, data)
    assert solution.status == RESULTS.ok
    measured = np.concatenate([r.y for r in data])
    run = np.concatenate(list(solution.value.outputs))
    return (run - measured.mean()) / measured.std()


def moved(channel: str, offset: float, scale: float = 1.0) -> Dataset:
    return data_of(scale=scale, **{channel: offset})


@pytest.mark.parametrize(("method", "channel"), some(PAIRS, PAIRS[0], PAIRS[4]))
def test_linear_terms_and_their_free_run_do_not_hang_on_offset_and_scale(
    method, channel
):
    # 1e6 spreads leave ten digits of the data themselves; a run may lose some more.
    cases = [(c, 1.0) for c in OFFSETS] + [(1e6, s) for s in SCALES]
    runs, names = [], []
    products = tuple(set(pool_of(2).names) - set(pool_of(1).names))
    linear = dataclasses.replace(METHODS[method], forbidden=products)
    for offset, scale in cases:
        data = moved(channel, offset, scale)
        chosen = select(pool_of(2), data, linear)
        assert chosen.is_okay, chosen.detail
        names.append(chosen.value.names)
        network = grow(chosen.value, data, Global())
        assert network.status == RESULTS.ok
        runs.append(relative_run(network.value, data))
    assert all(own == names[0] for own in names)
    assert "u1[t-1]" in names[0] and "y[t-1]" in names[0]
    for run in runs:
        np.testing.assert_allclose(run, runs[0], atol=1e-7)


@pytest.mark.parametrize(("method", "channel"), some(PAIRS, PAIRS[3], PAIRS[2]))
def test_quadratic_terms_are_the_same_from_a_hundred_spreads_on(method, channel):
    # Below, a product can stand for itself: other terms, but the same error.
    errors, names, runs = [], [], []
    for offset in OFFSETS:
        data = moved(channel, offset)
        chosen = select(pool_of(2), data, METHODS[method])
        assert chosen.is_okay, chosen.detail
        names.append(chosen.value.names)
        network = grow(chosen.value, data, Global())
        assert network.status == RESULTS.ok
        runs.append(relative_run(network.value, data))
        measured = relative_measured(data)
        errors.append(np.sqrt(np.mean((runs[-1] - measured) ** 2)))
    assert names[1] == names[2] == names[3]
    assert max(errors) < 1.1 * errors[0] < 0.1
    # Coefficients of terms that cancel to 1e-12 of themselves hold four digits.
    np.testing.assert_allclose(runs[2], runs[1], atol=1e-6)
    np.testing.assert_allclose(runs[3], runs[1], atol=2e-3)


def relative_measured(data: Dataset) -> np.ndarray:
    measured = np.concatenate([r.y for r in data])
    return (measured - measured.mean()) / measured.std()


@pytest.mark.parametrize(
    ("partition", "channel"),
    some(itertools.product(("lolimot", "tree"), "uy"), ("lolimot", "y"), ("tree", "u")),
)
def test_growth_and_refinement_do_not_hang_on_the_offset(partition, channel):
    method = {
        "lolimot": Lolimot(scheduling=("u1[t-1]",), max_models=3),
        "tree": SigmoidTree(scheduling=("u1[t-1]",), max_models=3),
    }[partition]
    grown, refined, loss = [], [], []
    for offset in (0.0, 1e2, 1e6):
        data = moved(channel, offset)
        network = grow(pool_of(1), data, method)
        assert network.is_okay, network.detail
        steps = SimulationError(horizons=(), max_steps=4)
        better = refine(network.value, data, steps)
        assert better.is_okay
        assert better.stats["loss"] < better.stats["loss_start"]
        grown.append(relative_run(network.value, data))
        refined.append(relative_run(better.value, data))
        loss.append(better.stats["loss"])
    for run in grown[1:]:
        np.testing.assert_allclose(run, grown[0], atol=1e-6)
    # Without an offset the damping acts on other coordinates, in which a few steps may
    # end elsewhere; from a hundred spreads on the coordinates are the same.
    assert loss[1] < 1.1 * loss[0]
    np.testing.assert_allclose(loss[2], loss[1], rtol=1e-4)
    np.testing.assert_allclose(refined[2], refined[1], atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("channel", ["u", "y"])
def test_terms_chosen_on_the_free_run_do_not_hang_on_the_offset(channel):
    method = SimulationOLS(max_terms=5, shortlist=10, steps=4, patience=1)
    losses, names = [], []
    for offset in (0.0, 1e2, 1e6):
        chosen = select(pool_of(1), moved(channel, offset), method)
        assert chosen.is_okay, chosen.detail
        losses.append(chosen.stats["loss"])
        names.append(set(chosen.value.names))
    assert names[0] == names[1] == names[2]
    np.testing.assert_allclose(losses[1:], losses[0], rtol=1e-3)


def test_beyond_float64_a_status_names_the_channel():
    # Cubic terms of a channel at 1e6 spreads cancel to 1e-18 of themselves.
    chosen = select(
        pool_of(3), moved("u", 1e6), ForwardOLS(max_terms=12, forced="u1[t-1]^3")
    )
    assert chosen.status == RESULTS.unidentifiable
    assert "the mean of u1 is" in chosen.detail
    assert "offset" in chosen.detail


def test_collinear_candidates_are_listed():
    data = moved("u", 0.0)
    rows = [np.c_[r.u, r.u[:, 0] ** 2] for r in data]
    squared = Dataset.from_arrays(
        rows,
        [r.y for r in data],
        inputs=["u1", "u2", "w"],
        outputs=["y"],
        sample_time=1.0,
    )
    pool = polynomial_pool(
        squared.channels, input_lags=(1,), output_lags=(1,), degree=2
    )
    found = select(pool, squared, ForwardOLS(max_terms=15)).stats["passed_over"]
    # Of w and the square of u1 one is chosen.
    assert len({"w[t-1]", "u1[t-1]^2"} & set(found)) == 1


def test_two_channels_far_from_zero_are_no_copies_of_each_other():
    data = moved("u", 1e6)
    rows = [r.u + [0.0, 1e6] for r in data]
    both = Dataset.from_arrays(
        rows, [r.y for r in data], inputs=["u1", "u2"], outputs=["y"], sample_time=1.0
    )
    chosen = select(pool_of(1), both, ForwardOLS(max_terms=6))
    assert chosen.stats["passed_over"] == {}
    assert {"u1[t-1]", "u2[t-1]"} <= set(chosen.value.names)


@pytest.mark.parametrize(
    "factor",
    [
        [[0, 0], [0, 1], [0, 2], [1, 2], [1, 1]],
        [[0, 0], [1, 2], [1, 1]],
        [[0, 1], [1, 2]],
    ],
)
def test_reduced_columns_are_those_of_the_terms(factor):
    # Integers, so that the terms themselves are exact.
    rng = np.random.default_rng(1)
    v = np.r_[
        np.ones((1, 50)), rng.integers(90, 110, (1, 50)), rng.normal(size=(1, 50))
    ]
    centre = Centring(
        np.array([0.0, 100.0, 0.0]), np.array([1.0, 6.0, 1.0]), np.zeros(1)
    )
    table = np.array(factor, np.int32)
    r, back = centre.columns(table, jnp.asarray(v))
    np.testing.assert_allclose(back @ evaluate(table, jnp.asarray(v)), r, atol=1e-9)
