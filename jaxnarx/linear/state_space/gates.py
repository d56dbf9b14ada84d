"""Sigmoid states: a linear state-space model with gates along learned directions.

What is computed, outputs and states, is linear in the last states and the inputs plus
constants behind gates that all of it shares:

    z(t) = A z(t-1) + B u(t) + b + E s(t),   y(t) = C z(t-1) + D u(t) + d + F s(t),
    s_k(t) = sigma(w_k . [z(t-1), u(t)] - c_k)

Directions are drawn sparse over standardised states and inputs, borders at random
samples, and constants are zero, so that the first run is the linear one. Training moves
gates and coefficients together. J. A. K. Suykens, B. De Moor and J. Vandewalle,
Nonlinear system identification using neural state space models, International Journal
of Control 62 (1995) 129-152.
"""

import dataclasses

import jax
import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.linear.state_space.regions import visited_points
from jaxnarx.models import (
    AdditiveGates,
    LocalModels,
    Network,
    OutputModel,
    scaled_points,
)

DIRECTION_VARIABLES = 4
"""Most states and inputs that a drawn direction looks at."""
LEAST_DEVIATION = 1e-9
"""Least standard deviation of what a direction looks at, in units of its range."""


def add_gates(network: Network, data: Dataset, count: int, draw: int) -> Network:
    """The network with so many gates, drawn over what its free run visits.

    `network` has one local model for everything, of degree one. The same data and the
    same number `draw` give the same gates.
    """
    rng = np.random.default_rng(draw)
    signal = [s for s, _ in network.variables]
    low, high = (np.asarray(a)[signal] for a in (network.low, network.high))
    span = np.where(high > low, high - low, 1.0)
    points, _ = visited_points(network, data)
    first = dataclasses.replace(
        network.models[0],
        scheduling=network.variables,
        offset=jax.device_put(low),
        span=jax.device_put(span),
    )
    z = scaled_points(first, points)
    deviation = z.std(axis=0)
    moving = np.flatnonzero(deviation > LEAST_DEVIATION)
    direction, border = np.zeros((count, len(signal))), np.zeros(count)
    for k in range(count):
        size = min(DIRECTION_VARIABLES, len(moving))
        chosen = rng.choice(moving, size=size, replace=False)
        direction[k, chosen] = rng.normal(size=size) / deviation[chosen]
        along = z @ direction[k]
        direction[k] /= along.std() or 1.0
        border[k] = rng.choice(z @ direction[k])
    models = tuple(
        _open_model(model, network, (low, span), direction, border)
        for model in network.models
    )
    return dataclasses.replace(network, models=models)


def _open_model(
    model: OutputModel,
    network: Network,
    scale: tuple[np.ndarray, np.ndarray],
    direction: np.ndarray,
    border: np.ndarray,
) -> OutputModel:
    """The model with a constant of zero behind every gate."""
    dense = np.asarray(model.local.dense())[:1]
    models, terms = 1 + len(border), dense.shape[1]
    constant = np.all(np.asarray(model.local.factor) == 0, axis=1)
    used = np.tile(constant, (models, 1))
    used[0] = True
    coefficient = np.zeros((models, terms))
    coefficient[0] = dense[0]
    index = np.tile(np.arange(terms), (models, 1))
    local = LocalModels(model.local.factor, *jax.device_put((index, used, coefficient)))
    offset, span, active, *gates = jax.device_put(
        (*scale, np.ones(models, bool), direction, border)
    )
    return OutputModel(
        network.variables, offset, span, AdditiveGates(*gates), active, local
    )
