"""A plant whose best calibration is known, a network of it, and a cycle."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxnarx as jnx
from jaxnarx.calibration import FunctionPlant

TIME = 0.5
SAMPLES = 160


def lagged(u):
    """y(t) = .6 y(t-1) + .4 ((c - s/2)^2 + .1 s), heat(t) = .8 heat(t-1) + .2 c."""

    def step(carry, row):
        y, heat = carry
        s, c = row
        y = 0.6 * y + 0.4 * ((c - 0.5 * s) ** 2 + 0.1 * s)
        heat = 0.8 * heat + 0.2 * c
        return (y, heat), jnp.stack([y, heat])

    s, c = u[0]
    start = (c - 0.5 * s) ** 2 + 0.1 * s, c
    return jax.lax.scan(step, start, u)[1]


PLANT = FunctionPlant(
    function=lagged, inputs=("s", "c"), outputs=("y", "heat"), sample_time=TIME
)


def cycle(seed: int = 0, **more) -> jnx.Dataset:
    """A demand s from -1 to 1 in steps, and a wish for `heat`."""
    random = np.random.default_rng(seed)
    s = np.repeat(random.uniform(-1, 1, SAMPLES // 8), 8)
    s[:2] = -1.0, 1.0
    wish = np.full(SAMPLES, 0.2)
    names = {"inputs": "s", "outputs": "wish", "sample_time": TIME}
    return jnx.Dataset.from_arrays(s, wish, **(names | more))


def network_and_cycle():
    """A network of (s, c) with a domain, and a cycle that leaves it a little."""
    random = np.random.default_rng(3)
    u = np.repeat(random.uniform(-1, 1, (60, 2)), 6, axis=0)
    y = np.asarray(lagged(jnp.asarray(u)))
    data = jnx.Dataset.from_arrays(
        u, y, inputs=["s", "c"], outputs=["y", "heat"], sample_time=TIME
    )
    pool = jnx.polynomial_pool(
        data.channels, input_lags=(0,), output_lags=(1,), degree=2
    )
    chosen = jnx.select(pool, data, jnx.ForwardOLS(max_terms=8)).value
    network = jnx.grow(chosen, data, jnx.Global()).value
    return jnx.confidence.fit_domain(network, data), cycle()
