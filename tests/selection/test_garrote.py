"""The garrote's quadratic program: optimality, and another solver's answer."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from jaxnarx.selection.anova.garrote import garrote


def quadratic(kind: str, size: int = 12, seed: int = 0):
    """(G, b, w): contributions f, G = f'f, b = f'y and penalties."""
    rng = np.random.default_rng([seed, size])
    f = rng.normal(size=(60, size))
    if kind == "collinear":
        f = f + 30 * rng.normal(size=(60, 1))
    if kind == "singular":
        f[:, size // 2 :] = f[:, : size - size // 2]
        f[:, -1] = 0.0
    y = f @ rng.uniform(-0.5, 1.5, size) + rng.normal(size=60)
    return f.T @ f, f.T @ y, rng.uniform(0, 60, size), f, y


@pytest.mark.parametrize("kind", ("plain", "collinear", "singular"))
@pytest.mark.parametrize("seed", range(5))
def test_garrote_satisfies_the_optimality_conditions(kind, seed):
    gram, moment, penalty, f, _ = quadratic(kind, seed=seed)
    c = garrote(gram, moment, penalty)
    assert np.all((c >= 0) & (c <= 1))
    slope = 2 * (gram @ c - moment) + penalty
    # Each gradient against the terms it is the difference of.
    slope = slope / (np.abs(gram).sum(axis=1) + np.abs(moment) + penalty + 1)
    live = np.diag(gram) > 0
    assert np.all(np.abs(slope[(c > 0) & (c < 1)]) < 1e-10)
    assert np.all(slope[live & (c == 0)] > -1e-10)
    assert np.all(slope[c == 1] < 1e-10)
    assert not np.any(c[~live])


@pytest.mark.parametrize("seed", range(5))
def test_garrote_equals_bounded_least_squares(seed):
    gram, moment, penalty, _, _ = quadratic("plain", seed=seed)
    root = np.linalg.cholesky(gram).T
    target = np.linalg.solve(root.T, moment - penalty / 2)
    other = lsq_linear(root, target, (0, 1), method="bvls", tol=1e-14)
    # The condition of G is near 10: both are exact to rounding.
    np.testing.assert_allclose(garrote(gram, moment, penalty), other.x, atol=1e-9)
