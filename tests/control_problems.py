"""A linear network that is known exactly, and plants that differ from it."""

from functools import cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxnarx as jnx
from jaxnarx.calibration import AbstractPlant, NetworkPlant

TIME = 0.5
A = np.array([[0.7, 0.0], [0.0, 0.8]])
B = np.array([[0.5, 0.1], [0.2, -0.4]])
"""y(t) = A y(t-1) + B u(t-1), u = (force, load)."""


@cache
def linear() -> jnx.Network:
    """The network of speed and heat, from records without noise."""
    random = np.random.default_rng(0)
    u = random.uniform(-1, 1, (200, 2))
    y = np.zeros((200, 2))
    for t in range(1, 200):
        y[t] = A @ y[t - 1] + B @ u[t - 1]
    data = jnx.Dataset.from_arrays(
        u, y, inputs=["force", "load"], outputs=["speed", "heat"], sample_time=TIME
    )
    pool = jnx.polynomial_pool(
        data.channels, input_lags=(1,), output_lags=(1,), degree=1
    )
    chosen = jnx.select(pool, data, jnx.ForwardOLS(max_terms=6)).value
    return jnx.grow(chosen, data, jnx.Global()).value


class Shifted(AbstractPlant):
    """A network whose outputs are off by a constant, and whose first input is so many
    times as strong."""

    plant: NetworkPlant
    shift: float = 0.0
    strength: float = 1.0
    inputs: tuple[str, ...] = eqx.field(static=True, default=("force", "load"))
    outputs: tuple[str, ...] = eqx.field(static=True, default=("speed", "heat"))
    sample_time: float = eqx.field(static=True, default=TIME)

    def run(self, u):
        raise NotImplementedError

    def begin(self, u):
        state, y = self.plant.begin(u)
        return state, y + self.shift

    def step(self, state, u):
        state, y = self.plant.step(state, u * jnp.array([self.strength, 1.0]))
        return state, y + self.shift


def shifted(shift: float, strength: float = 1.0) -> Shifted:
    return Shifted(plant=NetworkPlant.of(linear()), shift=shift, strength=strength)


def wanted(samples: int = 80, seed: int = 1, hold: int = 20) -> jnx.Dataset:
    """References of speed in steps, and a load that changes."""
    random = np.random.default_rng(seed)
    speed = np.repeat(random.uniform(-0.8, 0.8, samples // hold), hold)
    load = np.repeat(random.uniform(-0.5, 0.5, samples // hold), hold)
    return jnx.Dataset.from_arrays(
        load, speed, inputs=["load"], outputs=["speed"], sample_time=TIME
    )
