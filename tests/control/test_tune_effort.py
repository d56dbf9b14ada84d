"""Efforts of a controller, tuned against plants that differ from its model."""

import dataclasses

import numpy as np
import pytest
from control_problems import TIME, linear, shifted

import jaxnarx as jnx
from jaxnarx.control import Command, OutputLimit, close_loop, mpc, tune_effort
from jaxnarx.control._tune_effort import keep_limits
from jaxnarx.errors import DataError, SpecError

FACTORS = (0.1, 1.0, 1e3, 1e4)


@pytest.fixture(scope="module")
def controller():
    free = {"force": Command(effort=1e-3)}
    return mpc(linear(), free, ["speed"], horizon=6).value


@pytest.fixture(scope="module")
def references():
    """Steps of the speed; the load rests."""
    random = np.random.default_rng(3)
    y = np.repeat(random.uniform(-0.4, 0.4, (6, 2)), 20, axis=0)
    return jnx.Dataset.from_arrays(
        np.zeros((120, 2)),
        y,
        inputs=["force", "load"],
        outputs=["speed", "heat"],
        sample_time=TIME,
    )


def tracking(controller, plants, references) -> list[float]:
    runs = [close_loop(controller, plant, references).value for plant in plants]
    return [float(run.nrmse(20).mean()) for run in runs]


def test_its_own_model_wants_cheap_moves_and_a_stronger_plant_dear_ones(
    controller, references
):
    plants = [shifted(0.0), shifted(0.0, 2.0)]
    own = tune_effort(controller, plants[:1], references, factors=FACTORS)
    both = tune_effort(controller, plants, references, factors=FACTORS)
    assert own.is_okay and both.is_okay
    assert own.stats["factor"] < both.stats["factor"] < FACTORS[-1]
    effort = controller.effort * both.stats["factor"]
    np.testing.assert_allclose(both.value.effort, effort, rtol=1e-12)
    # What it tells is what the loop does, of the chosen and of every other one.
    assert both.stats["nrmse"].shape == (4, 2, 1)
    at = list(FACTORS).index(both.stats["factor"])
    found = tracking(both.value, plants, references)
    np.testing.assert_allclose(both.stats["nrmse"][at, :, 0], found, rtol=1e-9)
    worst = both.stats["nrmse"].mean(axis=2).max(axis=1)
    assert worst[at] <= 1.05 * worst.min() and f"{worst[at]:.3g}" in both.detail
    assert max(found) < max(tracking(controller, plants, references))


def test_limits_come_first(controller, references):
    """A dearer factor of larger errors is taken where the others break a limit."""
    (record,) = references.records
    most = 1.3 * float(record.y[:, 0].max())
    limits = {"speed": OutputLimit(at_most=most, guard=0.0)}
    free = {"force": Command(effort=1e-3)}
    bound = mpc(linear(), free, ["speed"], limits, horizon=6).value
    parts, factors = ([shifted(0.0, 1.5)], references), (1.0, 100.0, 1e4)
    found = tune_effort(bound, *parts, factors=factors)
    kept, errors = found.stats["kept"][:, 0], found.stats["nrmse"][:, 0, 0]
    assert found.stats["factor"] == 1e4 and errors.argmin() == 1
    assert kept[:2].max() < 0.999 <= kept[2] and "kept in 100 %" in found.detail
    run = close_loop(found.value, parts[0][0], references).value
    assert run.share_kept(20) == kept[2]
    assert tune_effort(controller, *parts, factors=factors).stats["factor"] == 100.0


@pytest.mark.parametrize(
    ("kept", "runs", "fits"),
    [
        ([0.6, 1, 1, 0], [1, 1, 1, 0], [0, 1, 1, 0]),  # the last one diverges
        ([1, 0.99, 1, 1], [1, 1, 1, 1], [0, 0, 1, 1]),  # the first does by chance
        ([0.97, 0.98, 0.98, 0.96], [1, 1, 1, 1], [0, 1, 1, 0]),  # none does
    ],
)
def test_factors_that_keep_limits_qualify(kept, runs, fits):
    found = keep_limits(np.array(kept), np.array(runs, bool))
    np.testing.assert_array_equal(found, np.array(fits, bool))


def test_where_every_loop_diverges_it_says_so_and_changes_nothing(
    controller, references
):
    broken = dataclasses.replace(shifted(0.0), shift=np.inf)
    found = tune_effort(controller, [broken], references, factors=(1.0,))
    assert found.status == jnx.RESULTS.diverged and "diverges" in found.detail
    np.testing.assert_array_equal(found.value.effort, controller.effort)


def test_a_reference_that_does_not_move_is_told_of(controller, references):
    (record,) = references.records
    still = dataclasses.replace(references, records=(record.part(0, 20),))
    with pytest.raises(DataError, match="does not move"):
        tune_effort(controller, [shifted(0.0)], still, factors=(1.0,))


@pytest.mark.parametrize(
    ("plants", "factors", "why"),
    [([], FACTORS, "a plant"), ([1], (), "factors"), ([1], (0.0,), "positive")],
)
def test_what_is_wrong_is_said(controller, references, plants, factors, why):
    plants = [linear() for _ in plants]
    with pytest.raises(SpecError, match=why):
        tune_effort(controller, plants, references, factors=factors)
