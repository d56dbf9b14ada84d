"""A staged refinement: coefficients alone in windows, then everything."""

import dataclasses

import numpy as np
import pytest
from identify_problems import METHOD, engine, fleet_of

from jaxnarx.methods import Case
from jaxnarx.sweep import identify_each


@pytest.mark.slow
def test_staged_trains_the_partition_on_full_records_alone():
    method = dataclasses.replace(METHOD, horizons=(15,), window_steps=2)
    cases = [Case(train=t) for t in ("coefficients", "staged", "joint", "none")]  # pyright: ignore
    rows = identify_each(fleet_of({"one": engine(1)}), method, cases)
    history = [np.array(row["loss_history"]) for row in rows]
    windows = 1 + method.window_steps
    np.testing.assert_array_equal(history[1][:windows], history[0][:windows])
    assert np.any(history[1][:windows] != history[2][:windows])
    # The first turn of a stage only takes stock.
    assert history[1][windows] == history[0][windows]
    assert history[1][-1] < history[0][-1]
    grown = rows[3]["centre"]
    assert rows[0]["centre"] == grown and rows[1]["centre"] != grown
