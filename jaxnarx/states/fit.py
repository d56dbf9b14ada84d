"""Models with hidden states, from a linear start to products, on the free run.

Every start (`jaxnarx.states.starts`) is trained as a linear model, given products of
states and inputs degree by degree, and trained a few steps with a strong pull towards
the linear model. The one with the smallest training error then goes on while the pull
falls. A hidden state that leaves the range it had in training is held in the end.

Polynomial nonlinear state-space models: J. Paduart et al., Identification of nonlinear
systems using Polynomial Nonlinear State Space models, Automatica 46 (2010) 647-656.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxnarx.checks import known_name
from jaxnarx.data import Dataset, shortened
from jaxnarx.errors import DataError, JaxnarxError
from jaxnarx.guard import guarded
from jaxnarx.methods import HiddenStates, SimulationError
from jaxnarx.models import Network
from jaxnarx.refinement import refine
from jaxnarx.solution import RESULTS, Solution
from jaxnarx.states.network import raised, settled, state_network
from jaxnarx.states.starts import linear_starts

Tell = Callable[[dict[str, Any]], None]
TOLERANCE = 5e-4
"""Relative decrease, twice in a row, at which a value of the pull has done its work."""


@guarded
def fit_states(
    data: Dataset,
    method: HiddenStates | None = None,
    *,
    hopeless: float = np.inf,
    progress: Tell | None = None,
) -> Solution[Network]:
    """A network with hidden states, `x1`, `x2` ..., trained on the free run.

    Args:
        data: Records to be trained on.
        method: Number of states, degree and pull; see `HiddenStates`.
        hopeless: Error in training (NRMSE) beyond which no start goes on after its
            first steps: a DataError then.
        progress: Called on the host after every accepted step.

    Returns:
        `value` is the network at the last value of `shrink`, `stats["path"]` that at
        every value, `stats["start"]` names the linear model it began from. Statuses are
        those of `refine` for the last value. `DataError` where no start can be made:
        records too short for so many states, say.

    Example:
        fit = jnx.states.fit_states(data, jnx.states.HiddenStates(states=1, degree=1))
        print(fit.value.channels.hidden)
    """
    method = HiddenStates() if method is None else method
    known = data.channels.output_names
    for name in method.outputs:
        known_name(name, known, "outputs", f"unknown output {name!r}")
    places = tuple(known.index(name) for name in (method.outputs or known))
    starts = _starts(data, places, method, progress)
    name, network, loss = min(starts, key=lambda start: start[2])
    if not loss <= hopeless**2:
        raise DataError(
            f"an error in training of {loss**0.5:.3g} after the first steps"
        )
    path: list[Network] = []
    fit = Solution(network, RESULTS.budget_spent, {})
    for shrink in method.shrink:
        fit = _trained(fit.value, data, method.max_steps, shrink, progress)
        path.append(settled(fit.value, data))
    stats = {"path": path, "start": name, "starts": {n: e for n, _, e in starts}}
    return Solution(path[-1], fit.status, fit.stats | stats, fit.detail)


def _starts(
    data: Dataset, places: tuple[int, ...], method: HiddenStates, progress: Tell | None
) -> list[tuple[str, Network, float]]:
    """Every start with its name, after its first steps, and with its training error."""
    few, found = shortened(data, method.first_rows), []
    steps, reason = method.first_steps, "no linear model can be identified"
    for name, model in linear_starts(data, places, method.states):
        if method.start not in ("", name):
            continue
        network = state_network(model, data, places, window=method.window)
        try:
            fit = _trained(network, few, steps, method.shrink[0], progress)
            for degree in range(2, method.degree + 1):
                network = raised(fit.value, degree)
                fit = _trained(network, few, steps, method.shrink[0], progress)
        except (JaxnarxError, np.linalg.LinAlgError) as error:
            reason = str(error)
            continue
        lost = fit.status == RESULTS.start_diverged
        found.append((name, fit.value, np.inf if lost else float(fit.stats["loss"])))
    if not found:
        raise DataError(f"no start of {method.states} hidden states: {reason}")
    return found


def _trained(
    network: Network,
    data: Dataset,
    steps: int,
    shrink: float,
    progress: Tell | None,
) -> Solution[Network]:
    method = SimulationError(
        max_steps=steps, ridge=0, shrink=shrink, tolerance=TOLERANCE, patience=steps + 1
    )
    return refine(network, data, method, progress=progress)
