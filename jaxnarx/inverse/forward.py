"""Commands, targets and dead times of a forward network, by name."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require_known
from jaxnarx.errors import SpecError
from jaxnarx.models import Network, OutputModel


def positions(
    forward: Network, commands: Sequence[str], targets: Sequence[str]
) -> tuple[list[int], list[int]]:
    """Signals of the commands, and places of the targets among the modelled outputs."""
    known = {
        "commands": (commands, forward.channels.input_names, "an input"),
        "targets": (targets, forward.output_names, "a modelled output"),
    }
    for field, (names, there, what) in known.items():
        if isinstance(names, str) or not names or len(set(names)) < len(names):
            raise SpecError(
                f"{field} must be a list of different names, got {names!r}", field=field
            )
        for name in names:
            require_known(
                name,
                there,
                field,
                f"{field} names {name!r}, which is not {what} of the forward model",
            )
    return (
        [forward.channels.signal(name) for name in commands],
        [forward.output_names.index(name) for name in targets],
    )


@guard_arguments
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
