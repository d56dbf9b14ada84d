"""Fleets that tests share: engines of known coefficients, and what is learnt of them.

y(t) = c + a u(t-1) + b u(t-2) + d u(t-1)^2 + noise, with (c, a, b, d) drawn from a
normal distribution; by `fed` another share of y(t-1).
"""

from functools import cache

import numpy as np

import jaxnarx as jnx
from jaxnarx.models import set_bounds

MEAN = np.array([3.0, 2.0, -0.8, 0.6])
ROOT = np.array([[0.6, 0.0], [0.3, 0.2], [0.0, 0.3], [0.1, -0.1]])
NOISE = 0.05
SAMPLE_TIME = 0.1


def coefficients(count: int, seed: int) -> np.ndarray:
    """Those of so many engines."""
    rng = np.random.default_rng(seed)
    return MEAN + rng.normal(size=(count, 2)) @ ROOT.T


def engine(
    theta: np.ndarray, samples: int, seed: int, fed: float = 0.0, noise: float = NOISE
) -> jnx.Dataset:
    """One record of an engine, from rest."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, samples // 4 + 1), 4)[:samples]
    u = u + 0.1 * rng.normal(size=samples)
    y = np.zeros(samples)
    for t in range(2, samples):
        now = np.array([1.0, u[t - 1], u[t - 2], u[t - 1] ** 2])
        y[t] = fed * y[t - 1] + now @ theta
    y[:2] = y[2]
    return jnx.Dataset.from_arrays(
        u,
        y + noise * rng.normal(size=samples),
        inputs="u",
        outputs="y",
        sample_time=SAMPLE_TIME,
    )


@cache
def donors(count: int = 24, samples: int = 200, fed: float = 0.0):
    """Records of some engines, by name."""
    every = coefficients(count, 1)
    return {
        f"engine {n}": engine(theta, samples, 100 + n, fed)
        for n, theta in enumerate(every)
    }


@cache
def structure(fed: bool = False) -> jnx.Network:
    """A network with the terms of these engines, fitted to one of them."""
    data = donors(fed=0.5 if fed else 0.0)["engine 0"]
    lags = {"input_lags": (1, 2), "output_lags": (1,) if fed else ()}
    pool = jnx.polynomial_pool(data.channels, degree=2, **lags)
    kept = [
        n
        for n, row in enumerate(pool.factor.tolist())
        if sorted(row) in ([0, 0], [0, 1], [0, 2], [1, 1], [0, 3])
    ]
    pool = jnx.Pool(pool.variables, pool.factor[kept], pool.channels, pool.outputs)
    network = jnx.grow(pool, data, jnx.Global()).value
    return set_bounds(network, 100.0)


@cache
def learnt() -> jnx.Solution:
    """The prior of the usual donors."""
    return jnx.fleet.learn(donors(), structure(), rungs=(5, 10, 20, 50))
