"""A plant with two states, one input and one output; with `bend` a quadratic one.

x(t+1) = A x(t) + B u(t) + b + bend u(t) [x1(t)/7, 0] ,
y(t) = C x(t) + D u(t) + d + bend x1(t)^2 / 10
"""

from functools import cache

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset
from jaxnarx.linear.state_space.model import StateSpace
from jaxnarx.settings import HiddenStates

A, B, C = np.array([[0.8, 0.25], [-0.2, 0.6]]), np.array([[0.5], [1.0]]), [[1.0, 0.4]]
OFFSET, DIRECT, AWAY = np.array([0.1, -0.2]), 0.3, 2.0
LENGTHS = 200, 120
METHOD = HiddenStates(
    states=2, degree=1, shrink=(1e-2, 1e-4), window=15, max_steps=25, start="subspace"
)
"""Trains one start alone; its programs serve all tests with these sizes."""


def plant() -> StateSpace:
    """The linear one."""
    offset = np.array([AWAY])
    direct = np.array([[DIRECT]])
    none = np.zeros((1, 2))
    return StateSpace(A, B, OFFSET, np.array(C), direct, offset, none, np.ones(1))


def record(
    length: int, seed: int, bend: float, size: float
) -> tuple[Float[np.ndarray, "time 1"], Float[np.ndarray, "time 1"]]:
    """Steps of four samples up to `size`, from a state that is not at rest."""
    rng = np.random.default_rng([seed, length])
    u = np.repeat(rng.uniform(-size, size, length // 4 + 1), 4)[:length]
    x, y = np.array([1.0, -1.0]), np.zeros(length)
    for t in range(length):
        y[t] = np.array(C[0]) @ x + DIRECT * u[t] + AWAY + bend * x[0] ** 2 / 10
        x = A @ x + B[:, 0] * u[t] + OFFSET + bend * u[t] * np.array([x[0] / 7, 0])
    return u[:, None], y[:, None]


@cache
def records(
    lengths: tuple[int, ...] = LENGTHS,
    *,
    seed: int = 0,
    bend: float = 0.0,
    size: float = 1.0,
) -> Dataset:
    """Runs of it without noise."""
    each = [record(n, seed + k, bend, size) for k, n in enumerate(lengths)]
    return made([u for u, _ in each], [y for _, y in each])


def made(us, ys) -> Dataset:
    """Records of these inputs and outputs, at 0.1 s."""
    inputs = [f"u{n + 1}" for n in range(us[0].shape[1])]
    outputs = ["y", "w"][: ys[0].shape[1]]
    return Dataset.from_arrays(us, ys, inputs=inputs, outputs=outputs, sample_time=0.1)
