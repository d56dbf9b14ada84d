"""Models with hidden states, from a linear start to products, on the free run.

Every start (`starts.linear_starts`) is trained as a linear model. It gets products of
states and inputs degree by degree and is trained on, regularised towards its present
coefficients; the regularisation is strong at first and falls. At each strength the
start with the smallest free-run error on the training records is kept, its states
initialised as in use; with many samples only the best one after the first steps is
trained on. A hidden state that leaves its training range is held in the end. Regions
are added one by one, to the best starts only, each at the strongest regularisation
(`regions`).

Polynomial nonlinear state-space models: J. Paduart et al., Identification of nonlinear
systems using Polynomial Nonlinear State Space models, Automatica 46 (2010) 647-656.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require, require_known
from jaxnarx.data import Dataset, thin_records
from jaxnarx.errors import DataError, JaxnarxError
from jaxnarx.linear.state_space.gates import add_gates
from jaxnarx.linear.state_space.lag_bank import bank_model
from jaxnarx.linear.state_space.model import StateSpace
from jaxnarx.linear.state_space.network import (
    increase_degree,
    set_state_ranges,
    state_network,
)
from jaxnarx.linear.state_space.regions import (
    drop_inactive,
    pad_models,
    split_candidates,
)
from jaxnarx.linear.state_space.starts import linear_starts
from jaxnarx.models import Network, set_ranges
from jaxnarx.refinement import refine
from jaxnarx.settings import HiddenStates, SimulationError
from jaxnarx.simulation import match_records, simulate
from jaxnarx.solution import Solution

Tell = Callable[[dict[str, Any]], None]
PULL_TOLERANCE = 5e-4
"""Relative decrease, twice in a row, at which a value of the pull has done its work."""
PROBE_STEPS = 15
"""Steps with gates after which a training that takes more of them goes on only where it
is not hopeless."""
DIVIDED_STARTS = 2
"""How many of the starts are divided into regions."""
DIVISION_STEPS = 6
"""Steps that a division is given before the best of them is taken."""
BANK_NAME = "bank of lags"
"""Name of that start."""
FIRST_PULL_FACTOR = 10.0
"""Regularisation of first steps with gates on few samples, over that of the first
stage."""


@guard_arguments
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
            first steps, or with two regions: a DataError then.
        progress: A function called on the host after every accepted step.

    Returns:
        `value` is the network of the last of `method.stages`, `stats["path"]` that of
        every one (each with places for `method.regions` local models, so that the same
        programs train and run it), `stats["start"]` names the linear model it began
        from. Statuses are those of `refine` for the last one. `DataError` where no
        start can be made: records too short for so many states, say.

    Example:
        fit = jnx.linear.fit_states(data, jnx.linear.HiddenStates(states=1, degree=1))
        print(fit.value.channels.hidden)
    """
    method = HiddenStates() if method is None else method
    known = data.channels.output_names
    for name in method.outputs:
        require_known(name, known, "outputs", f"unknown output {name!r}")
    places = tuple(known.index(name) for name in (method.outputs or known))
    few = thin_records(data, method.first_rows, method.stretch)
    starts = _starts(few, data, places, method, progress)
    if few is not data:
        starts = [min(starts, key=_training_error)]
    path: list[Network] = []
    ends: list[_Start] = []
    errors = {start.name: start.error for start in starts}
    if method.gates:
        first = method.shrink[0] * (1.0 if few is data else FIRST_PULL_FACTOR)
        best = min(starts, key=_training_error)
        starts = [_gated(best, few, method, first, hopeless, progress)]
    if method.regions > 1:
        starts = sorted(starts, key=_training_error)[:DIVIDED_STARTS]
        starts = [_roomy(start, method.regions) for start in starts]
    for regions, shrink in method.stages:
        if shrink == method.shrink[0]:
            if regions > 1:
                starts = [_divide(s, few, method, progress) for s in starts]
            ends = starts
        if not path and regions == 1:
            _require_hope(ends, hopeless)
        ends = [_train_on(s, data, method, shrink, progress) for s in ends]
        if len(path) + 1 == len(method.shrink) and regions == 2:
            _require_hope(ends, hopeless)  # first steps of a division tell little
        path.append(min(ends, key=_training_error).ranged)
        if shrink == method.shrink[0]:
            starts = ends
    best = min(ends, key=_training_error)
    stats = {"path": path, "start": best.name, "starts": errors}
    network = drop_inactive(path[-1])
    return Solution(network, best.fit.status, best.fit.stats | stats, best.fit.detail)


@guard_arguments
def refit_states(
    network: Network, data: Dataset, method: HiddenStates, shrink: float
) -> Network:
    """A network with hidden states trained once more, on these data alone.

    It starts from its parameters: its structure, and which of several minima it is in,
    stay. Its hidden channels are held to the ranges they had, and to those that they
    have now. Errors are those of `jaxnarx.refinement.refine`.
    """
    start = set_ranges(network, data)
    fit = _train(start, data, method, method.max_steps, shrink, None)
    found = set_state_ranges(fit.value, data)
    least, most = (
        {key: f(getattr(found, key), getattr(network, key)) for key in keys}
        for f, keys in (
            (jnp.minimum, ("low", "lower")),
            (jnp.maximum, ("high", "upper")),
        )
    )
    return dataclasses.replace(found, **least, **most)


@dataclasses.dataclass(frozen=True, eq=False)
class _Start:
    """A start on its way: where its training stands, the best network so far, with the
    ranges of its states, and the mean squared error (NRMSE) of its free run in
    training."""

    name: str
    fit: Solution[Network]
    ranged: Network
    error: float


def _training_error(start: _Start) -> tuple[float, float]:
    """The smaller is the better one."""
    return start.error, float(start.fit.stats["loss"])


def _train_on(
    start: _Start,
    data: Dataset,
    method: HiddenStates,
    shrink: float,
    progress: Tell | None,
) -> _Start:
    """Model trained on all data with this regularisation. A network with a larger error
    than before, begun as in use, is none to be used, though the training goes on from
    it."""
    try:
        fit = _train(start.fit.value, data, method, method.max_steps, shrink, progress)
    except (JaxnarxError, np.linalg.LinAlgError):
        return start
    network = set_state_ranges(fit.value, data)
    error = _error(network, data)
    if error > start.error:
        network, error = start.ranged, start.error
    return _Start(start.name, fit, network, error)


def _require_hope(starts: list[_Start], hopeless: float) -> None:
    least = min(start.error for start in starts)
    if not least <= hopeless**2:
        raise DataError(
            f"an error in training of {least**0.5:.3g} after the first stage"
        )


def _roomy(start: _Start, regions: int) -> _Start:
    """Make room for so many regions of what the start has visited."""
    low, high = start.ranged.low, start.ranged.high
    network = dataclasses.replace(start.fit.value, low=low, high=high)
    network = pad_models(network, regions)
    return dataclasses.replace(start, fit=dataclasses.replace(start.fit, value=network))


def _gated(
    start: _Start,
    data: Dataset,
    method: HiddenStates,
    shrink: float,
    hopeless: float,
    progress: Tell | None,
) -> _Start:
    """Add gates, drawn over what the start visits, and take the first steps; DataError
    where many are to be taken, and the first of these end far from what is hoped."""
    network = dataclasses.replace(
        start.fit.value, low=start.ranged.low, high=start.ranged.high
    )
    network, steps = add_gates(network, data, method.gates, method.draw), 0
    if method.first_steps > PROBE_STEPS:
        steps = PROBE_STEPS
        network = _train(network, data, method, steps, shrink, progress).value
        error = _error(set_state_ranges(network, data), data)
        if not error <= hopeless**2:
            raise DataError(
                f"an error in training of {error**0.5:.3g} after {steps} steps"
            )
    fit = _train(network, data, method, method.first_steps - steps, shrink, progress)
    ranged = set_state_ranges(fit.value, data)
    return _Start(start.name, fit, ranged, _error(ranged, data))


def _divide(
    start: _Start, data: Dataset, method: HiddenStates, progress: Tell | None
) -> _Start:
    """Add one region, divided where the first steps lead to the smallest error; none
    where no division can be trained."""
    found = []
    for network in split_candidates(start.fit.value, data):
        try:
            fit = _train(
                network, data, method, DIVISION_STEPS, method.shrink[0], progress
            )
        except (JaxnarxError, np.linalg.LinAlgError):
            continue
        network = set_state_ranges(fit.value, data)
        found.append(_Start(start.name, fit, network, _error(network, data)))
    return min(found, key=_training_error) if found else start


def _starts(
    few: Dataset,
    data: Dataset,
    places: tuple[int, ...],
    method: HiddenStates,
    progress: Tell | None,
) -> list[_Start]:
    """Every start after its first steps, on few samples."""
    found, steps, shrink = [], method.first_steps, method.shrink[0]
    reason = "no linear model can be identified"
    for name, network in _linear_networks(data, places, method):
        try:
            fit = _train(network, few, method, steps, shrink, progress)
            for degree in range(2, method.degree + 1):
                network = increase_degree(fit.value, degree)
                fit = _train(network, few, method, steps, shrink, progress)
            network = set_state_ranges(fit.value, few)
            found.append(_Start(name, fit, network, _error(network, few)))
        except (JaxnarxError, np.linalg.LinAlgError) as failure:
            reason = str(failure)
    if not found:
        raise DataError(f"no start of {method.states} hidden states: {reason}")
    return found


def _linear_networks(
    data: Dataset, places: tuple[int, ...], method: HiddenStates
) -> Iterator[tuple[str, Network]]:
    """The linear models to start from, as networks, with their names."""

    def as_network(model: StateSpace, delayed: Any = None) -> Network:
        how = {"window": method.window, "saturation": method.saturation}
        return state_network(model, data, places, delayed=delayed, **how)

    if method.times:
        require(len(places) == 1, "times", "a bank of lags is for one output alone")
        model, delayed = bank_model(data, places[0], method.times)
        yield BANK_NAME, as_network(model, delayed)
        return
    for name, model in linear_starts(data, places, method.states):
        if method.start in ("", name):
            yield name, as_network(model)


def _error(network: Network, data: Dataset) -> float:
    """The error of the free run, begun as in use; infinite where it diverges."""
    run = simulate(network, data).value
    if any(bad.any() for bad in run.diverged):
        return np.inf
    own, records = list(network.modelled), match_records(network, data)
    y = np.concatenate([r.y[:, own] for r in records])
    made, scored = np.concatenate(run.outputs), np.concatenate(run.scored)
    if not scored.any(axis=0).all():
        return np.inf
    error, spread = np.where(scored, made - y, 0.0), y.std(axis=0, where=scored)
    return float(np.mean((error**2).sum(axis=0) / scored.sum(axis=0) / spread**2))


def _train(
    network: Network,
    data: Dataset,
    method: HiddenStates,
    steps: int,
    shrink: float,
    progress: Tell | None,
) -> Solution[Network]:
    gated = len(network.models[0].active) > 1
    rules = SimulationError(
        max_steps=steps,
        train="joint" if gated else "staged",
        ridge=method.ridge if gated else 0,
        shrink=shrink,
        tolerance=PULL_TOLERANCE,
        patience=steps + 1,
    )
    return refine(network, data, rules, progress=progress)
