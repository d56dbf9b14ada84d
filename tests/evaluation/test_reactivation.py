"""Reactivation: the design's own figures, when there is none, and what is said."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from common import A, B, Part, device, from_rows, network

from jaxnarx.evaluation._reactivation import (
    reactivation,
    reactivation_notes,
)
from jaxnarx.models import Boxes, Compact, Gaussians, LogSigmoids, SigmoidTree


def gaussians(centre, width) -> Gaussians:
    return Gaussians(jnp.array(centre), jnp.log(jnp.array(width)))


ALL = np.ones(2, bool)
UNEQUAL = gaussians([[0.2], [0.5]], [[0.2], [0.05]])


def test_the_designs_example():
    """phi_1(0.2) = 1, phi_1(0.5) = 0.245085, phi_1(0.9) = 1 (DESIGN section 5)."""
    z = np.array([[0.2], [0.5], [0.9]])
    phi = np.asarray(eqx.filter_jit(UNEQUAL)(device(z.T), device(ALL)))
    np.testing.assert_allclose(phi[0], [1.0, 0.245085, 1.0], atol=5e-7)
    got = reactivation(UNEQUAL, ALL, z)
    np.testing.assert_allclose(got, [1 - 0.245085, 0.0], atol=5e-7)
    # Only behind: between the centres nothing comes back.
    assert np.all(reactivation(UNEQUAL, ALL, z[:2]) == 0)
    assert np.all(reactivation(UNEQUAL, ALL, z[:0]) == 0)


@pytest.mark.parametrize("seed", range(3))
def test_a_common_width_never_reactivates(seed):
    """Quotients of two such weights fall along the line between their centres."""
    rng = np.random.default_rng(seed)
    width = np.tile(rng.uniform(0.05, 0.6, (1, 3)), (6, 1))
    validity = gaussians(rng.uniform(size=(6, 3)), width)
    z = rng.uniform(-1, 2, (300, 3))
    # Exactly zero but for rounding of a difference of numbers below one.
    assert reactivation(validity, np.ones(6, bool), z).max() < 1e-12


def test_scaling_and_spare_models_do_not_matter():
    rng = np.random.default_rng(1)
    centre, width = rng.uniform(size=(3, 2)), rng.uniform(0.05, 0.5, (3, 2))
    z = rng.uniform(size=(200, 2))
    expected = reactivation(gaussians(centre, width), np.ones(3, bool), z)
    assert expected.max() > 0.1
    stretched = gaussians(centre * [3.0, 0.1], width * [3.0, 0.1])
    got = reactivation(stretched, np.ones(3, bool), z * [3.0, 0.1])
    np.testing.assert_allclose(got, expected, rtol=1e-9)
    more = [np.concatenate([a, [[0.5, 0.5]]]) for a in (centre, width)]
    padded = reactivation(gaussians(*more), np.arange(4) < 3, z)
    np.testing.assert_allclose(padded, [*expected, 0.0], rtol=1e-12)


OTHERS = [
    Boxes(jnp.array([[0.0], [0.5]]), jnp.array([[0.5], [1.0]])),
    Compact(
        jnp.array([[0.0], [0.5]]),
        jnp.array([[0.5], [1.0]]),
        jnp.log(jnp.array([[0.5], [0.1]])),
    ),
    LogSigmoids(jnp.array([0.5]), jnp.asarray(2.0)),
    SigmoidTree(jnp.ones((1, 1)), jnp.ones(1) / 2, jnp.ones(1), jnp.array([[-1], [1]])),
]


@pytest.mark.parametrize("validity", OTHERS, ids=lambda v: type(v).__name__)
def test_other_classes_have_one_hill_along_a_line(validity):
    """What the zero rests on: weights rise and then fall, never again."""
    z = np.linspace(-0.5, 1.5, 801)[:, None]
    weights = eqx.filter_jit(validity)(z.T, np.ones(2, bool))
    for phi in np.asarray(weights):
        top = int(phi.argmax())
        assert np.all(np.diff(phi[: top + 1]) >= -1e-12)
        assert np.all(np.diff(phi[top:]) <= 1e-12)
    assert np.all(reactivation(validity, ALL, z) == 0)


def scheduled(width):
    part = Part(
        [[((1,), 1.0)], [((2,), 1.0)]],
        scheduling=((A, 0), (B, 1)),
        offset=[-1.0, -1.0],
        span=[2.0, 2.0],
        centre=[[0.2, 0.5], [0.5, 0.5]],
        width=width,
    )
    return network([part], spare_models=1)


def test_a_report_says_where_it_happens():
    rng = np.random.default_rng(2)
    u, y = rng.uniform(-1, 1, (200, 2)), rng.uniform(size=(200, 2))
    data = from_rows([np.hstack([u, y])])
    (note,) = reactivation_notes(scheduled([[0.2, 0.2], [0.05, 0.05]]), data)
    assert "y: local model 1 is valid again behind model 2, by 0.7" in note
    assert "a[t] = " in note and "b[t-1] = " in note
    assert reactivation_notes(scheduled([[0.2, 0.2], [0.2, 0.2]]), data) == []
    assert reactivation_notes(network([Part([[((1,), 1.0)]])]), data) == []
