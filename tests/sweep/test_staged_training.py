"""The order of training in a sweep is that of the verb."""

import dataclasses

import numpy as np
import pytest
from identify_problems import METHOD, engine, fleet_of, parts

from jaxnarx.methods import Case, SimulationError
from jaxnarx.refinement import freeze, refine
from jaxnarx.sweep import identify_each
from jaxnarx.sweep.identify import network_of

# The longer window is no window: no record has as many samples.
STAGED = dataclasses.replace(METHOD, horizons=(15, 500), window_steps=2)
TRAINED = ("staged", "joint", "coefficients", "none")


@pytest.fixture(scope="module")
def found() -> dict[str, dict]:
    cases = [Case(train=t) for t in TRAINED]  # pyright: ignore
    rows = identify_each(fleet_of({"one": engine(1)}), STAGED, cases, chunk=4)
    return dict(zip(TRAINED, rows, strict=True))


@pytest.mark.parametrize("train", TRAINED[:3])
def test_a_sweep_trains_as_the_verb_does(found, train):
    data = engine(1)
    grown = network_of(fleet_of({"one": data}), found["none"], STAGED)
    method = SimulationError(
        horizons=STAGED.horizons,
        window_steps=STAGED.window_steps,
        max_steps=STAGED.steps,
        train="staged" if train == "staged" else "joint",
        # Without a tolerance it makes all its steps, as the fused one does.
        tolerance=0,
    )
    learning, judging, _ = parts(data)
    only = freeze(grown, partition=train != "coefficients")
    solution = refine(grown, learning, method, validation=judging, trainable=only)
    row, history = found[train], solution.stats["history"]
    # The turns that are made, without those that take stock at the head of a stage.
    turns = [1, 2, *([7, 8] if train == "staged" else []), 10, 11, 12]
    ours = np.array(row["loss_history"])[turns]
    # As for the whole row, see test_identify_program: padding rounds sums otherwise.
    np.testing.assert_allclose(ours, [h["loss"] for h in history], rtol=1e-7)
    assert row["guard_history"][-1] == pytest.approx(solution.stats["loss"], rel=1e-7)
    np.testing.assert_allclose(
        row["coefficient"],
        np.ravel(solution.value.models[0].local.coefficient),
        rtol=1e-7,
        atol=1e-9,
    )


def test_staged_moves_the_partition_last(found):
    staged, joint, coefficients = (
        np.array(found[t]["loss_history"]) for t in TRAINED[:3]
    )
    np.testing.assert_array_equal(staged[:3], coefficients[:3])
    assert np.any(staged[:3] != joint[:3])
    # A window longer than the records is passed over, and with it its turns.
    assert set(staged[3:6]) == {staged[2]}
    assert found["coefficients"]["centre"] == found["none"]["centre"]
    assert found["staged"]["centre"] != found["none"]["centre"]
    assert Case().train == "staged" == SimulationError().train
