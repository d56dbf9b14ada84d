"""The parts of a network that come from data and terms, whatever the partition."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.data import Dataset
from jaxnarx.models import (
    AbstractValidity,
    LocalModels,
    Network,
    OutputModel,
)
from jaxnarx.regressors import Pool, Variables, parse_variable
from jaxnarx.regressors.rows import Rows
from jaxnarx.selection import Selection

MARGIN = 0.25
"""Simulated outputs may leave the training range by this share of it on either side."""


def chosen_terms(source: Selection | Pool) -> tuple[Pool, list[np.ndarray]]:
    """The pool and, per modelled output, the index rows of the terms to use."""
    if isinstance(source, Pool):
        return source, [source.factor] * len(source.outputs)
    pool = source.pool
    return pool, [pool.factor[source.terms(o)] for o in range(len(pool.outputs))]


def scheduling_table(pool: Pool, names: tuple[str, ...]) -> Variables:
    """Scheduling variables from their texts."""
    return Variables(tuple(parse_variable(pool.channels, n) for n in names))


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


def assemble(
    pool: Pool, data: Dataset, rows: Rows, models: list[OutputModel]
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
        jnp.asarray(rows.gain),
        jnp.asarray((low[signal] - wider) / rows.gain[signal]),
        jnp.asarray((high[signal] + wider) / rows.gain[signal]),
        jnp.asarray(low),
        jnp.asarray(high),
        jnp.asarray(data.sample_time, rows.gain.dtype),
    )
