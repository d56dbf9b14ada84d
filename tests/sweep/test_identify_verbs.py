"""Members that the fused program does not know are the verbs in a row."""

import dataclasses
import json
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from identify_problems import METHOD, engine, fleet_of

from jaxnarx.errors import SpecError
from jaxnarx.methods import (
    Backward,
    Case,
    ForwardOLS,
    Given,
    Grid,
    Lolimot,
    SimulationError,
    SimulationOLS,
    StepwiseF,
)
from jaxnarx.models import Gaussians
from jaxnarx.partition import grow
from jaxnarx.refinement import refine
from jaxnarx.selection import select
from jaxnarx.simulation import simulate
from jaxnarx.sweep.identify import IdentificationWork, identify_each, network_of
from jaxnarx.sweep.identify.frame import make_pool

SMALL = dataclasses.replace(METHOD, max_terms=3, max_models=2, steps=2)
LOLIMOT = Lolimot(["a[t-1]"], max_models=2, criterion="none")
SIGMOIDS = Grid(["a[t-1]"], models=(2,), validity="log-sigmoids")


def correlated(columns, output, weight):
    """The three columns with the largest correlation."""
    gain = np.abs(columns @ (weight * output)) / np.sqrt(columns**2 @ weight)
    return np.argsort(-gain)[:3]


def halves(scheduling, columns, output, weight):
    """A Gaussian on either side."""
    centre = jnp.array([[0.2], [0.8]])
    return Gaussians(centre, jnp.full_like(centre, -1.0))


OWN = Given(halves, scheduling=["a[t-1]"])
WAYS: dict[str, tuple[dict[str, Any], Any, Any]] = {
    "stepwise": ({"select": "stepwise"}, StepwiseF(max_terms=3), LOLIMOT),
    "backward": (
        {"select": "backward", "partition": "log-sigmoids"},
        Backward(max_terms=3),
        SIGMOIDS,
    ),
    "simulation": (
        {"select": "simulation"},
        SimulationOLS(start_terms=3, max_terms=3),
        LOLIMOT,
    ),
    "own": ({"select": correlated, "partition": OWN}, correlated, OWN),
}


def free_run_error(network, data) -> float:
    run = simulate(network, data).value
    y, mask = data.records[0].y, run.scored[0]
    return float(np.sqrt(np.mean((y - run[0])[mask] ** 2)) / np.std(y[mask]))


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow) for n in WAYS if n == "simulation"]
    + [n for n in WAYS if n != "simulation"],
)
def test_a_member_is_the_verbs_in_a_row(name):
    settings, selector, partition = WAYS[name]
    method = dataclasses.replace(SMALL, **settings)
    data, fleet = engine(1), fleet_of({"one": engine(1)})
    rows = identify_each(fleet, method, [Case(train="none"), Case()], chunk=2)
    pool = make_pool(method, data.channels)
    chosen = select(pool, data[0], selector)
    grown = grow(chosen.value, data[0], partition).value
    way = SimulationError(horizons=(), max_steps=2, window_steps=method.window_steps)
    fit = refine(grown, data[0], way, validation=data[1])
    for row, network in zip(rows, (grown, fit.value), strict=True):
        assert row["term_names"] == chosen.value.names
        assert row["status"] in ("ok", "no_improvement")
        # one program for all records against one for each
        expected = pytest.approx(free_run_error(network, data[2]), rel=1e-9)
        assert row["test_free_run"] == expected
        again = network_of(fleet, row, method)
        assert free_run_error(again, data[2]) == expected
    assert rows[1]["test_free_run_start"] == rows[0]["test_free_run"]
    assert rows[1]["loss_history"] == [h["loss"] for h in fit.stats["history"]]


def test_what_the_program_knows_comes_out_the_same_by_the_verbs():
    fleet, case = fleet_of({"one": engine(1)}), Case(lags=1, train="none")
    (program,) = identify_each(fleet, SMALL, [case])
    same = dataclasses.replace(SMALL, select=ForwardOLS(max_terms=3))
    (verbs,) = identify_each(fleet, same, [case])
    assert set(verbs) == set(program)
    for key, value in program.items():
        if isinstance(value, str) or value is None or not value:
            assert verbs[key] == value, key
        elif isinstance(value, list) and isinstance(value[0], str):
            assert verbs[key] == value, key
        elif key not in ("condition", "loss_history", "guard_history"):
            # normal equations: other orders of the sums cost half the digits
            np.testing.assert_allclose(verbs[key], value, rtol=1e-6, err_msg=key)


def test_a_case_changes_the_settings_that_it_names():
    method = dataclasses.replace(SMALL, select=StepwiseF(max_terms=6))
    fleet = fleet_of({"one": engine(1)})
    cases = [Case(train="none"), Case(train="none", terms=2)]
    rows = identify_each(fleet, method, cases)
    assert [row["terms"] for row in rows] == [6, 2]
    assert rows[0]["term_count"] > 2 == rows[1]["term_count"]


def test_a_sweep_by_verbs_describes_itself():
    network = grow(make_pool(SMALL, engine(1).channels), engine(1)[0], LOLIMOT).value
    fleet = fleet_of({"one": engine(1)})
    told = []
    for partition in (OWN, SIGMOIDS, Given(network)):
        method = dataclasses.replace(SMALL, select=correlated, partition=partition)
        told.append(IdentificationWork(fleet, method).describe())
    assert json.loads(json.dumps(told)) == told
    assert len({json.dumps(t) for t in told}) == 3


@pytest.mark.parametrize(
    ("settings", "case", "field"),
    [
        ({"select": correlated}, Case(terms=2), "terms"),
        ({"partition": SIGMOIDS}, Case(models=2), "models"),
        ({"select": "stepwise"}, Case(scatter=0.5), "scatter"),
        ({"select": "stepwise", "partition": "random"}, Case(), "partition"),
        ({"select": "ridge"}, Case(), "select"),
    ],
)
def test_what_does_not_go_together_is_named(settings, case, field):
    with pytest.raises(SpecError) as caught:
        method = dataclasses.replace(SMALL, **settings)
        IdentificationWork(fleet_of({"one": engine(1)}), method, [case])
    assert caught.value.field == field
