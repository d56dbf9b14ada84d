"""Terms chosen anew in every region, with the validity as sample weight."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.partition.training_rows import TrainingRows
from jaxnarx.selection import choose_terms, unusable_signals, usable_terms
from jaxnarx.settings import ForwardOLS, StepwiseF


def own_terms(
    training: TrainingRows,
    output: int,
    phi: Float[Array, "models rows"],
    method: ForwardOLS | StepwiseF,
) -> Float[np.ndarray, "models terms"]:
    """Coefficients over all candidates, zero where a local model lacks the term.

    The local models are the lanes of one search; each is fitted to the whole output,
    as if it were alone, on samples that count as much as it is valid there.
    """
    pool, rows = training.pool, training.rows
    usable = usable_terms(pool, unusable_signals(training.data, pool))
    candidates = np.zeros(len(pool), bool)
    candidates[term_positions(training, output)] = True
    weight = phi * rows.weight[output][None]
    lanes = dataclasses.replace(
        rows, y=jnp.broadcast_to(rows.y[output][None], weight.shape), weight=weight
    )
    starts = [[] for _ in range(len(phi))]
    choice = choose_terms(pool, lanes, method, usable & candidates, starts)
    return _dense(choice.path, len(pool))[:, term_positions(training, output)]


def term_positions(training: TrainingRows, output: int) -> list[int]:
    """The places of an output's candidate terms in the pool."""
    place = {tuple(row): n for n, row in enumerate(training.pool.factor.tolist())}
    return [place[tuple(row)] for row in training.factors[output].tolist()]


def _dense(path, terms: int) -> Float[np.ndarray, "models terms"]:
    count, index = np.asarray(path.count), np.asarray(path.index)
    nested = np.asarray(path.nested)
    theta = np.zeros((len(count), terms), nested.dtype)
    for m, n in enumerate(count.tolist()):
        theta[m, index[m, :n]] = nested[m, max(n - 1, 0), :n]
    return theta
