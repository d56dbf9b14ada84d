"""Plants of one input that change, and networks of them."""

import jax.numpy as jnp
import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.models import Gaussians, Network, assemble, local_models, output_model
from jaxnarx.partition import grow
from jaxnarx.regressors import Variables, polynomial_pool
from jaxnarx.settings import Global

TIME = 1200


def plant(u, gain, noise=0.0, seed=1):
    """y[t] = 0.8 y[t-1] + gain[t] u[t-1] + noise."""
    e = noise * np.random.default_rng(seed).normal(size=len(u))
    y = np.zeros(len(u))
    for t in range(1, len(u)):
        y[t] = 0.8 * y[t - 1] + gain[t] * u[t - 1] + e[t]
    return y


def excitation(time=TIME, seed=0):
    levels = np.random.default_rng(seed).uniform(-1.0, 1.0, size=time // 5)
    return np.repeat(levels, 5)


def dataset(u, y, missing="refuse") -> Dataset:
    return Dataset.from_arrays(
        u, y, inputs=["u"], outputs=["y"], sample_time=0.1, missing=missing
    )


def pool_of(data):
    return polynomial_pool(data.channels, input_lags=(1,), output_lags=(1,), degree=1)


def one_model(data: Dataset) -> Network:
    return grow(pool_of(data), data, Global()).value


def two_models(data: Dataset) -> Network:
    """Local models for negative and positive u[t-1], all coefficients zero."""
    pool = pool_of(data)
    factor = np.array([[0], [1], [2]])
    local = local_models(factor, np.zeros((2, 3)))
    centre, width = jnp.asarray([[0.0], [1.0]]), jnp.log(jnp.full((2, 1), 0.15))
    model = output_model(
        local,
        Gaussians(centre, width),
        Variables(((0, 1),)),
        np.array([-1.0]),
        np.array([2.0]),
    )
    return assemble(pool, data, np.array([1.0, 1.0]), [model])
