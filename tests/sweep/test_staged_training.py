"""The order of training in a sweep is that of the verb."""

import numpy as np
import pytest
from common import some
from identify_problems import METHOD, engine, fleet_of, parts

from jaxnarx.refinement import refine
from jaxnarx.settings.tree import replace_at
from jaxnarx.sweep.identify import IdentificationWork, identify_each, network_of

# The longer window is no window: no record has as many samples.
STAGED = replace_at(METHOD, {"refine.horizons": (15, 500), "refine.window_steps": 2})
TRAINED = ("staged", "joint", "coefficients", "none")
CASES = [*({"refine.train": train} for train in TRAINED[:3]), {"refine": "none"}]


@pytest.fixture(scope="module")
def found() -> dict[str, dict]:
    rows = identify_each(fleet_of({"one": engine(1)}), STAGED, CASES, chunk=4)
    return dict(zip(TRAINED, rows, strict=True))


@pytest.mark.parametrize("train", some(TRAINED[:3], TRAINED[1]))
def test_a_sweep_trains_as_the_verb_does(found, train):
    data = engine(1)
    work = IdentificationWork(fleet_of({"one": data}), STAGED, CASES)
    grown = network_of(work, found["none"])
    method = replace_at(STAGED.refine, {"train": train})
    learning, judging, _ = parts(data)
    solution = refine(grown, learning, method, validation=judging)
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
