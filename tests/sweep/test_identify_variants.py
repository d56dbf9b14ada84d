"""Other partitions, validities and objectives of the fused identification."""

import dataclasses

import numpy as np
import pytest
from identify_problems import METHOD, engine, fleet_of

from jaxnarx.methods import Case, ForwardOLS, SigmoidTree
from jaxnarx.models import Network
from jaxnarx.partition import grow
from jaxnarx.selection import select
from jaxnarx.simulation import simulate
from jaxnarx.sweep.identify import identify_each, network_of
from jaxnarx.sweep.identify.frame import make_pool

SMALL = {"max_terms": 3, "max_models": 2, "steps": 2}
VARIANTS = {
    "tree in windows": {"partition": "tree", "horizons": (10,), "window_steps": 1},
    "clusters one step ahead": {"partition": "cluster", "objective": "prediction"},
    "random": {"partition": "random"},
    "boxes": {"validity": "boxes"},
    "compact": {"validity": "compact"},
    "one model": {"max_models": 1, "scheduling": ()},
}
QUICK = ("clusters one step ahead",)


def free_run_error(network: Network, data) -> float:
    run = simulate(network, data).value
    y, mask = data.records[0].y, run.scored[0]
    return float(np.sqrt(np.mean((y - run[0])[mask] ** 2)) / np.std(y[mask]))


@pytest.mark.parametrize(
    "name",
    [
        name if name in QUICK else pytest.param(name, marks=pytest.mark.slow)
        for name in VARIANTS
    ],
)
def test_every_variant_refines_and_comes_back_as_a_network(name):
    method = dataclasses.replace(METHOD, **(SMALL | VARIANTS[name]))
    data = engine(1)
    fleet = fleet_of({"one": data})
    cases = [Case(), Case(seed=1), Case(seed=1, scatter=0.7)]
    rows = identify_each(fleet, method, cases, chunk=3)
    for row in rows:
        assert row["status"] in ("ok", "no_improvement")
        start = row["validation_free_run_start"]
        assert row["validation_free_run"] <= start * (1 + 1e-12)
        error = free_run_error(network_of(fleet, row, method), data[2])
        assert row["test_free_run"] == pytest.approx(error, rel=1e-9)
    first, second, moved = (row["train_one_step_start"] for row in rows)
    drawn = method.partition in ("random", "cluster")
    # Clusters of well-spread data may end at the same means.
    assert (first == second) == (not drawn) or method.partition == "cluster"
    trained = method.max_models > 1 and method.validity != "boxes"
    assert (moved != second) == trained
    if method.objective == "prediction":
        assert rows[0]["loss_history"][0] == pytest.approx(first**2, rel=1e-9)
    else:
        full = rows[0]["loss_history"][-(method.steps + 1) :]
        assert full[-1] <= full[0]
    if method.horizons:
        # A window, the coefficients on full records, everything, each with its stock.
        assert len(rows[0]["loss_history"]) == 2 + 2 + 3


@pytest.mark.slow
def test_a_tree_is_that_of_the_verb():
    method = dataclasses.replace(METHOD, **SMALL, partition="tree")
    data = engine(1)
    fleet = fleet_of({"one": data})
    (row,) = identify_each(fleet, method, [Case(train="none")])
    terms = select(
        make_pool(method, data.channels), data[0], ForwardOLS(max_terms=3)
    ).value
    growth = SigmoidTree(method.scheduling, max_models=2, criterion="none", prune=False)
    grown = grow(terms, data[0], growth).value
    # The gate is a minimum of an iteration that ends at a relative decrease of 1e-4.
    error = free_run_error(grown, data[2])
    assert row["test_free_run_start"] == pytest.approx(error, rel=1e-6)
