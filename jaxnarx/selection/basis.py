"""The chosen columns as an orthonormal basis, terms enter and leave by a turn.

With orthonormal directions q_1 ... q_k that span the chosen columns, candidate p_j has
coordinates C_sj = <p_j, q_s>. Off the chosen columns it keeps

    d_j = |p_j|^2 - sum_s C_sj^2        of its squared norm, and
    b_j = <p_j, y> - sum_s C_sj g_s     of its product with the output, g_s = <q_s, y> ,

so that taking it in lowers the squared error by b_j^2 / d_j. One row of C costs one
contraction of the pool, when a term enters. Nothing else does: with M the chosen
columns in the directions, row i of M^-1 is orthogonal to every chosen column but the
i-th. A reflection turns the basis until one direction lies along it; dropping that
direction is leaving out term i, for C, g and M alike. The same rows tell what every
swap of one term for another would bring, see `swaps`.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


class Lane(eqx.Module):
    """The arrays that one search reads and never changes; an output or a weighting is a
    lane.

    Vectors carry sqrt(weight), `root`. `norm` and `moment` are |p_j|^2 and <p_j, y> of
    every candidate, `samples` counts rows with weight. The first `starts` terms of
    `start` are taken in before any choice.
    """

    target: Float[Array, "*lanes rows"]
    root: Float[Array, "*lanes rows"]
    norm: Float[Array, "*lanes terms"]
    moment: Float[Array, "*lanes terms"]
    power: Float[Array, "*lanes"]
    samples: Float[Array, "*lanes"]
    start: Int[Array, "*lanes start"]
    starts: Int[Array, "*lanes"]


class Basis(eqx.Module):
    """Chosen terms in order of entry, see the head of this file.

    Slots past `count` hold zeros, in `matrix` the unit matrix.
    """

    index: Int[Array, "*lanes slots"]
    count: Int[Array, "*lanes"]
    direction: Float[Array, "*lanes slots rows"]
    matrix: Float[Array, "*lanes slots slots"]
    coordinate: Float[Array, "*lanes slots terms"]
    gain: Float[Array, "*lanes slots"]

    @property
    def used(self) -> Bool[Array, " slots"]:
        """True for slots that hold a term."""
        return jnp.arange(self.index.shape[0]) < self.count


def empty(slots: int, lane: Lane) -> Basis:
    """A basis without any direction."""
    dtype = lane.target.dtype
    return Basis(
        jnp.zeros(slots, int),
        jnp.asarray(0),
        jnp.zeros((slots, lane.target.shape[0]), dtype),
        jnp.eye(slots, dtype=dtype),
        jnp.zeros((slots, lane.norm.shape[0]), dtype),
        jnp.zeros(slots, dtype),
    )


def remaining_moments(
    basis: Basis, lane: Lane
) -> tuple[Float[Array, " terms"], Float[Array, " terms"]]:
    """b and d of every candidate."""
    b = lane.moment - basis.gain @ basis.coordinate
    return b, lane.norm - jnp.sum(basis.coordinate**2, axis=0)


def chosen_mask(basis: Basis, terms: int) -> Bool[Array, " terms"]:
    """True for the terms of the pool that are chosen."""
    return jnp.zeros(terms, bool).at[basis.index].max(basis.used)


def squared_error(basis: Basis, lane: Lane) -> Float[Array, ""]:
    """Squared error of the chosen terms, from the residual itself."""
    residual = lane.target - basis.gain @ basis.direction
    return residual @ residual


def project(
    basis: Basis, column: Float[Array, " rows"]
) -> tuple[Float[Array, " rows"], Float[Array, " slots"]]:
    """The part of a column off the chosen ones, and its coordinates in them.

    It is orthogonalised twice: once leaves cancellation of order eps * cond.
    """
    coordinate = jnp.zeros_like(basis.gain)
    for _ in range(2):
        along = basis.direction @ column
        column = column - along @ basis.direction
        coordinate = coordinate + along
    return column, coordinate


def enter(
    basis: Basis,
    lane: Lane,
    term: Int[Array, ""],
    off: Float[Array, " rows"],
    along: Float[Array, " slots"],
    wanted: Bool[Array, ""],
) -> tuple[Basis, Float[Array, " rows"]]:
    """Take in a term by its parts from `project`; also returns its direction.

    The coordinates of the pool on that direction are still missing: `recorded`.
    """
    size = jnp.sqrt(off @ off)
    q = jnp.where(wanted, off / jnp.where(size > 0, size, 1.0), 0.0)
    slot = jnp.where(wanted, basis.count, basis.index.shape[0])
    matrix = basis.matrix.at[:, slot].set(along, mode="drop")
    grown = dataclasses.replace(
        basis,
        index=basis.index.at[slot].set(term.astype(basis.index.dtype), mode="drop"),
        count=basis.count + wanted.astype(basis.count.dtype),
        direction=basis.direction.at[slot].set(q, mode="drop"),
        matrix=matrix.at[slot, slot].set(size, mode="drop"),
        gain=basis.gain.at[slot].set(q @ lane.target, mode="drop"),
    )
    return grown, q


def record_direction(
    basis: Basis, products: Float[Array, " terms"], wanted: Bool[Array, ""]
) -> Basis:
    """Keep the coordinates of the pool on the direction that entered last."""
    slot = jnp.where(wanted, basis.count - 1, basis.index.shape[0])
    coordinate = basis.coordinate.at[slot].set(products, mode="drop")
    return dataclasses.replace(basis, coordinate=coordinate)


def duals(basis: Basis) -> Float[Array, "slots slots"]:
    """Row i is orthogonal to all chosen columns but the i-th, with which it gives 1."""
    return jnp.linalg.inv(basis.matrix)


def leave(basis: Basis, slot: Int[Array, ""], wanted: Bool[Array, ""]) -> Basis:
    """Drop the term in `slot`; later ones move up."""
    slots = jnp.arange(basis.index.shape[0])
    last = basis.count - 1
    h = duals(basis)[slot]
    h = h / jnp.linalg.norm(h)
    u = h + jnp.where(slots == last, jnp.where(h[last] < 0, -1.0, 1.0), 0.0)
    u = u / jnp.linalg.norm(u)
    u = jnp.where(wanted, u, 0.0).astype(h.dtype)
    keeps = slots != jnp.where(wanted, last, slots.size)

    def reflect(a):
        a = a - 2.0 * jnp.tensordot(u, u @ a, axes=0)
        return jnp.where(keeps.reshape(-1, *(1,) * (a.ndim - 1)), a, 0.0)

    later = jnp.where(wanted & (slots >= slot), slots + 1, slots)
    count = basis.count - wanted.astype(basis.count.dtype)
    inside = slots < count
    matrix = reflect(basis.matrix)[:, jnp.minimum(later, slots.size - 1)]
    unit = jnp.eye(slots.size, dtype=matrix.dtype)
    return Basis(
        basis.index[jnp.minimum(later, slots.size - 1)],
        count,
        reflect(basis.direction),
        jnp.where(inside[:, None] & inside[None], matrix, unit),
        reflect(basis.coordinate),
        reflect(basis.gain),
    )


def coefficients(
    basis: Basis,
) -> tuple[Float[Array, " slots"], Float[Array, " slots"]]:
    """Least-squares coefficients, and the diagonal of the inverse Gram matrix."""
    inverse = duals(basis)
    theta = jnp.where(basis.used, inverse @ basis.gain, 0.0)
    return theta, jnp.sum(inverse**2, axis=1)


def partial_f(basis: Basis, lane: Lane) -> Float[Array, " slots"]:
    """Partial F of every chosen term, `inf` in unused slots; thesis (5.19).

    The increase of the squared error by leaving the term out, over the error variance
    SSE/(N - p) of all p chosen terms. It is the square of the t value.
    """
    theta, diagonal = coefficients(basis)
    spare = lane.samples - basis.count.astype(lane.samples.dtype)
    variance = squared_error(basis, lane) / jnp.maximum(spare, 1.0)
    # A perfect fit leaves an error of rounding alone; it must not count as noise.
    floor = (jnp.finfo(variance.dtype).eps ** 2) * lane.power
    f = theta**2 / (diagonal * jnp.maximum(variance, floor))
    return jnp.where(basis.used & (spare > 0), f, jnp.inf)


def swaps(
    basis: Basis,
    lane: Lane,
    usable: Bool[Array, " terms"],
    least: Float[Array, ""],
    parents: Int[Array, "terms parts"] | None = None,
) -> tuple[Float[Array, " slots"], Int[Array, " slots"]]:
    """The gain of the best exchange for every chosen term, and the term to take.

    Without the term of slot i, whose unit dual direction is h, candidate j has
    b_j + <p_j, h> <h, y> and d_j + <p_j, h>^2; leaving out the term costs <h, y>^2. The
    difference is the decrease of the squared error. Candidates with less than `least`
    of their squared norm left do not count, nor those of which the leaving term is a
    part.
    """
    inverse = duals(basis)
    h = inverse / jnp.linalg.norm(inverse, axis=1)[:, None]
    b, d = remaining_moments(basis, lane)

    def swap_gain(slot):
        h, index = slot
        along, cost = h @ basis.coordinate, h @ basis.gain
        free = d + along**2
        fine = usable & (free > least * lane.norm)
        if parents is not None:
            fine &= ~jnp.any(parents == index, axis=1)
        brings = (b + along * cost) ** 2 / jnp.where(fine, free, 1.0)
        best = jnp.argmax(jnp.where(fine, brings, -jnp.inf))
        return jnp.where(fine[best], brings[best], -jnp.inf) - cost**2, best

    decrease, term = jax.lax.map(swap_gain, (h, basis.index))
    return jnp.where(basis.used, decrease, -jnp.inf), term
