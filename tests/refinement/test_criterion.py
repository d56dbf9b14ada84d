"""Losses and transforms: their derivatives, their limits, and what they refuse."""

import common
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from common import Y

from jaxnarx.errors import DataError, SpecError
from jaxnarx.refinement import refine
from jaxnarx.refinement.criterion import Criterion
from jaxnarx.refinement.training_data import make_task
from jaxnarx.settings import SimulationError

RUN = jnp.asarray([[-0.3, 0.02], [0.4, 1.7], [2.5, 0.9], [0.06, 3.0]])
MEASURED = jnp.asarray([[0.1, 0.6], [0.4, 1.2], [0.7, 1.0], [1.9, 0.2]])
WEIGHT = jnp.asarray([[1.0, 2.0], [0.5, 1.0], [1.0, 0.0], [3.0, 0.7]])


def criterion(loss: str, power: float | None) -> Criterion:
    exponent = None if power is None else jnp.asarray([power, 1.0])
    return Criterion(loss, exponent, jnp.asarray([0.05, 1.0]), jnp.asarray([0.3, 0.2]))


@pytest.mark.parametrize("power", [None, 0.0, 0.5, -1.0], ids=str)
@pytest.mark.parametrize("loss", ["squares", "huber", "log-cosh"])
def test_gauss_newton_uses_the_gradient_of_the_loss(loss, power):
    rule = criterion(loss, power)
    e, slope = rule.errors(RUN, MEASURED)
    half = WEIGHT * rule.share(e) * e * slope
    exact = jax.grad(lambda y: rule(y, MEASURED, WEIGHT))(RUN)
    np.testing.assert_allclose(2 * half, exact, rtol=1e-12, atol=1e-14)
    step = 1e-6
    for index in np.ndindex(*RUN.shape):
        move = jnp.zeros_like(RUN).at[index].set(step)
        ends = [rule(RUN + s * move, MEASURED, WEIGHT) for s in (1.0, -1.0)]
        # Central differences: step^2 of truncation, 1e-16 / step of rounding.
        slope_found = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(exact[index], slope_found, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("loss", ["huber", "log-cosh"])
def test_robust_losses_are_squares_near_zero_and_linear_far_out(loss):
    rule, plain = criterion(loss, None), criterion("squares", None)
    near = MEASURED + 1e-5
    np.testing.assert_allclose(
        rule(near, MEASURED, WEIGHT), plain(near, MEASURED, WEIGHT), rtol=1e-8
    )
    far = [float(rule(MEASURED + d, MEASURED, WEIGHT)) for d in (1e3, 2e3, 3e3)]
    np.testing.assert_allclose(far[2] - far[1], far[1] - far[0], rtol=1e-10)
    slope = float(jnp.sum(2 * WEIGHT * rule.corner[None]))
    np.testing.assert_allclose(far[1] - far[0], 1e3 * slope, rtol=1e-10)


def test_transforms_are_those_of_box_and_cox():
    y = np.array([[0.2, 0.2], [1.0, 1.0], [5.0, 5.0]])
    for power in (0.0, 0.5, -1.0, 2.0):
        found = criterion("squares", power).transform(jnp.asarray(y))[0]
        expected = np.log(y[:, 0]) if power == 0 else (y[:, 0] ** power - 1) / power
        np.testing.assert_allclose(found[:, 0], expected, rtol=1e-14, atol=1e-15)
        # The exponent one is the identity but for a constant.
        np.testing.assert_allclose(found[:, 1], y[:, 1] - 1.0, rtol=1e-12)


def test_a_transform_goes_on_as_its_tangent_below_the_floor():
    rule = criterion("squares", 0.0)
    y = jnp.asarray([[0.05, 0.0], [0.0, 0.0], [-7.0, -7.0]])
    value, slope = rule.transform(y)
    np.testing.assert_allclose(
        value[:, 0], np.log(0.05) + (np.array([0.05, 0, -7]) - 0.05) / 0.05, rtol=1e-14
    )
    np.testing.assert_allclose(slope[:, 0], 20.0, rtol=1e-14)


def test_the_criterion_of_a_task_is_that_of_its_data():
    net, data = common.named("one model"), common.dataset()
    positive = common.from_rows(
        [np.abs(common.rows_of(data, n)) + 0.1 for n in range(len(data))]
    )
    task, spread = make_task(net, positive, loss="huber", corner=0.5, box_cox=0.0)
    measured = np.asarray(task.drive.measured)[task.masks.scored[..., 0], 0]
    np.testing.assert_allclose(spread, np.log(measured).std(), rtol=1e-12)
    np.testing.assert_allclose(task.criterion.corner, 0.5 * spread, rtol=1e-12)
    np.testing.assert_allclose(task.criterion.floor, 0.5 * measured.min(), rtol=1e-12)


def test_a_value_that_is_not_positive_cannot_be_transformed():
    net, data = common.named("one model"), common.dataset()
    rows = [np.abs(common.rows_of(data, n)) + 0.1 for n in range(len(data))]
    rows[1][7, Y] = -0.25
    method = SimulationError(horizons=(), max_steps=0, box_cox={"y": 0.0})
    with pytest.raises(DataError, match=r"y is -0.25 at row 7 of record") as caught:
        refine(net, common.from_rows(rows), method)
    assert (caught.value.channel, caught.value.row) == ("y", 7)
    # A sample that does not count may be anything.
    rows[1][7, Y] = np.nan
    assert refine(net, common.from_rows(rows), method).is_okay


def test_a_transform_of_an_unknown_output_is_refused():
    method = SimulationError(horizons=(), max_steps=0, box_cox={"NOx": 0.0})
    with pytest.raises(SpecError, match="box_cox names 'NOx'"):
        refine(common.named("one model"), common.dataset(), method)
