"""The parts of a network that come from data and terms, whatever the partition."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.data import Dataset
from jaxnarx.models.network import LocalModels, Network, OutputModel
from jaxnarx.models.validity import AbstractValidity, Gaussians
from jaxnarx.regressors import Pool, Variables

MARGIN = 0.25
"""Simulated outputs may leave the training range by this share of it on either side."""


def ranges(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest valid value of every signal, physical units."""
    columns = np.concatenate([np.concatenate([r.u, r.y], axis=1) for r in data])
    valid = np.concatenate([r.valid for r in data])
    low = np.where(valid, columns, np.inf).min(axis=0)
    return low, np.where(valid, columns, -np.inf).max(axis=0)


def output_model(
    factor: np.ndarray,
    theta: Float[Array, "models terms"],
    validity: AbstractValidity,
    scheduling: Variables,
    offset: np.ndarray,
    span: np.ndarray,
) -> OutputModel:
    """All local models with the same terms and given coefficients."""
    models, terms = theta.shape
    index = np.broadcast_to(np.arange(terms), (models, terms))
    return OutputModel(
        scheduling,
        jnp.asarray(offset),
        jnp.asarray(span),
        validity,
        jnp.ones(models, bool),
        LocalModels(
            jnp.asarray(factor),
            jnp.asarray(index),
            jnp.ones((models, terms), bool),
            jnp.asarray(theta),
        ),
    )


def global_model(
    factor: np.ndarray,
    theta: Float[Array, " terms"] | Float[np.ndarray, " terms"],
) -> OutputModel:
    """One local model that is valid everywhere, of given terms and coefficients."""
    theta = jnp.asarray(theta)[None]
    nowhere = jnp.zeros((1, 0), theta.dtype)
    nothing = np.zeros(0, theta.dtype)
    validity = Gaussians(nowhere, nowhere)
    return output_model(factor, theta, validity, Variables(()), nothing, nothing)


def assemble(
    pool: Pool,
    data: Dataset,
    gain: Float[np.ndarray, " signals"],
    models: list[OutputModel],
) -> Network:
    """Complete a network: gains, training ranges and feedback bounds."""
    low, high = ranges(data)
    signal = len(data.channels.inputs) + np.array(pool.outputs)
    wider = MARGIN * (high - low)[signal]
    return Network(
        data.channels,
        pool.outputs,
        pool.variables,
        tuple(models),
        jnp.asarray(gain),
        jnp.asarray((low[signal] - wider) / gain[signal]),
        jnp.asarray((high[signal] + wider) / gain[signal]),
        jnp.asarray(low),
        jnp.asarray(high),
        jnp.asarray(data.sample_time, gain.dtype),
    )
