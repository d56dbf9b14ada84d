"""Merging of sibling leaves after growth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tree_oracles

from jaxnarx.models import SigmoidTree
from jaxnarx.partition.prune import prune
from jaxnarx.partition.split import SplitRows
from jaxnarx.partition.tree import TreeStage, sigmoid_tree

ROWS, MODELS = 300, 6

_compiled = jax.jit(sigmoid_tree, static_argnames="max_models")


def problem(bent: bool) -> SplitRows:
    """A plane, or two that meet on a diagonal, with noise; every tenth row unused."""
    rng = np.random.default_rng(2)
    z = rng.uniform(size=(2, ROWS))
    y = z[0] - 2 * z[1] + (6 * np.maximum(z[0] + z[1] - 0.9, 0) if bent else 0.0)
    y += 0.1 * rng.normal(size=ROWS)
    weight = (np.arange(ROWS) % 10 > 0).astype(float)
    y[weight == 0] = 1e3
    p = np.stack([np.ones(ROWS), *z])
    data = (jnp.asarray(a) for a in (p, z, y, weight))
    settings = {"smoothness": 1.0, "ridge": 0.0, "least": 3.0}
    number = {name: jnp.asarray(value) for name, value in settings.items()}
    return SplitRows(*data, **number, picks=None, first=None)


def grown(rows: SplitRows) -> TreeStage:
    """Six leaves, whether they are needed or not."""
    settings = {n: getattr(rows, n) for n in ("smoothness", "ridge", "least")}
    data = rows.p, rows.z, rows.y, rows.weight
    stages = _compiled(*data, **settings, max_models=MODELS)
    return jax.tree.map(lambda a: a[-1], stages)


def validities(stage: TreeStage, rows: SplitRows) -> np.ndarray:
    tree = SigmoidTree(stage.direction, stage.border, stage.log_steepness, stage.path)
    tree.check(stage.theta.shape[0], 2)
    return np.asarray(tree(rows.z, jnp.arange(stage.theta.shape[0]) < stage.count))


def aicc(stage: TreeStage, rows: SplitRows) -> float:
    """N ln(SSE/N) + 2 n + 2 n (n + 1)/(N - n - 1), N the rows that count."""
    n, samples = float(stage.effective), int(np.sum(rows.weight > 0))
    fit = samples * np.log(float(stage.sse) / samples)
    return fit + 2 * n + 2 * n * (n + 1) / (samples - n - 1)


@pytest.mark.parametrize(("bent", "at_most"), [(False, 1), (True, 3)])
def test_leaves_that_serve_nothing_go(bent, at_most):
    rows = problem(bent)
    full = grown(rows)
    assert int(full.count) == MODELS
    small = prune(full, rows)
    assert 1 <= int(small.count) <= at_most
    assert small.theta.shape[0] == int(small.count) == small.border.shape[0] + 1
    assert aicc(small, rows) < aicc(full, rows)
    if not bent:
        # One plane: the least squares of everything.
        used = np.asarray(rows.weight) > 0
        x, y = np.asarray(rows.p).T[used], np.asarray(rows.y)[used]
        expected = tree_oracles.weighted_least_squares(x, y, np.ones(len(y)))
        np.testing.assert_allclose(small.theta, expected[None], rtol=1e-7)
        assert float(small.effective) == pytest.approx(3, rel=1e-9)
    else:
        assert int(small.count) > 1


def test_the_figures_are_those_of_the_tree_that_is_left():
    rows = problem(True)
    small = prune(grown(rows), rows)
    phi = validities(small, rows)
    np.testing.assert_allclose(phi.sum(axis=0), 1.0, rtol=1e-12)
    output = np.sum(phi * np.asarray(small.theta @ rows.p), axis=0)
    weight = np.asarray(rows.weight)
    sse = np.sum(weight * (np.asarray(rows.y) - output) ** 2)
    np.testing.assert_allclose(small.sse, sse, rtol=1e-9)
    p, effective = np.asarray(rows.p).T, 2.0 * (len(phi) - 1)
    for one in phi:
        w = np.diag(one * weight)
        effective += np.trace(one[:, None] * p @ np.linalg.solve(p.T @ w @ p, p.T @ w))
    np.testing.assert_allclose(small.effective, effective, rtol=1e-7)
    # Nothing more to gain.
    again = prune(small, rows)
    np.testing.assert_array_equal(again.path, small.path)
    np.testing.assert_array_equal(again.theta, small.theta)


def test_only_siblings_merge():
    """Leaf 0 hangs on gate 0 alone, 1 and 2 on gate 1 behind it: only these may."""
    rows = problem(False)
    stage = TreeStage(
        jnp.asarray([[1.0, 0.0], [0.0, 1.0]]),
        jnp.asarray([0.5, 0.5]),
        jnp.asarray([3.0, 3.0]),
        jnp.asarray([[1, 0], [-1, 1], [-1, -1]]),
        # Coefficients so poor that any merger pays.
        jnp.asarray([[50.0, 0.0, 0.0], [-50.0, 0.0, 0.0], [80.0, 0.0, 0.0]]),
        jnp.asarray(3),
        jnp.asarray(1e6),
        jnp.asarray(13.0),
    )
    apart = validities(stage, rows)
    small = prune(stage, rows)
    # Then the last two are siblings, too, and everything is one plane again.
    assert int(small.count) == 1
    np.testing.assert_allclose(apart[1] + apart[2], 1 - apart[0], rtol=1e-12)
