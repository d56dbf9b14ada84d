"""Small records of two outputs for the tests of the search."""

from functools import cache

import numpy as np

from jaxnarx.data import Dataset

LENGTHS = 150, 160, 150, 150
"""One differs: groups of one length share their programs."""


def steps(rng: np.random.Generator, rows: int, hold: int) -> np.ndarray:
    """Of random height, -1 to 1."""
    return np.repeat(rng.uniform(-1, 1, rows // hold + 1), hold)[:rows]


def made(us, ys) -> Dataset:
    """Of one input."""
    names = ["y", "w"][: ys[0].shape[1]]
    return Dataset.from_arrays(us, ys, inputs=["u"], outputs=names, sample_time=0.1)


@cache
def plant(outputs: int = 1, lengths: tuple[int, ...] = LENGTHS) -> Dataset:
    """`y` of first order with a gain that bends; `w` slower and linear."""
    rng = np.random.default_rng(2)
    us, ys = [], []
    for n in lengths:
        u, y = steps(rng, n, 7), np.zeros((n, 2))
        for t in range(1, n):
            y[t, 0] = 0.7 * y[t - 1, 0] + np.tanh(2.5 * u[t - 1])
            y[t, 1] = 0.9 * y[t - 1, 1] - u[t - 1] + 1.0
        us.append(u[:, None])
        ys.append((y + 0.02 * rng.normal(size=y.shape))[:, :outputs])
    return made(us, ys)


@cache
def explosive() -> Dataset:
    """Grows by a tenth a sample from next to nothing, measured with more noise."""
    rng = np.random.default_rng(3)
    us, ys = [], []
    for n in LENGTHS:
        u, y = steps(rng, n, 7), np.zeros(n)
        for t in range(1, n):
            y[t] = 1.08 * y[t - 1] + 1e-3 * (u[t - 1] + 1)
        y += 3e-3 * y.max() * rng.normal(size=n)
        us.append(u[:, None])
        ys.append(y[:, None])
    return made(us, ys)
