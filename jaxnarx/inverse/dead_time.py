"""Dead times of a network, read from the lags it uses."""

import numpy as np
from jaxtyping import Float

from jaxnarx.models import Network, OutputModel


def dead_times(network: Network) -> Float[np.ndarray, "outputs signals"]:
    """Samples after which each modelled output first feels each signal.

    The shortest way through the lags of the terms in use and of the scheduling
    variables, also through other outputs: a throttle that moves the manifold pressure
    after one sample moves the torque one sample after that. `inf` where no way leads.
    """
    first = np.stack([_direct(network, model) for model in network.models])
    own = np.array(network.signals)
    for _ in network.models:
        through = first[:, own][:, :, None] + first[None]
        first = np.minimum(first, through.min(axis=1))
    return first


def _direct(network: Network, model: OutputModel) -> Float[np.ndarray, " signals"]:
    """Smallest lag of every signal in one output's own terms and scheduling."""
    local = model.local
    used = np.asarray(local.used) & np.asarray(model.active)[:, None]
    used &= np.asarray(local.coefficient) != 0
    factors = np.asarray(local.factor)[np.asarray(local.index)[used]]
    rows = [network.variables.rows[f - 1] for f in np.unique(factors) if f]
    if np.sum(np.asarray(model.active)) > 1:
        rows += model.scheduling.rows
    least = np.full(len(network.channels.all), np.inf)
    for signal, lag in rows:
        least[signal] = min(least[signal], lag)
    return least
