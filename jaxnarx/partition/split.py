"""The best gate for one leaf: its children fitted by least squares inside the search.

A gate divides a leaf of validity phi into phi sigma(a) and phi (1 - sigma(a)),

    a(z) = STEEPNESS (d . (z - c) / |d| - b) / (smoothness D(d))
    D(d) = sqrt(3 d'C d) / |d|

with c and C the mean and covariance of the leaf's data, weighted with phi. D is the
distance between the centres of the two parts that a plane across d leaves of evenly
spread data. So the steepness follows from the direction, and the size of a region does
not matter: at these centres the gate in the middle has weight
sigma(STEEPNESS / (2 smoothness)).

Both children are estimated by least squares weighted with their own validity; the rest
of the network stays. A small nonlinear least-squares problem in (d, b) remains, for the
squared error of the whole network: Levenberg-Marquardt with the exact derivative of the
estimates. With dphi = phi sigma (1 - sigma) da, child k's regressors P, weights W_k,
prediction f_k, ridge r towards the parent's theta_0, D_k = diag(P W_k P') and its
derivative dD,

    dtheta_k = +-(P W_k P' + r D_k)^-1 (P W dphi (y - f_k) - r dD (theta_k - theta_0))
    de = -sum_k (+-dphi f_k + phi_k P' dtheta_k)

O. Nelles, "Axes-oblique partitioning strategies for local model networks", 2006;
B. Hartmann and O. Nelles, "On the smoothness in local model networks", ACC 2009; nested
estimation as in G. Golub and V. Pereyra, 1973.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import ridge_solve
from jaxnarx.partition.local_fit import local_fit

USUAL_STEEPNESS = 16.0
"""Steepness of a gate of smoothness one."""
LEAST_CENTRE_DISTANCE = 1e-6
"""Least centre distance D, in units of the training range: data spread less along a
direction do not tell its two sides apart."""
GATE_TOLERANCE = 1e-4
"""The search for a gate ends when a step lowers the loss by less than this share."""
LARGEST_DAMPING = 1e8
"""Damping at which it gives up."""


class SplitRows(eqx.Module):
    """Regressors, target and weights, and the settings of every split.

    `least` is the smallest sum of validities that a child may have; `ridge`, `picks`
    and `first` are those of `local_fit`.
    """

    p: Float[Array, "terms rows"]
    z: Float[Array, "dims rows"]
    y: Float[Array, " rows"]
    weight: Float[Array, " rows"]
    smoothness: Float[Array, ""]
    ridge: Float[Array, ""]
    least: Float[Array, ""]
    picks: int | None = eqx.field(static=True)
    first: int | None = eqx.field(static=True)

    def fit(
        self, phi: Float[Array, " rows"], prior: Float[Array, " terms"]
    ) -> Float[Array, " terms"]:
        """Coefficients of the local model of validity `phi`."""
        own = {"ridge": self.ridge, "picks": self.picks, "first": self.first}
        return local_fit(self.p, self.y, phi * self.weight, prior=prior, **own)

    def used_terms(self, theta: Float[Array, " terms"]) -> Bool[Array, " terms"]:
        """Terms that a local model has."""
        return theta != 0 if self.picks else jnp.ones(theta.shape, bool)


class Leaf(eqx.Module):
    """A leaf and what stays while its gate is sought.

    `away` is z - c; `target` what the rest of the network leaves to the children.
    """

    phi: Float[Array, " rows"]
    theta: Float[Array, " terms"]
    target: Float[Array, " rows"]
    away: Float[Array, "dims rows"]
    centre: Float[Array, " dims"]
    covariance: Float[Array, "dims dims"]


class Children(eqx.Module):
    """Two children of a leaf: validities, coefficients, and the network's SSE.

    The SSE is infinite where the split is forbidden.
    """

    phi: Float[Array, "2 rows"]
    theta: Float[Array, "2 terms"]
    sse: Float[Array, ""]


class Point(eqx.Module):
    """A point of the search: its gate (d, b), loss, and normal equations J'J, J'e."""

    gate: Float[Array, " params"]
    sse: Float[Array, ""]
    normal: Float[Array, "params params"]
    gradient: Float[Array, " params"]


class DirectionSearch(eqx.Module):
    """The state of the search; `damping` is Marquardt's."""

    best: Point
    damping: Float[Array, ""]
    going: Bool[Array, ""]
    steps: Int[Array, ""]


def make_leaf(
    rows: SplitRows,
    phi: Float[Array, " rows"],
    theta: Float[Array, " terms"],
    target: Float[Array, " rows"],
) -> Leaf:
    """The leaf's weighted centre of gravity and covariance; zero where it is empty."""
    w = phi * rows.weight
    total = jnp.sum(w)
    w = w / jnp.where(total > 0, total, 1.0)
    centre = rows.z @ w
    away = rows.z - centre[:, None]
    return Leaf(phi, theta, target, away, centre, (away * w[None]) @ away.T)


def steepness(
    direction: Float[Array, " dims"], leaf: Leaf, smoothness: Float[Array, ""]
) -> Float[Array, ""]:
    """Steepness of a gate across a unit direction."""
    return USUAL_STEEPNESS / (smoothness * extent(direction, leaf))


def argument(
    gate: Float[Array, " params"], leaf: Leaf, smoothness: Float[Array, ""]
) -> Float[Array, " rows"]:
    """a(z) of every row."""
    direction, border = unit(gate[:-1]), gate[-1]
    return steepness(direction, leaf, smoothness) * (direction @ leaf.away - border)


def unit(direction: Float[Array, " dims"]) -> Float[Array, " dims"]:
    """The vector of length one; zero stays zero."""
    square = direction @ direction
    return direction / jnp.sqrt(jnp.where(square > 0, square, 1.0))


def extent(direction: Float[Array, " dims"], leaf: Leaf) -> Float[Array, ""]:
    """Distance D between the children's centres along a unit direction."""
    square = 3 * direction @ leaf.covariance @ direction
    return jnp.sqrt(jnp.maximum(square, LEAST_CENTRE_DISTANCE**2))


def divide(gate: Float[Array, " params"], leaf: Leaf, rows: SplitRows) -> Children:
    """The children that a gate makes of a leaf."""
    phi = _sides(gate, leaf, rows)

    def fit(phi_k):
        theta = rows.fit(phi_k, leaf.theta)
        return theta, phi_k * (theta @ rows.p)

    theta, share = jax.lax.map(fit, phi)
    error = _error(leaf, rows, share)
    return Children(phi, theta, _sse(gate, phi, error, leaf, rows))


def _sides(gate, leaf: Leaf, rows: SplitRows) -> Float[Array, "2 rows"]:
    side = jax.nn.sigmoid(argument(gate, leaf, rows.smoothness))
    return leaf.phi[None] * jnp.stack([side, 1 - side])


def _error(leaf: Leaf, rows: SplitRows, share: Float[Array, "2 rows"]):
    return jnp.where(rows.weight > 0, leaf.target - share[0] - share[1], 0.0)


def _sse(gate, phi, error, leaf: Leaf, rows: SplitRows) -> Float[Array, ""]:
    """Squared error of the network; infinite where the split is forbidden."""
    sse = jnp.sum(rows.weight * error**2)
    mass = jnp.sum(jnp.where(rows.weight[None] > 0, phi, 0.0), axis=1)
    allowed = jnp.all(mass >= rows.least) & jnp.isfinite(sse)
    allowed &= extent(unit(gate[:-1]), leaf) > LEAST_CENTRE_DISTANCE
    return jnp.where(allowed, sse, jnp.inf)


def linearise(gate: Float[Array, " params"], leaf: Leaf, rows: SplitRows) -> Point:
    """Loss of a gate, and its normal equations by the exact derivative.

    Where local models choose their terms, it is that of the choice made.
    """
    slope = jax.jacfwd(lambda g: argument(g, leaf, rows.smoothness))(gate).T
    side = jax.nn.sigmoid(argument(gate, leaf, rows.smoothness))
    moved = (leaf.phi * side * (1 - side))[None] * slope
    square = rows.p**2

    def change(inputs):
        phi_k, sign = inputs
        theta = rows.fit(phi_k, leaf.theta)
        f = theta @ rows.p
        miss = jnp.where(rows.weight > 0, rows.y - f, 0.0)
        weighted = sign * moved * rows.weight[None]
        moment = rows.p @ (weighted * miss[None]).T
        off = rows.ridge * (theta - leaf.theta)
        moment -= off[:, None] * (square @ weighted.T)
        used = rows.used_terms(theta)
        gram = (rows.p * (phi_k * rows.weight)[None]) @ rows.p.T
        gram = jnp.where(used[:, None] & used[None], gram, 0.0)
        moment = jnp.where(used[:, None], moment, 0.0)
        solve = jax.vmap(ridge_solve, in_axes=(None, 1, None), out_axes=1)
        dtheta = solve(gram, moment, rows.ridge)
        return phi_k * f, sign * moved * f[None] + phi_k[None] * (dtheta.T @ rows.p)

    phi = _sides(gate, leaf, rows)
    sign = jnp.asarray([1.0, -1.0], rows.p.dtype)
    share, changes = jax.lax.map(change, (phi, sign))
    error, jacobian = _error(leaf, rows, share), -(changes[0] + changes[1])
    weighted = jacobian * rows.weight[None]
    sse = _sse(gate, phi, error, leaf, rows)
    return Point(gate, sse, weighted @ jacobian.T, weighted @ error)


def search(
    gate: Float[Array, " params"], leaf: Leaf, rows: SplitRows, steps: int
) -> Float[Array, " params"]:
    """Move a gate downhill for at most `steps` trials; never to a worse one."""

    def step(s: DirectionSearch) -> DirectionSearch:
        new = linearise(_damped_step(s.best, s.damping), leaf, rows)
        better = new.sse < s.best.sse
        small = s.best.sse - new.sse < GATE_TOLERANCE * s.best.sse
        best = jax.tree.map(lambda a, b: jnp.where(better, a, b), new, s.best)
        damping = jnp.where(better, s.damping / 10, s.damping * 4)
        going = jnp.where(better, ~small, damping < LARGEST_DAMPING)
        return DirectionSearch(best, damping, going, s.steps + 1)

    start = linearise(gate, leaf, rows)
    begin = DirectionSearch(
        start,
        jnp.asarray(1e-2, gate.dtype),
        jnp.isfinite(start.sse),
        jnp.asarray(0),
    )
    end = jax.lax.while_loop(lambda s: s.going & (s.steps < steps), step, begin)
    return end.best.gate


def _damped_step(at: Point, damping: Float[Array, ""]) -> Float[Array, " params"]:
    """The next gate, its direction of length one."""
    diagonal = jnp.diagonal(at.normal)
    # The length of the direction has no effect, so its row is zero.
    floor = 1e-9 * jnp.max(diagonal) + jnp.finfo(diagonal.dtype).tiny
    matrix = at.normal + jnp.diag(damping * diagonal + floor)
    gate = at.gate - ridge_solve(matrix, at.gradient)
    return jnp.concatenate([unit(gate[:-1]), gate[-1:]])
