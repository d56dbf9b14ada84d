"""How what is computed depends on past outputs, at all ends of what it can be.

Local models that are averaged have a slope each, and their mean lies between these.
Sigmoid gates with constants e_k behind them have slopes s_k from zero to a quarter,
whatever is run, so that

    A_t = A + sum_k s_k e_k w_k' ,   0 <= s_k <= 1/4 ,

is a mean of the 2^gates matrices in which every slope is at one of its ends.
"""

import dataclasses
import itertools

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.models import (
    AdditiveGates,
    Network,
    OutputModel,
    depth,
    fed_back_variables,
    tied_outputs,
)
from jaxnarx.regressors import LowPass

MOST_MATRICES = 4096
"""Largest number of matrices; with more none are made."""
STEEPEST_SIGMOID = 0.25
"""Largest slope of a sigmoid by its argument."""

Corners = Float[np.ndarray, "corners outputs outputs depth"]


def slopes_of(network: Network) -> "GatedSlopes | MeanSlopes | None":
    """The slopes of a network; None where nothing bounds them but the outputs, or where
    what is fed back saturates: a norm need not shrink there."""
    if np.asarray(network.saturates).any() or network.parallel:
        return None
    gated = all(isinstance(m.validity, AdditiveGates) for m in network.models)
    return GatedSlopes.of(network) if gated else MeanSlopes.of(network)


@dataclasses.dataclass(frozen=True, eq=False)
class GatedSlopes:
    """Slopes by the past outputs: those beside all gates, and what the steepest slope
    of every gate adds; `owners` are outputs whose gates each output shares."""

    beside: Float[np.ndarray, "outputs outputs depth"]
    added: list[Float[np.ndarray, "gates outputs depth"]]
    owners: tuple[int, ...]

    @classmethod
    def of(cls, network: Network) -> "GatedSlopes | None":
        """None where what a gate opens, or what multiplies a past output, moves, or
        where weights are not those of gates."""
        own = fed_back_variables(network.variables, network.signals)
        place = {row + 1: (o, lag) for row, o, lag in own}
        parts = [_beside_gates(network, model, place) for model in network.models]
        known = [part for part in parts if part is not None]
        if len(known) < len(parts):
            return None
        added = [
            _steepest(network, model, constants)
            for model, (_, constants) in zip(network.models, known, strict=True)
        ]
        beside = np.stack([slopes for slopes, _ in known])
        return cls(beside, added, _shared_slopes(network))

    @property
    def linked(self) -> Bool[np.ndarray, "outputs outputs"]:
        """Which output looks at which."""
        size = np.abs(self.beside) + [np.abs(a).sum(axis=0) for a in self.added]
        return size.max(axis=2) > 0

    def combine(self, group: tuple[int, ...]) -> Corners | None:
        """All combinations of the ends of all slopes; None where they are too many."""
        first = {self.owners[o]: o for o in group}
        counts = {owner: len(self.added[o]) for owner, o in first.items()}
        if sum(counts.values()) > np.log2(MOST_MATRICES):
            return None
        ends = itertools.product((0.0, 1.0), repeat=sum(counts.values()))
        opened = np.array(list(ends))
        begins = dict(zip(counts, np.cumsum([0, *counts.values()]), strict=False))
        rows = []
        for o in group:
            begin = begins[self.owners[o]]
            own = opened[:, begin : begin + len(self.added[o])]
            change = np.tensordot(own, self.added[o], axes=1)
            rows.append((self.beside[o][None] + change)[:, list(group)])
        return np.stack(rows, axis=1)


@dataclasses.dataclass(frozen=True, eq=False)
class MeanSlopes:
    """Slopes of every output by the past outputs, at all corners of what they can be:
    those of its local models, whose mean is in use."""

    rows: list[Float[np.ndarray, "_ outputs depth"]]

    @classmethod
    def of(cls, network: Network) -> "MeanSlopes | None":
        """None where they depend on the past outputs themselves."""
        if not all(map(_has_convex_weights, network.models)):
            return None
        own = fed_back_variables(network.variables, network.signals)
        if any(
            fed_back_variables(model.scheduling, network.signals)
            for model in network.models
        ):
            return None
        place = {row + 1: (o, lag) for row, o, lag in own}
        found = []
        for model in network.models:
            corners = _corners(network, model, place)
            if corners is None:
                return None
            found.append(corners)
        return cls(found)

    @property
    def linked(self) -> Bool[np.ndarray, "outputs outputs"]:
        """Which output looks at which."""
        return np.stack([np.abs(rows).max(axis=(0, 2)) > 0 for rows in self.rows])

    def combine(self, group: tuple[int, ...]) -> Corners | None:
        """All combinations of the outputs' corners; None where they are too many."""
        rows = [self.rows[o][:, list(group)] for o in group]
        if np.prod([float(len(corners)) for corners in rows]) > MOST_MATRICES:
            return None
        return np.stack([np.stack(one) for one in itertools.product(*rows)])


def _beside_gates(
    network: Network, model: OutputModel, place: dict[int, tuple[int, int]]
) -> tuple[Float[np.ndarray, "outputs depth"], Float[np.ndarray, " gates"]] | None:
    """Slopes of the first local model, and the constants behind all gates; None where
    there is more behind them, or a product of a past output."""
    if not isinstance(model.validity, AdditiveGates):
        return None
    active = np.asarray(model.active)[:, None]
    dense = np.where(active, np.asarray(model.local.dense()), 0.0)
    slopes = np.zeros((len(network.models), depth(network)))
    constants = np.zeros(len(dense) - 1)
    for k, row in enumerate(np.asarray(model.local.factor).tolist()):
        factors = [v for v in row if v]
        if not factors:
            constants += dense[1:, k]
        elif dense[1:, k].any():
            return None
        elif dense[0, k] and any(v in place for v in factors):
            if len(factors) > 1:
                return None
            slopes[place[factors[0]]] += dense[0, k]
    return slopes, constants


def _steepest(
    network: Network, model: OutputModel, constants: Float[np.ndarray, " gates"]
) -> Float[np.ndarray, "gates outputs depth"]:
    """The part of the slopes that every gate adds where it is steepest."""
    assert isinstance(model.validity, AdditiveGates)
    found = np.zeros((len(constants), len(network.models), depth(network)))
    direction = np.asarray(model.validity.direction, float)
    gain, span = np.asarray(network.gain), np.asarray(model.span)
    for row, o, lag in fed_back_variables(model.scheduling, network.signals):
        found[:, o, lag] += direction[:, row] * gain[network.signals[o]] / span[row]
    return STEEPEST_SIGMOID * constants[:, None, None] * found


def _shared_slopes(network: Network) -> tuple[int, ...]:
    """For every output the first one whose gates have the same slopes, else itself."""
    owners = list(tied_outputs([model.validity for model in network.models]))
    for o, model in enumerate(network.models):
        first = network.models[owners[o]]
        same = model.scheduling == first.scheduling
        pairs = (model.offset, first.offset), (model.span, first.span)
        if not same or not all(np.array_equal(one, two) for one, two in pairs):
            owners[o] = o
    return tuple(owners)


def _has_convex_weights(model: OutputModel) -> bool:
    """Whether the local models are averaged: weights from zero on that sum to one."""
    try:
        model.validity.check(len(model.active), len(model.scheduling))
    except ValueError:
        return False
    return model.validity.is_convex


def _corners(
    network: Network, model: OutputModel, place: dict[int, tuple[int, int]]
) -> Float[np.ndarray, "corners outputs depth"] | None:
    """The corners of one output: local models, and ends of what multiplies a past
    output."""
    shape = len(network.models), depth(network)
    dense = np.asarray(model.local.dense(), float)[np.asarray(model.active)]
    fixed = np.zeros((len(dense), *shape))
    moving: dict[tuple[int, ...], np.ndarray] = {}
    for k, row in enumerate(np.asarray(model.local.factor).tolist()):
        fed = [v for v in row if v in place]
        if not fed or not dense[:, k].any():
            continue
        if len(fed) > 1:
            return None
        others = tuple(sorted(v for v in row if v and v not in place))
        part = np.zeros_like(fixed)
        part[:, *place[fed[0]]] = dense[:, k]
        if others:
            moving[others] = moving.get(others, 0.0) + part
        else:
            fixed += part
    if 2.0 ** len(moving) * len(fixed) > MOST_MATRICES:
        return None
    known = [_range(network, others) for others in moving]
    ends = [end for end in known if end is not None]
    if len(ends) < len(known):
        return None
    every = [
        fixed + sum(e * part for e, part in zip(chosen, moving.values(), strict=True))
        for chosen in itertools.product(*ends)
    ]
    return np.unique(np.concatenate(every), axis=0)


def _range(network: Network, variables: tuple[int, ...]) -> tuple[float, float] | None:
    """Ends of a product of scaled inputs held in their ranges; None where they are not
    held, or leave their ranges by a filter."""
    if network.plain:
        return None
    low, high = 1.0, 1.0
    for variable in variables:
        signal, _, filter_ = network.variables.entries[variable - 1]
        known = signal < len(network.channels.inputs)
        if not known or not (filter_ is None or isinstance(filter_, LowPass)):
            return None
        gain = float(np.asarray(network.gain)[signal])
        pair = (
            float(np.asarray(e)[signal]) / gain for e in (network.low, network.high)
        )
        ends = [a * b for a, b in itertools.product((low, high), pair)]
        low, high = min(ends), max(ends)
    return low, high
