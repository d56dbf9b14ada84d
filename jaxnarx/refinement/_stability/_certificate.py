"""A certificate: one norm in which a network contracts for every input there is.

Where the weights of the local models are known to be non-negative and to sum to one
(`is_convex` of their class), they depend on inputs alone and every term holds at
most one past output, two runs with the same inputs differ by d_t = A_t d_(t-1), and A_t
is a mean, by the weights, of the companion matrices A_i of the local models. If

    ||L A_i L^-1|| <= rho < 1   for all of them, that is A_i' P A_i <= rho^2 P, P = L'L,

the same holds for every mean, whatever the inputs: S. Boyd, L. El Ghaoui, E. Feron, V.
Balakrishnan, Linear Matrix Inequalities in System and Control Theory, SIAM 1994,
section 5.1. A past output that is multiplied by inputs makes A_i an interval, which
inputs held at the edge of their ranges (`jaxnarx.models.limits`) cannot leave; its
corners decide. It is said of runs that stay inside their feedback bounds, and of the
network it was found for: `rate_of` tells what it proves of one that was changed since.
"""

import dataclasses
import itertools

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.models import Network, OutputModel, depth, fed_back_variables
from jaxnarx.refinement._stability.norm import contracting_norm, norms
from jaxnarx.refinement._stability.points import companion, linked_groups
from jaxnarx.regressors import LowPass

MOST_MATRICES = 4096
"""Largest number of matrices; with more no certificate is attempted."""
SLOWEST_RATE = 0.9999
"""The slowest rate that counts: a run forgets in some ten thousand samples."""


@dataclasses.dataclass(frozen=True, eq=False)
class Certificate:
    """L of the whole state, scaled outputs of the newest lag first, and its rate.

    Two runs with the same inputs, whatever they are, approach each other at least by
    `rate` a sample in the norm |L d|; `overshoot` is how many times their distance may
    grow before.
    """

    factor: Float[np.ndarray, "states states"]
    rate: float
    overshoot: float


def certificate(network: Network) -> Certificate | None:
    """The certificate of a network; None where there is none, or none is found."""
    blocks = _blocks(network)
    if blocks is None:
        return None
    size = len(network.models) * depth(network)
    whole, rate, overshoot = np.eye(size), 0.0, 1.0
    for at, matrices in blocks:
        factor = contracting_norm(matrices)
        own = _largest(factor, matrices)
        if not own <= SLOWEST_RATE:
            return None
        whole[np.ix_(at, at)] = factor
        rate, overshoot = max(rate, own), max(overshoot, float(np.linalg.cond(factor)))
    return Certificate(whole, rate, overshoot)


def attach_certificate(network: Network) -> Network:
    """The network with its certificate, where one is found."""
    found = certificate(network)
    if found is None:
        return dataclasses.replace(network, certificate=None)
    factor = jax.device_put(found.factor.astype(network.gain.dtype))
    return dataclasses.replace(network, certificate=factor)


def rate_of(network: Network) -> float:
    """The rate that a network's own certificate proves; infinite if it proves none."""
    blocks = _blocks(network)
    if network.certificate is None or blocks is None:
        return float("inf")
    whole = np.asarray(network.certificate, float)
    rates = [_largest(whole[np.ix_(at, at)], matrices) for at, matrices in blocks]
    return max(rates, default=0.0)


def _largest(factor: np.ndarray, matrices: np.ndarray) -> float:
    """The rate of a norm, a little more than computed: roundings decide no claim."""
    return float(norms(factor, matrices).max()) * (1 + 1e-9)


Block = tuple[list[int], Float[np.ndarray, "corners n n"]]


def _blocks(network: Network) -> list[Block] | None:
    """Outputs that act on one another: their places in the state, and all matrices."""
    rows = _slopes(network)
    if rows is None:
        return None
    outputs, lags = len(network.models), depth(network)
    linked = np.stack([np.abs(corners).max(axis=(0, 2)) > 0 for corners in rows])
    found = []
    for group in linked_groups(linked | linked.T):
        if not linked[np.ix_(group, group)].any():
            continue
        matrices = _matrices([rows[o][:, list(group)] for o in group])
        if matrices is None:
            return None
        at = [lag * outputs + o for lag in range(lags) for o in group]
        found.append((at, matrices))
    return found


def _matrices(
    rows: list[Float[np.ndarray, "_ outputs depth"]],
) -> Float[np.ndarray, "corners n n"] | None:
    """Companion matrices of all combinations of the outputs' corners."""
    if np.prod([float(len(corners)) for corners in rows]) > MOST_MATRICES:
        return None
    every = [np.stack(one) for one in itertools.product(*rows)]
    return companion(np.stack(every))


def _slopes(
    network: Network,
) -> list[Float[np.ndarray, "_ outputs depth"]] | None:
    """Slopes of every output by the past outputs, at all corners of what they can be;
    None where they depend on the past outputs themselves."""
    if network.parallel or not all(map(_has_convex_weights, network.models)):
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
    return found


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
