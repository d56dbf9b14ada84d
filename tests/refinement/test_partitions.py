"""Refinement through every kind of validity function: derivatives, limits, names."""

import common
import equinox as eqx
import jax
import numpy as np
import oracles
import pytest

from jaxnarx.models import (
    AbstractValidity,
    Boxes,
    Compact,
    LogSigmoids,
    Network,
    SigmoidTree,
)
from jaxnarx.refinement import refine
from jaxnarx.refinement.gauss_newton import normal_equations
from jaxnarx.refinement.labels import label
from jaxnarx.refinement.layout import freeze, make_layout
from jaxnarx.refinement.training_data import make_task
from jaxnarx.settings import SimulationError
from jaxnarx.simulation import run

BAND = (0.5, 2.0)
LOW = common.device(np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.5], [0.3, 0.3]]))
HIGH = common.device(np.array([[0.4, 1.0], [1.0, 0.5], [1.0, 1.0], [0.6, 0.6]]))
TREE = SigmoidTree(
    common.device(np.array([[1.0, 0.3], [-0.2, 0.9], [0.0, 0.0]])),
    common.device(np.array([0.5, 0.4, 0.0])),
    common.device(np.log([5.0, 8.0, 1.0])),
    common.device(np.array([[-1, 0, 0], [1, -1, 0], [1, 1, 0], [0, 0, 0]])),
)
"""Three leaves of two oblique gates; a gate and a leaf are spare."""
COMPACT = Compact(LOW, HIGH, common.device(np.log(np.full((4, 2), 0.25))))
SIGMOIDS = LogSigmoids(*map(common.device, (np.array([0.45, 0.8]), np.log(7.0))))
"""Two models, and a border of a spare one."""


def networks(kind: str, first: AbstractValidity) -> Network:
    """Two coupled outputs: `first` in two variables, log-sigmoids in one."""
    net = common.named(kind, spare_models=1, spare_slots=1)
    where = [lambda n: n.models[0].validity, lambda n: n.models[1].validity]
    net = eqx.tree_at(where[0], net, first)
    return eqx.tree_at(where[1], net, SIGMOIDS)


@pytest.mark.parametrize(
    ("kind", "first"),
    [
        ("coupled", TREE),
        ("coupled, by own output", TREE),
        ("coupled, by own output", COMPACT),
    ],
    ids=["tree, by inputs", "tree, by outputs", "compact, by outputs"],
)
def test_normal_equations_are_those_of_the_central_differences(kind, first):
    net = networks(kind, first)
    task, _ = make_task(net, common.dataset())
    layout = make_layout(net, None, BAND)
    anchor, u = task.anchors(None), np.asarray(layout.gather(net))
    found = normal_equations(layout, u, task.drive, anchor, task.weight)
    root, measured = np.sqrt(task.weight), np.asarray(task.drive.measured)

    def residual(u):
        y = run(layout.place(u), task.drive, anchor)
        return root * (np.asarray(y) - measured)

    hessian, gradient = oracles.normal_equations(residual, u)
    # Central differences with h = 1e-6 leave 1e-9 of the largest derivative.
    for ours, plain in ((found[1], gradient), (found[2], hessian)):
        scale = np.abs(plain).max()
        np.testing.assert_allclose(ours, plain, rtol=1e-5, atol=1e-7 * scale)
    # Every trained field of every real region takes part.
    names = label(net, layout).names
    informed = {n for n, d in zip(names, np.diagonal(hessian), strict=True) if d > 0}
    for field in (*first.trained, *SIGMOIDS.trained):
        assert any(field in n for n in informed), field


@pytest.mark.parametrize("first", [TREE, COMPACT], ids=["tree", "compact"])
def test_a_layout_places_what_it_gathers(first):
    net = networks("coupled", first)
    layout = make_layout(net, None, BAND)
    u = layout.gather(net)
    assert np.all(np.asarray(layout.low) < np.asarray(layout.high))
    for a, b in zip(
        jax.tree.leaves(layout.place(u)), jax.tree.leaves(net), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_a_piecewise_constant_partition_has_nothing_to_train():
    net = networks("coupled", Boxes(LOW, HIGH))
    layout = make_layout(net, freeze(net, coefficients=False), BAND)
    assert layout.parameters == sum(leaf.size for leaf in SIGMOIDS.parameters)


def end_of(net: Network) -> SigmoidTree:
    tree = net.models[0].validity
    assert isinstance(tree, SigmoidTree)
    return tree


def test_refinement_lowers_the_error_and_stays_inside_the_limits():
    net = networks("coupled", TREE)
    method = SimulationError(max_steps=3, horizons=(), width_band=BAND)
    solution = refine(net, common.dataset(), method)
    assert solution.stats["loss"] < 0.99 * solution.stats["loss_start"]
    for o in range(2):
        low, high = net.models[o].validity.limits(BAND)
        end = solution.value.models[o].validity
        for a, p, b in zip(
            low.parameters, end.parameters, high.parameters, strict=True
        ):
            assert np.all(np.asarray(a) <= p) and np.all(np.asarray(p) <= b)
    np.testing.assert_array_equal(end_of(solution.value).path, TREE.path)
