"""The closed form of the free run with common feedback, against the free run itself."""

import sys
from pathlib import Path

import numpy as np
import pytest

import jaxnarx as jnx

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments" / "gengine1"))
from output_error import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    Prepared,
    cross_validated,
    denominator,
    equations,
    network,
    whole,
)

FEEDBACK = denominator((0.4, 0.2), 0.1)
TIMES = [np.arange(n) for n in (90, 120, 70, 100)]
WAVES = np.array([[0.31, 0.23]])
SHARE = np.array([0.5, 0.4])


@pytest.fixture(scope="module")
def data() -> jnx.Dataset:
    """Four records alike, and an output that no model of the test makes."""
    rng = np.random.default_rng(6)
    us = [np.sin(rng.uniform(0, 6, (1, 2)) + WAVES * t[:, None]) for t in TIMES]
    ys = [u[:, :1] * u[:, 1:] + rng.normal(0, 0.3, (len(u), 1)) + 1.0 for u in us]
    return jnx.Dataset.from_arrays(
        us, ys, inputs=["a", "b"], outputs=["y"], sample_time=0.1
    )


@pytest.fixture(scope="module")
def make(data):
    """Network with these coefficients: two regions, affine in two inputs and a
    lag."""
    pool = jnx.polynomial_pool(
        data.channels, input_lags={"a": (0, 2), "b": (1,)}, output_lags=(1, 2), degree=1
    )
    validity = whole(2).halved(0, 1).gaussians(SHARE)

    def build(theta=None, source=data):
        scheduling = ["a[t]", "b[t-1]"]
        return network(pool, source, scheduling, validity, FEEDBACK, theta)

    return build


@pytest.fixture(scope="module")
def found(data, make):
    return equations(make(), Prepared.of(make(), data), FEEDBACK, thin=1)


def squares(net: jnx.Network, data: jnx.Dataset) -> tuple[np.ndarray, int]:
    """Sum of squared free-run errors of every record, and limited samples in all."""
    run = jnx.simulate(net, data).value
    errors = [
        (r.y - y)[m] for r, y, m in zip(data, run.outputs, run.scored, strict=True)
    ]
    return np.array([e @ e for e in errors]), sum(int(x.sum()) for x in run.limited)


def test_loss_is_that_of_the_free_run(data, make, found):
    everything = np.ones(len(data), bool)
    theta = found.solve(everything, 1e-6)
    for value in (theta, 0.9 * theta):
        expected, limited = squares(make(value.reshape(2, -1)), data)
        assert limited == 0
        own = [found.loss(rows, value) for rows in np.eye(len(data), dtype=bool)]
        # Expanded squares lose digits in proportion to the output's own square.
        np.testing.assert_allclose(own, expected, atol=1e-10 * found.square.sum())


def test_solution_is_the_least(data, found):
    everything = np.ones(len(data), bool)
    theta = found.solve(everything, 1e-10)
    gradient = found.gram.sum(axis=0) @ theta - found.right.sum(axis=0)
    power = np.sqrt(np.diagonal(found.gram.sum(axis=0)) * found.square.sum())
    assert np.abs(gradient / power).max() < 1e-8


def test_records_left_out_are_judged_by_the_others(data, make, found):
    groups = np.array([0, 1, 0, 1])
    ridge, total = 1e-4, 0.0
    for group in (0, 1):
        rows = groups != group
        theta = found.solve(rows, ridge).reshape(2, -1)
        total += squares(make(theta), data)[0][~rows].sum()
    expected = np.sqrt(total / found.samples.sum())
    (own,) = cross_validated(found, [groups], ridge)
    np.testing.assert_allclose(own, expected, rtol=1e-8)
    count = found.right.shape[1]
    every = cross_validated(found, [groups], ridge, (count,), (0,))
    np.testing.assert_allclose(every, [own], rtol=1e-8)


def test_forward_selection_begins_as_told_and_reduces_the_error(data, found):
    everything = np.ones(len(data), bool)
    half = found.right.shape[1] // 2
    order = found.forward(everything, 1e-8, 2 * half, [0, half])
    assert order[:2].tolist() == [0, half] and len(set(order.tolist())) == 2 * half
    losses = [
        found.loss(everything, found.solve(everything, 1e-8, order[:n]))
        for n in range(1, 2 * half + 1)
    ]
    assert np.all(np.diff(losses) < 1e-9 * found.square.sum())
