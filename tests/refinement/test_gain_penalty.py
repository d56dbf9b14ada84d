"""Signs of gains at rest as a penalty of a refinement, on a small noisy plant."""

from functools import cache

import jax
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import count_wrong_signs, steady_states
from jaxnarx.identification import Physics
from jaxnarx.models import make_pairs
from jaxnarx.refinement.gain_penalty import POINTS, WEIGHT, sign_penalty
from jaxnarx.refinement.layout import make_layout

KNOWN = {"y": Physics(increases_with=["a", "b"])}
"""What the plant does; noise hides it for `b`."""


@cache
def data() -> jnx.Dataset:
    """First order; bent in `a`, and next to nothing of `b`."""
    rng = np.random.default_rng(0)
    us, ys = [], []
    for n in (150, 160):
        u, y = (
            np.repeat(rng.uniform(-1, 1, (n // 7 + 1, 2)), 7, axis=0)[:n],
            np.zeros(n),
        )
        for t in range(1, n):
            y[t] = 0.7 * y[t - 1] + np.tanh(2.5 * u[t - 1, 0]) + 0.05 * u[t - 1, 1]
        us.append(u)
        ys.append((y + rng.normal(size=n))[:, None])
    return jnx.Dataset.from_arrays(
        us, ys, inputs=["a", "b"], outputs=["y"], sample_time=0.1
    )


@cache
def start() -> jnx.Network:
    pool = jnx.polynomial_pool(
        data().channels, input_lags=(1, 2), output_lags=(1,), degree=2
    )
    terms = jnx.select(pool, data(), jnx.ForwardOLS(max_terms=10)).value
    return jnx.grow(terms, data(), jnx.Global()).value


def test_the_penalty_is_that_of_runs_to_rest():
    """And its derivatives are those of central differences."""
    penalty, network = sign_penalty(start(), data(), KNOWN), start()
    layout = make_layout(network, None, (0.2, 5.0))
    u = jax.numpy.asarray(layout.gather(network))
    pairs = make_pairs(data(), KNOWN["y"], output="y", points=POINTS)
    both = np.concatenate([pairs.low, pairs.high])
    y = steady_states(network, both, np.zeros(1)).value[:, 0].reshape(2, -1)
    size = float(network.high[2] - network.low[2]) / 4
    fall = np.maximum(y[0] - y[1], 0.0) / size
    assert penalty is not None and 0 < (fall > 0).mean() < 1
    assert penalty(layout, u) == pytest.approx(WEIGHT * np.mean(fall**2), rel=1e-4)
    found = penalty.linear(layout, u)
    assert found.loss == pytest.approx(float(penalty(layout, u)))
    steps = 1e-6 * np.eye(len(u))
    near = np.asarray(u)[None] + np.concatenate([steps, -steps, 0 * steps[:1]])
    every = jax.jit(jax.vmap(lambda u: penalty.residuals(layout, u)))(near)
    *values, r = np.asarray(every)
    up, down = np.split(np.array(values), 2)
    slopes = (up - down).T / 2e-6
    np.testing.assert_allclose(found.gradient, r @ slopes, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(found.gram, slopes.T @ slopes, rtol=1e-3, atol=1e-4)


def test_a_refinement_turns_wrong_gains_round():
    found = {}
    for name, physics in (("free", None), ("signed", KNOWN)):
        method = jnx.SimulationError(max_steps=12)
        one = jnx.refine(start(), data(), method, physics=physics)
        wrong = count_wrong_signs(one.value, data(), KNOWN, points=100)["y"]
        run = jnx.simulate(one.value, data()).value
        errors = [(r.y - y)[2:] for r, y in zip(data(), run.outputs, strict=True)]
        found[name] = wrong, np.sqrt(np.mean(np.concatenate(errors) ** 2))
        assert ("penalty of gains" in one.detail) == (physics is not None)
    assert found["free"][0].wrong > 10
    assert found["signed"][0].wrong == 0 < found["signed"][0].known
    assert found["signed"][1] < 1.03 * found["free"][1]


def test_what_cannot_be_asked_is_refused():
    still = jnx.Dataset.from_arrays(
        [np.column_stack([r.u[:, 0], np.zeros(len(r))]) for r in data()],
        [r.y for r in data()],
        inputs=["a", "b"],
        outputs=["y"],
        sample_time=0.1,
    )
    with pytest.raises(SpecError, match="b does not move"):
        jnx.refine(start(), still, physics=KNOWN)
    with pytest.raises(SpecError, match="there is no input 'c'"):
        jnx.refine(start(), data(), physics={"y": Physics(increases_with=["c"])})
    with pytest.raises(SpecError, match="take SimulationError"):
        jnx.refine(start(), data(), jnx.PredictionError(), physics=KNOWN)
    slow = {"y": Physics(longest_time_constant=3.0)}
    assert sign_penalty(start(), data(), slow) is None
