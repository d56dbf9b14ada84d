"""A start that diverges in a sweep is tried again with shrunk feedback."""

import numpy as np
import pytest
from identify_problems import METHOD, fleet_of, parts

from jaxnarx.data import Dataset
from jaxnarx.refinement import refine
from jaxnarx.simulation import simulate
from jaxnarx.sweep.identify import IdentificationWork, identify_each, network_of


def runaway() -> Dataset:
    """A process that drifts away while it trains, and is stable afterwards."""
    rng = np.random.default_rng(0)
    us, ys = [], []
    for pole, begin, length in ((1.05, 0.1, 90), (0.9, 5.0, 70), (0.9, 5.0, 70)):
        u = np.repeat(rng.uniform(-1, 1, (length // 5 + 1, 2)), 5, axis=0)[:length]
        y = np.full(length, begin)
        for t in range(1, length):
            y[t] = pole * y[t - 1] + 0.02 * u[t - 1, 0]
        us.append(u)
        ys.append((y + 1e-3 * rng.normal(size=length))[:, None])
    return Dataset.from_arrays(
        us, ys, inputs=["a", "b"], outputs=["y"], sample_time=0.1
    )


@pytest.mark.slow
def test_feedback_is_shrunk_as_by_the_verb():
    data = runaway()
    fleet = fleet_of({"one": data})
    few = {"select.max_terms": 3, "grow.max_models": 1}
    cases = [few | {"refine": "none"}, few]
    none, row = identify_each(fleet, METHOD, cases, chunk=2)
    # Without refinement there is nothing to mend it with, and the row says so.
    assert none["status"] == "start_diverged" and "diverges" in none["detail"]
    assert row["validation_free_run_start"] == np.inf
    assert row["status"] == "ok" and np.isfinite(row["validation_free_run"])
    assert row["guard_history"][-1] < row["guard_history"][0]
    grown = network_of(IdentificationWork(fleet, METHOD, cases), none)
    train, validation, _ = parts(data)
    assert simulate(grown, validation).status_name == "diverged"
    verb = refine(grown, train, METHOD.refine, validation=validation)
    assert verb.stats["remedy"] in row["detail"]
    assert row["guard_history"][-1] == pytest.approx(verb.stats["loss"], rel=1e-7)
