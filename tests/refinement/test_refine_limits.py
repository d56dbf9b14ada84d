"""A network with limits is refined and judged as without on inputs held by hand."""

import dataclasses
from functools import cache

import common
import jax
import numpy as np
import oracles
from common import A, B

from jaxnarx.confidence._bands import bands
from jaxnarx.confidence._uncertainty import uncertainty
from jaxnarx.models import hold_to_range, report_outputs
from jaxnarx.refinement._refine import make_task
from jaxnarx.refinement._stability import stability
from jaxnarx.refinement.gauss_newton import normal_equations
from jaxnarx.refinement.layout import make_layout
from jaxnarx.simulation import run, simulate

KIND = "coupled, by own output"
LOW, HIGH = np.array([-1.5, -0.3, -3.0, -0.3]), np.array([1.0, 0.4, 0.5, 1.0])


@cache
def plain():
    low, high = jax.device_put((LOW, HIGH))
    net = common.named(KIND, spare_models=1, spare_slots=1)
    return dataclasses.replace(net, low=low, high=high)


@cache
def held():
    return hold_to_range(plain(), 0.05, outside="hold")


@cache
def data():
    return common.dataset()


@cache
def clipped():
    """The same records with inputs at the edge where they go beyond."""
    rows = [common.rows_of(data(), n).copy() for n in range(len(data()))]
    for r in rows:
        r[:, [A, B]] = np.clip(r[:, [A, B]], LOW[:2], HIGH[:2])
    return common.from_rows(rows)


def test_derivatives_of_refinement_are_central_differences_of_held_inputs():
    (task, _), (other, _) = make_task(held(), data()), make_task(plain(), clipped())
    layouts = [make_layout(net, None, (0.5, 2.0)) for net in (held(), plain())]
    u, anchor = layouts[0].gather(held()), task.anchors(None)
    found = normal_equations(layouts[0], u, task.drive, anchor, task.weight)
    root = np.sqrt(np.asarray(other.weight))

    def residual(u):
        y = run(layouts[1].place(jax.device_put(u)), other.drive, anchor)
        return root * np.asarray(y - other.drive.measured)

    gram, gradient = oracles.normal_equations(residual, np.asarray(u))
    assert np.any(np.asarray(task.drive.measured) * 10 > HIGH[2])
    np.testing.assert_allclose(found[0], np.sum(residual(u) ** 2), rtol=1e-12)
    # As in `test_refine`: what central differences leave.
    for a, b in ((found[1], gradient), (found[2], gram)):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-7 * np.abs(b).max())
    assert np.asarray(layouts[0].place(u).hold) == 0.05


def test_stability_rests_on_what_is_fed_back_not_on_what_is_reported():
    free = simulate(held(), data())
    assert free.stats["held"].sum() > 0
    found = stability(held(), data(), samples=60, simulated=free).value
    expected = stability(plain(), clipped(), samples=60).value
    for a, b in zip(found.poles, expected.poles, strict=True):
        assert dataclasses.astuple(a) == dataclasses.astuple(b)
    assert found.bound.rate == expected.bound.rate
    assert found.bound.fails == expected.bound.fails


def test_bands_are_held_as_the_run_is():
    sure, other = uncertainty(held(), data()), uncertainty(plain(), clipped())
    np.testing.assert_allclose(sure.value.covariance, other.value.covariance)
    found = bands(held(), sure.value, data()).value
    free = bands(plain(), other.value, clipped()).value
    start = held().history
    for n in range(len(data())):
        pairs = ((found.lower, free.lower), (found.upper, free.upper))
        for a, b in pairs:
            np.testing.assert_allclose(a[n][:start], b[n][:start])
            np.testing.assert_allclose(
                a[n][start:], report_outputs(held(), b[n][start:])[0]
            )
        assert np.all(found.lower[n] <= found.run[n])
        assert np.all(found.run[n] <= found.upper[n])
        assert np.all(found.measured_lower[n] < found.run[n])
        np.testing.assert_allclose(found.deviation[n], free.deviation[n])
    assert any(mask.any() for mask in found.run.held)
