"""Small plants with known inverses, as data and as exact networks."""

from collections.abc import Callable

import equinox as eqx
import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.models import Network
from jaxnarx.partition import grow
from jaxnarx.regressors import polynomial_pool
from jaxnarx.settings import Global

DEAD_TIME = 2
"""Samples from u to y of `plant`."""

Plant = Callable[[np.ndarray, np.ndarray], np.ndarray]


def steps(length: int, seed: int, *, low: float = -1.0, high: float = 1.0):
    """Random levels held for 3 to 12 samples."""
    rng = np.random.default_rng(seed)
    holds = rng.integers(3, 13, size=length)
    return np.repeat(rng.uniform(low, high, size=length), holds)[:length]


def plant(u: np.ndarray, d: np.ndarray) -> np.ndarray:
    """First order behind a static curve that rises everywhere on [-1, 1].

    y(t) = 0.6 y(t-1) + 0.4 f(u(t-2)) + 0.1 d(t-2), f(u) = u + 0.3 u^2 - 0.1 u^3.
    """
    y = np.zeros(len(u))
    for t in range(2, len(u)):
        a = u[t - 2]
        y[t] = 0.6 * y[t - 1] + 0.4 * (a + 0.3 * a**2 - 0.1 * a**3) + 0.1 * d[t - 2]
    return y


def linear(u: np.ndarray, d: np.ndarray) -> np.ndarray:
    """y(t) = 0.6 y(t-1) + 0.4 u(t-2) + 0.1 d(t-2): its inverse is exact."""
    y = np.zeros(len(u))
    for t in range(2, len(u)):
        y[t] = 0.6 * y[t - 1] + 0.4 * u[t - 2] + 0.1 * d[t - 2]
    return y


def reversing(u: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The gain of u passes through zero at u = 0.2: f(u) = (u - 0.2)^2."""
    y = np.zeros(len(u))
    for t in range(1, len(u)):
        y[t] = 0.5 * y[t - 1] + (u[t - 1] - 0.2) ** 2 + 0.1 * d[t - 1]
    return y


def delayed_zero(u: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Zero at z = 2: y answers the wrong way first. Static gain 1."""
    y = np.zeros(len(u))
    for t in range(2, len(u)):
        y[t] = 0.5 * y[t - 1] - 0.5 * u[t - 1] + u[t - 2] + 0.1 * d[t - 1]
    return y


def recorded(
    process: Plant, *, seed: int = 0, records: int = 2, length: int = 150, noise=0.0
) -> Dataset:
    """Records of a plant with input u, disturbance d and output y."""
    us, ys = [], []
    for n in range(records):
        u, d = steps(length, 10 * seed + n), steps(length, 1000 + 10 * seed + n)
        y = process(u, d)
        y = y + noise * np.random.default_rng(seed + n).normal(size=length)
        us.append(np.stack([u, d], axis=1))
        ys.append(y[:, None])
    return Dataset.from_arrays(
        us, ys, inputs=["u", "d"], outputs=["y"], sample_time=0.1, units={"u": "deg"}
    )


def exact(
    data: Dataset, *, lags: tuple[int, ...], degree: int, disturbance: int = 1
) -> Network:
    """A forward network that represents the plant exactly, its bounds far away."""
    pool = polynomial_pool(
        data.channels,
        input_lags={"u": lags, "d": (disturbance,)},
        output_lags=(1,),
        degree=degree,
    )
    return widened(grow(pool, data, Global()).value)


def widened(network: Network, factor: float = 5.0) -> Network:
    """The same with bounds of the feedback `factor` times as wide."""
    middle = (network.lower + network.upper) / 2
    half = factor * (network.upper - network.lower) / 2
    return eqx.tree_at(
        lambda n: (n.lower, n.upper), network, (middle - half, middle + half)
    )


def polynomial_inverse(
    data: Dataset, *, degree: int, ahead: tuple[int, ...] = (0, 1), past=()
) -> Network:
    """One polynomial from the reference seen ahead, and d, to u; bounds far away."""
    (seen,) = [n for n in data.channels.input_names if "_ahead" in n]
    pool = polynomial_pool(
        data.channels,
        input_lags={seen: ahead, "d": (0,)},
        output_lags=past,
        degree=degree,
    )
    return widened(grow(pool, data, Global()).value)
