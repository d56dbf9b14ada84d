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
corners decide. Sigmoid gates may look at past outputs: their slopes have ends, too
(`slopes`).

A weaker claim is that runs stay bounded while their inputs do: gates add what is
bounded to a linear model, so that it is enough that this one is stable.

It is said of runs that stay inside their feedback bounds, and of the network it was
found for: `rate_of` tells what it proves of one that was changed since.
"""

import dataclasses

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.models import Network, depth, fed_back_variables
from jaxnarx.refinement._stability.norm import contracting_norm, norms
from jaxnarx.refinement._stability.points import companion, linked_groups, moduli
from jaxnarx.refinement._stability.slopes import GatedSlopes, slopes_of

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
        if not moduli(matrices).max() <= SLOWEST_RATE:
            return None
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


def stays_bounded(network: Network) -> bool:
    """Whether every run is proven to stay bounded while its inputs are, however large.

    True of averaged local models without feedback, that share it or contract in one
    norm, where hidden channels saturate, and with sigmoid gates beside a stable linear
    model: x(t+1) = A x(t) + v(t), where v is bounded. Slower than `SLOWEST_RATE` counts
    as not stable.
    """
    if _saturates_whole(network):
        return True
    slopes = slopes_of(network)
    if isinstance(slopes, GatedSlopes):
        every = companion(slopes.beside[None])
        return bool(moduli(every).max() <= SLOWEST_RATE)
    blocks = _blocks(network)
    if blocks is None:
        return False
    alone = [matrices for _, matrices in blocks if len(matrices) == 1]
    if any(moduli(matrices).max() > SLOWEST_RATE for matrices in alone):
        return False
    return len(alone) == len(blocks) or certificate(network) is not None


def _saturates_whole(network: Network) -> bool:
    """Whether all that is fed back saturates."""
    tables = (network.variables, *(m.scheduling for m in network.models))
    fed = {o for t in tables for _, o, _ in fed_back_variables(t, network.signals)}
    return bool(fed) and bool(np.asarray(network.saturates)[sorted(fed)].all())


Block = tuple[list[int], Float[np.ndarray, "corners n n"]]


def _blocks(network: Network) -> list[Block] | None:
    """Outputs that act on one another: their places in the state, and all matrices."""
    slopes = slopes_of(network)
    if slopes is None:
        return None
    outputs, lags = len(network.models), depth(network)
    found = []
    for group in linked_groups(slopes.linked | slopes.linked.T):
        if not slopes.linked[np.ix_(group, group)].any():
            continue
        combined = slopes.combine(group)
        if combined is None:
            return None
        at = [lag * outputs + o for lag in range(lags) for o in group]
        found.append((at, companion(combined)))
    return found
