"""Selection on simulation error: its derivatives, its promises, and what it finds."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.arrays.contraction import positions
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.partition import grow
from jaxnarx.refinement._refine import make_task
from jaxnarx.regressors import polynomial_pool
from jaxnarx.selection import select
from jaxnarx.selection.simulation_ols import (
    _Rounds,
    costs,
    pool_derivatives,
    promises,
)
from jaxnarx.settings import ForwardOLS, Global, SimulationOLS
from jaxnarx.simulation import run, simulate

METHOD = SimulationOLS(max_terms=8, start_terms=3, shortlist=12)
TRUE = {"1", "y[t-1]", "u[t-1]", "u[t-2]^2", "u[t-1]*y[t-1]"}


def respond(u: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Output error: the noise is on the measurement, not in the recursion."""
    y = np.zeros(len(u))
    for t in range(2, len(u)):
        y[t] = 0.1 + 0.8 * y[t - 1] + 0.5 * u[t - 1] + 0.3 * u[t - 2] ** 2
        y[t] -= 0.15 * u[t - 1] * y[t - 1]
    return 20.0 * (y + noise)


def records(noise: float = 0.05, seed: int = 0) -> Dataset:
    """Two records of different length, slowly varying input."""
    rng = np.random.default_rng(seed)
    u, y = [], []
    for length in (240, 180):
        levels = rng.uniform(-1, 1, length // 8 + 1)
        u.append(np.repeat(levels, 8)[:length, None])
        y.append(respond(u[-1][:, 0], noise * rng.normal(size=length))[:, None])
    return Dataset.from_arrays(u, y, inputs=["u"], outputs=["y"], sample_time=0.1)


@pytest.fixture(scope="module")
def data() -> Dataset:
    return records()


@pytest.fixture(scope="module")
def pool(data):
    return polynomial_pool(
        data.channels, input_lags=(1, 2), output_lags=(1, 2), degree=2
    )


@pytest.fixture(scope="module")
def start(pool, data):
    terms = select(pool, data, ForwardOLS(max_terms=3)).value
    return terms, grow(terms, data, Global()).value


@pytest.fixture(scope="module")
def rounds(pool, data, start):
    return _Rounds(pool, data, start[0].gain, METHOD, np.ones(len(pool), bool), None)


def loss_of(network, data) -> float:
    task, _ = make_task(network, data)
    args = (task.drive, task.anchors(None), task.weight)
    return float(
        pool_derivatives(network, *args, np.zeros((1, 2), int), np.zeros(1, int))[2]
    )


def test_the_derivative_by_every_candidate_equals_central_differences(
    pool, data, start, rounds
):
    selection, network = start
    task, _ = make_task(network, data)
    place = positions(pool.factor, len(pool.variables) + 1)
    args = (task.drive, task.anchors(None), task.weight, pool.factor, place)
    derivative = np.asarray(pool_derivatives(network, *args)[0])
    terms = selection.terms()
    theta = np.asarray(network.models[0].local.coefficient)[0]
    step = 1e-6

    def loss(term: int, change: float) -> float:
        both = rounds.network([*terms, term], np.r_[theta, change], METHOD.max_terms)
        return float(pool_derivatives(both, *args)[2])

    for term in set(range(len(pool))) - set(terms):
        # half the derivative; the third derivative leaves about 1e-9 of the scale
        expected = (loss(term, step) - loss(term, -step)) / (4 * step)
        assert derivative[term] == pytest.approx(
            expected, rel=1e-6, abs=1e-8 * np.abs(derivative).max()
        )


def test_promises_and_costs_are_those_of_linear_least_squares():
    rng = np.random.default_rng(4)
    x, y = rng.normal(size=(60, 7)), rng.normal(size=60)
    kept = 4

    def sse(columns) -> float:
        theta = np.linalg.lstsq(x[:, columns], y, rcond=None)[0]
        return float(np.sum((y - x[:, columns] @ theta) ** 2))

    chosen = list(range(kept))
    theta = np.linalg.lstsq(x[:, chosen], y, rcond=None)[0]
    residual = x[:, chosen] @ theta - y
    gained, left = promises(x.T @ residual, x.T @ x, kept)
    cost = costs(theta, x[:, chosen].T @ x[:, chosen])
    for n, column in enumerate(range(kept, 7)):
        brings = sse(chosen) - sse([*chosen, column])
        # 1e-12 on the unit diagonal keeps the equations solvable.
        assert gained[n] == pytest.approx(brings, rel=1e-9)
        assert 0 < left[n] <= 1
    for n in chosen:
        loses = sse([c for c in chosen if c != n]) - sse(chosen)
        assert cost[n] == pytest.approx(loses, rel=1e-9)


def test_filtered_columns_are_what_the_run_changes_by(data, start, rounds):
    """Gram and slope of the shortlist against finite differences of the run."""
    selection, network = start
    task, _ = make_task(network, data)
    theta = np.asarray(network.models[0].local.coefficient)[0]
    terms = selection.terms()
    short, slope, gram, _ = rounds.candidates(terms, theta)
    both, step = [*terms, *short], 1e-6
    slots = rounds.slots + METHOD.shortlist
    weight = np.sqrt(np.asarray(task.weight))

    def outputs(change: np.ndarray) -> np.ndarray:
        value = np.r_[theta, np.zeros(len(short))] + change
        wide = rounds.network(both, value, slots)
        return (weight * np.asarray(run(wide, task.drive, task.anchors(None)))).ravel()

    columns = np.stack(
        [
            (outputs(step * e) - outputs(-step * e)) / (2 * step)
            for e in np.eye(len(both))
        ]
    )
    residual = outputs(np.zeros(len(both)))
    residual = residual - (weight * np.asarray(task.drive.measured)).ravel()
    scale = np.sqrt(np.diagonal(gram))
    np.testing.assert_allclose(
        gram / np.outer(scale, scale),
        (columns @ columns.T) / np.outer(scale, scale),
        atol=1e-6,
    )
    np.testing.assert_allclose(
        slope / scale,
        columns @ residual / scale,
        atol=1e-6 * float(np.linalg.norm(residual)),
    )


def test_the_true_structure_is_found_in_output_noise(pool, data):
    """One-step errors of noisy measurements mislead; the free run does not."""
    solution = select(pool, data, METHOD)
    assert solution.is_okay
    assert TRUE <= set(solution.value.names)
    fresh = records(noise=0.0, seed=9)
    y = np.concatenate([r.y for r in fresh])

    def error(network) -> float:
        run = simulate(network, fresh).value
        return float(np.std(np.concatenate(run.outputs) - y) / y.std())

    forward = select(pool, data, ForwardOLS(max_terms=solution.value.size())).value
    assert error(solution.stats["network"]) < 0.5 * error(
        grow(forward, data, Global()).value
    )


def test_the_loss_falls_with_every_entry_and_the_history_says_why(pool, data):
    seen = []
    solution = select(pool, data, METHOD, progress=seen.append)
    history = solution.stats["history"]
    assert seen == history
    losses = [row["loss"] for row in history]
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] == solution.stats["loss"]
    few = select(pool, data, dataclasses.replace(METHOD, least_gain=0.5))
    assert few.status_name == "no_improvement", few.detail
    assert "no further term made the free run better" in few.detail
    assert {row["what"].split(" for ")[0] for row in history} <= {"taken in", "refused"}
    assert loss_of(solution.stats["network"], data) == pytest.approx(
        solution.stats["loss"], rel=1e-9
    )


def test_several_outputs_are_refused():
    u, y = np.random.default_rng(0).normal(size=(2, 60, 2))
    data = Dataset.from_arrays(
        u, y, inputs=list("ab"), outputs=list("cd"), sample_time=1.0
    )
    pool = polynomial_pool(data.channels, input_lags=(1,), output_lags=(1,), degree=1)
    with pytest.raises(SpecError, match="one output"):
        select(pool, data, METHOD)


def test_weights_are_refused_rather_than_ignored(pool, data):
    with pytest.raises(SpecError, match="weights"):
        select(pool, data, METHOD, weights=[np.ones(len(r)) for r in data])


def test_settings_out_of_range_are_refused():
    with pytest.raises(SpecError, match="start_terms"):
        SimulationOLS(max_terms=3, start_terms=4)
    with pytest.raises(SpecError, match="tau"):
        SimulationOLS(tau=1.0)


def test_padding_of_the_network_changes_nothing(rounds, start, data):
    selection, network = start
    theta = np.asarray(network.models[0].local.coefficient)[0]
    padded = rounds.network(selection.terms(), theta, METHOD.max_terms)
    spoiled = eqx.tree_at(
        lambda n: n.models[0].local.coefficient,
        padded,
        jnp.where(padded.models[0].local.used, padded.models[0].local.coefficient, 7.0),
    )
    assert loss_of(spoiled, data) == pytest.approx(loss_of(network, data), rel=1e-12)
