"""The verb `mpc`: a predictive controller around a network."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require, require_known
from jaxnarx.control.controller import Controller
from jaxnarx.control.observer import (
    OFFSET_SHARE,
    STATE_NOISE,
    UNKNOWN_NOISE,
    UNKNOWN_POLE,
    UNKNOWN_STEPS,
    ErrorStatistics,
    split_error,
)
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.models import (
    Network,
    carried,
    require_computed,
    state_sizes,
    state_space,
)
from jaxnarx.regressors import LowPass
from jaxnarx.settings import Command, OutputLimit
from jaxnarx.simulation import match_records, simulate, tables
from jaxnarx.solution import RESULTS, Solution

EVERY = 3
"""Blocks grow to a third of the samples before them: the next moves are free, later
ones go together. Powers of two are too coarse for references that are known ahead, and
a block a sample follows the model's errors where the model is poor."""


@guard_arguments
def mpc(
    network: Network,
    commands: Mapping[str, Command],
    targets: Sequence[str] | Mapping[str, float | int],
    limits: Mapping[str, OutputLimit] | None = None,
    *,
    horizon: int = 20,
    blocks: Sequence[int] = (),
    rounds: int = 1,
    records: Dataset | None = None,
    observe_states: bool | None = None,
) -> Solution[Controller]:
    """A nonlinear predictive controller whose model is a network.

    At every sample it plans commands over a horizon by sequential quadratic programming
    with exact derivatives of the free run (Diehl, Bock, Schloeder 2005), under bounds
    and rates of commands and limits of outputs that give way where nothing else is
    left. An observer (Kalman 1960) adds a disturbance to every output, so that nothing
    is left of an error that stays (Muske and Badgwell 2002).

    Args:
        network: A network that computes all outputs it looks at; one of float32 is
            taken in float64.
        commands: The inputs that are set, with bounds, rates and efforts.
        targets: The outputs that follow a reference; with their weights, by default
            one. An error counts in quarters of the output's trained range.
        limits: Limits of outputs.
        horizon: Samples that are looked ahead.
        blocks: The samples of the horizon at which commands may move; by default the
            first seven, then every second and ever fewer.
        rounds: Steps of sequential quadratic programming in every sample.
        records: Records that took no part in the training: what the observer expects
            of errors is taken from the free run over them. Default: noise and steps of
            errors of a fiftieth of a quarter of every output's trained range.
        observe_states: Whether states are estimated too, not disturbances alone;
            default: where the network has hidden states or looks at outputs, so that
            its state does not follow from its inputs.

    Returns:
        `value` is the `Controller`. `detail` tells what is to be known before it is
        used: no certificate, hidden states, commands without an effect, or that
            may leave the range of the training.

    Raises:
        SpecError: channels that the network does not have; a target named twice; bounds
            that leave no room; JAX without double precision, in which quadratic
            programs of steep limits are not solved.

    Example:
        free = {"a": jnx.control.Command(rate=2.0)}
        controller = jnx.control.mpc(network, free, ["y"], horizon=8).value
        state = controller.begin([0.0, 0.0], [float("nan")])
        state, decision = controller.step(state, [0.1], [0.2], [0.0])
        print(decision.commands)
    """
    require_computed(network, "network")
    network = _in_double(network)
    names = state_space(network).inputs
    outputs = network.output_names
    weights = targets if isinstance(targets, Mapping) else dict.fromkeys(targets, 1.0)
    require(
        len(weights) == len(targets),
        "targets",
        f"a target is named twice: {', '.join(targets)}",
    )
    kept = {} if limits is None else limits
    if not commands:
        raise SpecError("a controller needs at least one command", field="commands")
    if not weights:
        raise SpecError("a controller needs at least one target", field="targets")
    for field, given, known in (
        ("commands", commands, names),
        ("targets", weights, outputs),
        ("limits", kept, outputs),
    ):
        for name in given:
            require_known(name, known, field)
    for name, weight in weights.items():
        if not 0 < weight < np.inf:
            raise SpecError(
                f"the weight of {name} must be positive and finite, got {weight:g}",
                field="targets",
            )
    places = _places_of_blocks(horizon, blocks)
    if rounds < 1:
        raise SpecError(f"rounds must be at least 1, got {rounds}", field="rounds")
    observe = _looks_back(network) if observe_states is None else observe_states
    columns = [names.index(n) for n in commands]
    trained = np.asarray(network.low), np.asarray(network.high)
    low, high = (
        np.array(_bound(commands, side, trained, network)) for side in ("low", "high")
    )
    for n, least, most in zip(commands, low, high, strict=True):
        if not least < most:
            raise SpecError(
                f"the bounds of {n} leave no room: {least:g} to {most:g}",
                field="commands",
            )
    size = _sizes(network)
    kind = network.gain.dtype
    limited = list(kept.values())
    known = _statistics(network, records, size)
    unsure = np.sqrt(np.asarray(known.steps + known.noise))
    guard = [unsure[outputs.index(n)] * one.guard for n, one in kept.items()]
    rates = [np.inf if c.rate is None else float(c.rate) for c in commands.values()]
    span = (trained[1] - trained[0])[[_signal(network, n) for n in commands]]
    controller = Controller(
        network=network,
        commands=tuple(columns),
        targets=tuple(outputs.index(n) for n in weights),
        bounded=tuple(outputs.index(n) for n in kept),
        blocks=places,
        horizon=horizon,
        first=0 if _answers_at_once(network, list(commands)) else 1,
        rounds=rounds,
        observe_states=observe,
        low=jnp.asarray(low, kind),
        high=jnp.asarray(high, kind),
        move=jnp.asarray(np.array(rates) * float(network.sample_time), kind),
        effort=jnp.asarray([float(c.effort) for c in commands.values()], kind),
        weight=jnp.asarray([float(w) for w in weights.values()], kind),
        floor=jnp.asarray(_edges(limited, "at_least", -np.inf), kind),
        ceiling=jnp.asarray(_edges(limited, "at_most", np.inf), kind),
        guard=jnp.asarray(guard, kind),
        size=jnp.asarray(size, kind),
        span=jnp.asarray(np.where(span > 0, span, high - low), kind),
        statistics=known,
        domain=None if network.domain is None else network.domain.nameless,
        fade=_fade(network),
    )
    return Solution(controller, RESULTS.ok, {}, _remarks(controller))


def _in_double(network: Network) -> Network:
    """The network with numbers in double precision."""
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise SpecError(
            "a controller needs double precision, call "
            "jax.config.update('jax_enable_x64', True) first",
            field="jax_enable_x64",
        )

    def double(leaf: Any) -> Any:
        return jnp.asarray(leaf, np.float64) if eqx.is_inexact_array(leaf) else leaf

    return jax.tree.map(double, network)


def _places_of_blocks(horizon: int, blocks: Sequence[int]) -> tuple[int, ...]:
    """The samples at which commands may move."""
    if horizon < 1:
        raise SpecError(
            f"horizon must be at least 1 sample, got {horizon}", field="horizon"
        )
    if not blocks:
        places = [0]
        while places[-1] + max(1, places[-1] // EVERY) < horizon:
            places.append(places[-1] + max(1, places[-1] // EVERY))
        return tuple(places)
    rising = all(a < b for a, b in zip(blocks, blocks[1:], strict=False))
    if blocks[0] != 0 or not rising or blocks[-1] >= horizon:
        raise SpecError(
            f"blocks must rise from 0 within the horizon of {horizon} samples, got "
            f"{tuple(blocks)}",
            field="blocks",
        )
    return tuple(blocks)


def _looks_back(network: Network) -> bool:
    """Whether a run depends on outputs or hidden states of before."""
    looked_at = {s for s, _ in tables(network)}
    own = looked_at & set(network.signals)
    return bool(network.hidden or network.parallel or own)


def _signal(network: Network, name: str) -> int:
    return network.channels.names.index(name)


def _answers_at_once(network: Network, commands: list[str]) -> bool:
    """Whether outputs answer to commands in the same sample."""
    own = {_signal(network, name) for name in commands}
    return any(s in own and lag == 0 for s, lag in tables(network))


def _bound(
    commands: Mapping[str, Command], side: str, trained: Any, network: Network
) -> list[float]:
    """Bounds of all commands, by default those of the training."""
    range_ = trained[0 if side == "low" else 1]
    found = []
    for name, command in commands.items():
        own = getattr(command, side)
        found.append(float(range_[_signal(network, name)]) if own is None else own)
    return found


def _edges(limits: list[OutputLimit], side: str, none: float) -> list[float]:
    own = [getattr(one, side) for one in limits]
    return [none if edge is None else float(edge) for edge in own]


def _sizes(network: Network) -> Float[np.ndarray, " outputs"]:
    """A quarter of every output's trained range."""
    own = np.array(network.signals)[: len(network.modelled)]
    wide = (np.asarray(network.high) - np.asarray(network.low))[own] / 4
    return np.where(wide > 0, wide, 1.0)


def _fade(network: Network) -> Float[Array, " used"] | None:
    """Share that the domain's filtered inputs keep from sample to sample."""
    if network.domain is None:
        return None
    kept = []
    own = network.domain
    for filter_ in own.features.filters[len(own.inputs) :]:
        if not isinstance(filter_, LowPass):
            raise SpecError("the network's domain is of another kind", field="network")
        kept.append(np.exp(-float(network.sample_time) / filter_.time_constant))
    return jnp.asarray(kept, network.gain.dtype)


def _statistics(
    network: Network, records: Dataset | None, size: Float[np.ndarray, " outputs"]
) -> ErrorStatistics:
    """Pole and variances of the free run's errors, for the observer."""
    kind = network.gain.dtype
    states = (STATE_NOISE * np.asarray(state_sizes(network))[carried(network)]) ** 2
    if records is None:
        pole = np.full(len(size), UNKNOWN_POLE)
        noise, steps = (UNKNOWN_NOISE * size) ** 2, (UNKNOWN_STEPS * size) ** 2
    else:
        data = match_records(network, records)
        run = simulate(network, data).raise_for_status().value
        found = []
        for o, column in enumerate(network.modelled):
            parts = zip(data, run.outputs, run.scored, strict=True)
            errors = [r.y[s[:, o], column] - y[s[:, o], o] for r, y, s in parts]
            found.append(split_error(errors, float(size[o])))
        pole, noise, steps = np.array(found).T
    offset = OFFSET_SHARE**2 * (noise + steps)
    every = (pole, noise, steps, offset, states)
    return ErrorStatistics(*(jnp.asarray(a, kind) for a in every))


def _remarks(controller: Controller) -> str:
    """Remarks before the controller is used."""
    network = controller.network
    told = []
    looked_at = {s for s, _ in tables(network)}
    low, high = np.asarray(network.low), np.asarray(network.high)
    for k, name in enumerate(controller.command_names):
        at = _signal(network, name)
        if at not in looked_at:
            told.append(f"nothing depends on {name}, which is to be set")
        elif controller.low[k] < low[at] or controller.high[k] > high[at]:
            told.append(
                f"{name} may leave the range of the training, {low[at]:.4g} to "
                f"{high[at]:.4g}: the network guesses there"
            )
    if _looks_back(network) and network.certificate is None:
        told.append(
            "nothing proves that the network's free run is stable (no certificate): "
            "look at the closed loop before it is used"
        )
    if network.hidden:
        told.append("hidden states are estimated by an extended Kalman filter")
    return "; ".join(told)
