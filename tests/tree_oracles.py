"""Slow, obvious NumPy versions of sigmoid trees; what their tests call right.

Written from the equations, one leaf at a time; nothing here imports jaxnarx. A gate is
(unit direction d, border b, steepness a) and opens with sigma(a (d . z - b)); a leaf is
the list of its gates with the side, +1 or -1, that it lies on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from oracles import weighted_least_squares


class Gate(NamedTuple):
    """Opens where d . z > b."""

    direction: Float[np.ndarray, " dims"]
    border: float
    steepness: float

    def side(self, z: Float[np.ndarray, "time dims"], sign: int):
        """sigma of one side, without overflow: sigma(a) = (1 + tanh(a/2))/2."""
        a = self.steepness * (z @ self.direction - self.border)
        return (1 + np.tanh(sign * a / 2)) / 2


Leaf = list[tuple[Gate, int]]


def leaf_validity(
    z: Float[np.ndarray, "time dims"], leaf: Sequence[tuple[Gate, int]]
) -> Float[np.ndarray, " time"]:
    """Product of the gates on the leaf's path."""
    phi = np.ones(len(z))
    for gate, sign in leaf:
        phi = phi * gate.side(z, sign)
    return phi


@dataclass
class Moments:
    """Centre of gravity and covariance of the data of a leaf."""

    centre: Float[np.ndarray, " dims"]
    covariance: Float[np.ndarray, "dims dims"]


def moments(z, phi) -> Moments:
    """Weighted with the validity."""
    centre = np.average(z, axis=0, weights=phi)
    return Moments(centre, np.cov(z.T, aweights=phi, ddof=0).reshape(z.shape[1], -1))


def make_gate(direction, border: float, at: Moments, smoothness: float) -> Gate:
    """A gate across `direction`, `border` beyond the centre of gravity.

    Its steepness is 16 over the smoothness and the distance of its sides' centres,
    sqrt(3) standard deviations along the direction (half of an even spread's range).
    """
    d = np.asarray(direction) / np.linalg.norm(direction)
    distance = np.sqrt(3 * d @ at.covariance @ d)
    return Gate(d, float(d @ at.centre + border), float(16 / (smoothness * distance)))


class Tree:
    """Leaves and their coefficients."""

    def __init__(self, x, z, y):
        self.x, self.z, self.y = x, z, y
        self.leaves: list[Leaf] = [[]]
        self.theta = [weighted_least_squares(x, y, np.ones(len(y)))]

    def output(self) -> Float[np.ndarray, " time"]:
        """Blend of all leaves."""
        parts = [
            leaf_validity(self.z, leaf) * (self.x @ theta)
            for leaf, theta in zip(self.leaves, self.theta, strict=True)
        ]
        return np.sum(parts, axis=0)

    def sse(self) -> float:
        """Squared error on the training rows."""
        return float(np.sum((self.y - self.output()) ** 2))

    def losses(self) -> list[float]:
        """What decides on the worst leaf: sum of validity times squared error."""
        square = (self.y - self.output()) ** 2
        return [float(leaf_validity(self.z, leaf) @ square) for leaf in self.leaves]

    def divided(self, worst: int, gate: Gate) -> "Tree":
        """With the leaf replaced by its two children, both fitted anew."""
        new = Tree.__new__(Tree)
        new.x, new.z, new.y = self.x, self.z, self.y
        new.leaves, new.theta = list(self.leaves), list(self.theta)
        children = [[*self.leaves[worst], (gate, sign)] for sign in (1, -1)]
        theta = [
            weighted_least_squares(self.x, self.y, leaf_validity(self.z, child))
            for child in children
        ]
        new.leaves[worst], new.theta[worst] = children[0], theta[0]
        new.leaves.append(children[1])
        new.theta.append(theta[1])
        return new

    def masses(self) -> list[float]:
        """Sum of every leaf's validity."""
        return [float(leaf_validity(self.z, leaf).sum()) for leaf in self.leaves]


@dataclass(frozen=True)
class Grown:
    """Trees of all stages, and how clear each choice was (relative to its value)."""

    trees: list[Tree]
    gap: float


def axis_tree(x, z, y, *, smoothness: float, max_models: int, least: float) -> Grown:
    """Divide the worst leaf across the best axis, through its centre of gravity."""
    trees, gaps, locked = [Tree(x, z, y)], [1.0], set()
    while len(trees) < max_models:
        tree = trees[-1]
        losses = tree.losses()
        order = [m for m in np.argsort(-np.array(losses)) if m not in locked]
        if not order:
            break
        worst = order[0]
        at = moments(z, leaf_validity(z, tree.leaves[worst]))
        gates = [make_gate(d, 0.0, at, smoothness) for d in np.eye(z.shape[1])]
        tried = [tree.divided(worst, gate) for gate in gates]
        pairs = [(t.masses()[worst], t.masses()[-1]) for t in tried]
        allowed = [t for t, m in zip(tried, pairs, strict=True) if min(m) >= least]
        if not allowed:
            locked.add(worst)
            continue
        allowed.sort(key=Tree.sse)
        if len(order) > 1:
            gaps.append(1 - losses[order[1]] / losses[worst])
        if len(allowed) > 1:
            gaps.append(1 - allowed[0].sse() / allowed[1].sse())
        trees.append(allowed[0])
    return Grown(trees, min(gaps))
