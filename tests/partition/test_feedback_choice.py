"""The class of every local model: fed back the network's output, or its own."""

import dataclasses
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.partition import grow
from jaxnarx.refinement import refine
from jaxnarx.settings import Given, Grid, SimulationError

ROWS = 400
SLOW_THEN_FAST = ((0.95, 0.05), (0.5, 1.0))
"""Pole and input coefficient of the regions below and above u2 = 0."""


@cache
def data(own: tuple[bool, bool], seed: int = 0) -> jnx.Dataset:
    """Two first-order regions, blended by u2, each fed back as `own` says; no noise."""
    rng = np.random.default_rng(seed)
    u = np.column_stack(
        [np.repeat(rng.uniform(0.5, 2, ROWS // 10), 10), np.sin(np.arange(ROWS) / 7.0)]
    )
    share = 1 / (1 + np.exp(-4 * u[:, 1]))
    y, alone = np.zeros(ROWS), np.zeros((ROWS, 2))
    for t in range(1, ROWS):
        for m, (pole, gain) in enumerate(SLOW_THEN_FAST):
            past = alone[t - 1, m] if own[m] else y[t - 1]
            alone[t, m] = pole * past + gain * u[t - 1, 0]
        y[t] = (1 - share[t]) * alone[t, 0] + share[t] * alone[t, 1]
    names: dict[str, Any] = {"inputs": ["u1", "u2"], "outputs": ["y"]}
    return jnx.Dataset.from_arrays(u, y, sample_time=1.0, **names)


def pool(records: jnx.Dataset) -> jnx.Pool:
    lags: dict[str, Any] = {"input_lags": {"u1": (1,), "u2": ()}, "output_lags": (1,)}
    return jnx.polynomial_pool(records.channels, degree=1, **lags)


GRID = Grid(("u2[t]",), borders=((0.0,),), validity="log-sigmoids", steepness=4.0)


def grown(records: jnx.Dataset, feedback: Any):
    return grow(pool(records), records, dataclasses.replace(GRID, feedback=feedback))


@pytest.mark.parametrize("own", [(True, True), (True, False), (False, False)])
def test_the_true_class_is_exact_after_refinement_and_no_other(own):
    """Of all four combinations only the true one reaches a free-run error of zero."""
    records = data(own)
    method = SimulationError(horizons=(), max_steps=60, ridge=0.0)
    errors = {}
    for flags in ((True, True), (True, False), (False, True), (False, False)):
        network = grown(records, "own").value
        model = dataclasses.replace(network.models[0], own=jnp.diag(jnp.array(flags)))
        start = dataclasses.replace(network, models=(model,))
        only = jnx.freeze(start, partition=False)
        fit = refine(start, records, method, trainable=only).value
        y = records.records[0].y[1:]
        run = jnx.simulate(fit, records).value[0][1:]
        errors[flags] = np.sqrt(np.mean((run - y) ** 2)) / y.std()
    assert min(errors, key=lambda flags: errors[flags]) == own
    assert errors[own] < 1e-6  # rounding and the solver's stop
    assert all(e > 1e-3 for flags, e in errors.items() if flags != own)


def test_the_choice_is_never_worse_than_either():
    records = data((True, True))
    solution = grown(records, "choose")
    (figures,), (own,) = (solution.stats[k] for k in ("feedback_nrmse", "own"))
    assert figures["chosen"] <= min(figures["network"], figures["own"])
    run = jnx.simulate(solution.value, records).value[0][1:]
    y = records.records[0].y[1:]
    found = np.sqrt(np.mean((run - y) ** 2)) / y.std()
    np.testing.assert_allclose(found, figures["chosen"], rtol=1e-9)
    network = solution.value.models[0]
    flags = [False, False] if network.own is None else np.diag(network.own).tolist()
    assert flags == own.tolist()


def test_network_feedback_stays_where_it_is_the_truth():
    """Least squares in one region at a time is biased by the other where they overlap;
    its free run is the better one all the same."""
    solution = grown(data((False, False)), "choose")
    assert not np.any(solution.stats["own"][0])
    assert solution.value.models[0].own is None
    figures = solution.stats["feedback_nrmse"][0]
    assert figures["chosen"] == figures["network"] < figures["own"]


def test_validation_records_decide_where_there_are_any():
    records, other = data((True, True)), data((True, True), seed=1)
    with_other = grow(
        pool(records),
        records,
        dataclasses.replace(GRID, feedback="choose"),
        validation=other,
    )
    own = grown(records, "choose").stats["feedback_nrmse"][0]
    assert with_other.stats["feedback_nrmse"][0] != own


def test_without_feedback_there_is_nothing_to_choose():
    records = data((True, True))
    lags: dict[str, Any] = {"input_lags": (0, 1), "output_lags": (), "degree": 1}
    static = jnx.polynomial_pool(records.channels, **lags)
    first = grow(static, records, dataclasses.replace(GRID, feedback="own"))
    assert first.value.models[0].own is None and not first.stats["own"][0].any()
    given = grow(pool(records), records, Given(first.value, feedback="own"))
    assert (
        np.all(np.diag(np.asarray(given.value.models[0].own)))
        and given.stats["own"][0].all()
    )
