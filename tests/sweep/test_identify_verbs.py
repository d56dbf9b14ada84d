"""Members that the fused program does not know are the verbs in a row."""

import dataclasses
import json
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from common import some
from identify_problems import SMALL, engine, fleet_of

from jaxnarx.errors import SpecError
from jaxnarx.identification import identify, make_pool
from jaxnarx.models import Gaussians
from jaxnarx.partition import grow
from jaxnarx.settings import Given, Grid
from jaxnarx.settings.tree import replace_at
from jaxnarx.simulation import simulate
from jaxnarx.sweep.identify import (
    IdentificationWork,
    identify_each,
    network_of,
    settings,
)

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
WAYS: dict[str, dict[str, Any]] = {
    "stepwise": {"select": "stepwise"},
    "backward": {"select": "backward", "grow": SIGMOIDS},
    "simulation": {"select": "simulation"},
    "own": {"select": correlated, "grow": OWN},
}


def free_run_error(network, data) -> float:
    run = simulate(network, data).value
    y, mask = data.records[0].y, run.scored[0]
    return float(np.sqrt(np.mean((y - run[0])[mask] ** 2)) / np.std(y[mask]))


@pytest.mark.parametrize("name", some(WAYS, "own"))
def test_a_member_is_the_verbs_in_a_row(name):
    method = replace_at(SMALL, WAYS[name])
    data, fleet = engine(1), fleet_of({"one": engine(1)})
    cases = [{"refine": "none"}, {}]
    rows = identify_each(fleet, method, cases, chunk=2)
    work = IdentificationWork(fleet, method, cases)
    fit = identify(data[0], method, validation=data[1])
    chosen, grown = fit.stats["selection"], fit.stats["grown"].value
    for row, network in zip(rows, (grown, fit.value), strict=True):
        assert row["term_names"] == chosen.value.names
        assert row["status"] in ("ok", "no_improvement")
        # one program for all records against one for each
        expected = pytest.approx(free_run_error(network, data[2]), rel=1e-9)
        assert row["test_free_run"] == expected
        again = network_of(work, row)
        assert free_run_error(again, data[2]) == expected
    assert rows[1]["test_free_run_start"] == rows[0]["test_free_run"]
    assert rows[1]["loss_history"] == [
        h["loss"] for h in fit.stats["refined"].stats["history"]
    ]


@pytest.mark.slow
def test_what_the_program_knows_comes_out_the_same_by_the_verbs(monkeypatch):
    fleet = fleet_of({"one": engine(1)})
    lags = {"pool.input_lags": (0, 1), "pool.output_lags": (1,)}
    # Searches that end early: by the tolerance, by patience.
    long = {"refine.max_steps": 9, "refine.horizons": (20,), "refine.window_steps": 4}
    quiet, patient = {"refine.tolerance": 0.05}, {"refine.patience": 1}
    cases = [lags | {"refine": "none"}, {}, long | quiet, long | patient]
    found = identify_each(fleet, SMALL, cases)
    assert all(row["steps_taken"] < 9 + 4 + 4 for row in found[2:])
    monkeypatch.setattr(settings, "is_fused", lambda method: False)
    by_verbs = identify_each(fleet, SMALL, cases)
    for ours, theirs in zip(found, by_verbs, strict=True):
        assert set(ours) == set(theirs)
        for key, value in ours.items():
            if key == "detail":
                continue
            if isinstance(value, str) or value is None or not value:
                assert theirs[key] == value, key
            elif isinstance(value, list) and isinstance(value[0], str):
                assert theirs[key] == value, key
            elif key not in ("condition", "loss_history", "guard_history"):
                # normal equations: other orders of the sums cost half the digits
                np.testing.assert_allclose(theirs[key], value, rtol=1e-6, err_msg=key)


def test_a_case_changes_the_settings_that_it_names():
    method = replace_at(SMALL, {"grow": OWN})
    fleet = fleet_of({"one": engine(1)})
    cases = [{"refine": "none"}, {"refine": "none", "select.max_terms": 2}]
    rows = identify_each(fleet, method, cases)
    assert [row["select.max_terms"] for row in rows] == [3, 2]
    assert [row["refine"] for row in rows] == ["none", "none"]
    assert rows[0]["term_count"] > 2 == rows[1]["term_count"]


def test_a_sweep_by_verbs_describes_itself():
    pool = make_pool(SMALL.pool, engine(1).channels)
    network = grow(pool, engine(1)[0], SMALL.grow).value
    fleet = fleet_of({"one": engine(1)})
    told = []
    for partition in (OWN, SIGMOIDS, Given(network)):
        method = dataclasses.replace(SMALL, select=correlated, grow=partition)
        told.append(IdentificationWork(fleet, method).describe())
    assert json.loads(json.dumps(told)) == told
    assert len({json.dumps(t) for t in told}) == 3


@pytest.mark.parametrize(
    ("case", "field"),
    [
        ({"select": correlated, "select.max_terms": 2}, "select"),
        ({"grow": SIGMOIDS, "grow.max_models": 2}, "max_models"),
        ({"select": "ridge"}, "select"),
        ({"grow.max_models": "four"}, "max_models"),
        ({"refine.train": "twice"}, "train"),
        ({"refine.steps": 3}, "refine.steps"),
    ],
)
def test_what_does_not_go_together_is_named(case, field):
    with pytest.raises(SpecError) as caught:
        IdentificationWork(fleet_of({"one": engine(1)}), SMALL, [case])
    assert caught.value.field is not None and field in caught.value.field
