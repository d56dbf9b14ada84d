"""Other partitions, validities and objectives of the fused identification."""

import numpy as np
import pytest
from common import some
from identify_problems import SMALL, engine, fleet_of

from jaxnarx.identification import identify
from jaxnarx.models import Network
from jaxnarx.settings import Global, Placed, PredictionError
from jaxnarx.settings.tree import replace_at
from jaxnarx.simulation import simulate
from jaxnarx.sweep.identify import IdentificationWork, identify_each, network_of

VARIANTS = {
    "tree in windows": {
        "grow": "tree",
        "refine.horizons": (10,),
        "refine.window_steps": 1,
    },
    "clusters one step ahead": {"grow": "placed", "refine": "prediction"},
    "random": {"grow": "placed", "grow.at": "samples"},
    "boxes": {"grow.validity": "boxes"},
    "compact": {"grow.validity": "compact"},
    "one model": {"grow": "global"},
}
QUICK = ("clusters one step ahead",)


def free_run_error(network: Network, data) -> float:
    run = simulate(network, data).value
    y, mask = data.records[0].y, run.scored[0]
    return float(np.sqrt(np.mean((y - run[0])[mask] ** 2)) / np.std(y[mask]))


@pytest.mark.parametrize("name", some(VARIANTS, *QUICK))
def test_every_variant_refines_and_comes_back_as_a_network(name):
    method = replace_at(SMALL, VARIANTS[name])
    data = engine(1)
    fleet = fleet_of({"one": data})
    drawn, one = isinstance(method.grow, Placed), isinstance(method.grow, Global)
    cases = [{}, {} if one else {"grow.seed": 1}]
    if not (drawn or one):
        cases.append({"grow.seed": 1, "grow.scatter": 0.7})
    rows = identify_each(fleet, method, cases, chunk=len(cases))
    work = IdentificationWork(fleet, method, cases)
    for row in rows:
        assert row["status"] in ("ok", "no_improvement")
        start = row["validation_free_run_start"]
        assert row["validation_free_run"] <= start * (1 + 1e-12)
        error = free_run_error(network_of(work, row), data[2])
        assert row["test_free_run"] == pytest.approx(error, rel=1e-9)
    first, second, *moved = (row["train_one_step_start"] for row in rows)
    # Clusters of well-spread data may end at the same means.
    assert (first == second) == (not drawn) or method.grow.at == "clusters"
    if moved:
        curved = getattr(method.grow, "validity", "") != "boxes"
        assert (moved[0] != second) == curved
    if isinstance(method.refine, PredictionError):
        assert rows[0]["loss_history"][0] == pytest.approx(first**2, rel=1e-9)
        return
    full = rows[0]["loss_history"][-(method.refine.max_steps + 1) :]
    assert full[-1] <= full[0]
    if method.refine.horizons:
        # A window, the coefficients on full records, everything, each with its stock.
        assert len(rows[0]["loss_history"]) == 2 + 2 + 3


@pytest.mark.slow
def test_a_tree_is_that_of_the_verb():
    method = replace_at(SMALL, {"grow": "tree", "refine": "none"})
    data = engine(1)
    fleet = fleet_of({"one": data})
    (row,) = identify_each(fleet, method)
    grown = identify(data[0], method).value
    # The gate is a minimum of an iteration that ends at a relative decrease of 1e-4.
    error = free_run_error(grown, data[2])
    assert row["test_free_run_start"] == pytest.approx(error, rel=1e-6)
