"""The pull of `shrink`: of ridge regression in centred columns, towards the start."""

import dataclasses
from functools import cache

import common
import numpy as np
import pytest
from common import A, B
from hidden_problems import network, truth

from jaxnarx.models import Network, scales
from jaxnarx.refinement import refine
from jaxnarx.refinement._refine import make_task
from jaxnarx.refinement.layout import make_layout
from jaxnarx.refinement.problem import make_problem
from jaxnarx.settings import SimulationError
from jaxnarx.simulation import run

BAND = (0.5, 2.0)
START = {(0, 0): 0.4, (0, 1): 0.5, (0, 2): -0.3, (1, 2): 0.2}
"""Of a(t) and b(t-1): without feedback the free run is linear in the coefficients."""
LOW, HIGH = np.array([-3.0, -5.0, -15.0, -6.0]), np.array([9.0, 1.0, 25.0, 6.0])
TIGHT = SimulationError(horizons=(), ridge=0, tolerance=0, max_steps=30)


@cache
def static() -> Network:
    """A network that feeds nothing back, whose ranges are far from symmetric."""
    part = common.Part([list(START.items())])
    net = common.network([part], variables=((A, 0), (B, 1)))
    low, high = map(common.device, (LOW, HIGH))
    return dataclasses.replace(net, low=low, high=high)


def trained(shrink: float) -> np.ndarray:
    """Coefficients after training, in the order of `START`."""
    method = dataclasses.replace(TIGHT, shrink=shrink)
    local = refine(static(), common.dataset(), method).value.models[0].local
    rows = map(tuple, np.asarray(local.factor)[np.asarray(local.index)[0]].tolist())
    found = dict(zip(rows, np.asarray(local.coefficient)[0].tolist(), strict=True))
    return np.array([found[row] for row in START])


def regression(shrink: float) -> np.ndarray:
    """The same in closed form.

    With z of middle zero and spread one, a quarter of the range, and sigma that of the
    output, min over psi of  sum (y - R psi)^2 / (N var y) + shrink |psi - start|^2 /
    sigma^2, where R are the products of z.
    """
    rows = [common.rows_of(common.dataset(), n) for n in range(len(common.LENGTHS))]
    a = np.concatenate([r[1:, A] for r in rows]) / common.GAIN[A]
    b = np.concatenate([r[:-1, B] for r in rows]) / common.GAIN[B]
    y = np.concatenate([r[1:, 2] for r in rows]) / common.GAIN[2]
    gain = common.GAIN
    middle, spread = (LOW + HIGH) / 2 / gain, (HIGH - LOW) / 4 / gain
    za, zb = (a - middle[A]) / spread[A], (b - middle[B]) / spread[B]
    one = np.ones_like(a)
    plain = np.stack([one, a, b, a * b], axis=1)
    centred = np.stack([one, za, zb, za * zb], axis=1)
    change = np.linalg.lstsq(centred, plain, rcond=None)[0]  # psi = change theta
    start = change @ np.array(list(START.values()))
    weight, pull = 1 / (len(y) * y.var()), shrink / spread[2] ** 2
    gram = weight * centred.T @ centred + pull * np.eye(4)
    right = weight * centred.T @ y + pull * start
    return np.linalg.solve(change, np.linalg.solve(gram, right))


@pytest.mark.parametrize("shrink", [0.0, 0.01, 1.0])
def test_training_is_ridge_regression_towards_the_start(shrink):
    found, expected = trained(shrink), regression(shrink)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8)
    assert np.abs(found - list(START.values())).max() > 1e-3


def test_it_goes_from_no_pull_at_all_to_staying():
    start = np.array(list(START.values()))
    np.testing.assert_allclose(trained(1e-12), trained(0.0), rtol=1e-6)
    np.testing.assert_allclose(trained(1e9), start, rtol=1e-6)
    away = [np.abs(trained(s) - start).max() for s in (0.01, 0.1, 1.0, 10.0)]
    assert np.all(np.diff(away) < 0)


@pytest.mark.parametrize("kind", ["plain", "scheduled"])
def test_centred_coordinates_of_all_channels_are_of_the_same_network(kind):
    net, data = network(kind), truth(kind).data
    task, _ = make_task(net, data)
    layout = make_layout(net, None, BAND, every=True)
    assert layout.back is not None and make_layout(net, None, BAND).back is None
    u = layout.gather(net)
    runs = [
        np.asarray(run(one, task.drive, task.anchors(None)))
        for one in (net, layout.place(u))
    ]
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-11)
    again = layout.gather(layout.place(u + 0.1))
    np.testing.assert_allclose(again, u + 0.1, atol=1e-11)


def test_hidden_channels_are_pulled_in_units_of_their_own():
    net, data = network(), truth().data
    task, _ = make_task(net, data)
    layout = make_layout(net, None, BAND, every=True)
    problem = make_problem(layout, task, None, shrink=0.3)
    pull, sigma = np.asarray(problem.shrink), np.asarray(scales(net)[1])
    for (start, stop), own in zip(layout.spans(), sigma, strict=True):
        inner = np.intersect1d(layout.coefficients(), np.arange(start, stop))
        np.testing.assert_allclose(pull[inner], 0.3 / own**2)
        assert inner.size
    np.testing.assert_array_equal(pull[layout.partition()], 0.0)
    assert make_problem(layout, task, None).shrink is None
