"""Forward orthogonal least squares with the error reduction ratio, pool never formed.

With orthonormal directions q_1 ... q_k of the chosen terms, candidate j keeps

    d_j = |p_j|^2 - sum_k <p_j, q_k>^2        its squared norm off the chosen ones
    b_j = <p_j, y> - sum_k <p_j, q_k> <q_k, y>

and ERR_j = b_j^2 / (d_j <y, y>). Each new direction needs one contraction of the whole
pool. All products are weighted: vectors carry sqrt(weight).

Chen, Billings, Luo, "Orthogonal least squares methods and their application to
non-linear system identification", Int. J. Control 50 (1989); thesis (5.25), (5.26).
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.contraction import contract


class State(eqx.Module):
    """What the search knows; slots are filled in order. One output inside `choose`."""

    b: Float[Array, "*outputs terms"]
    d: Float[Array, "*outputs terms"]
    alive: Bool[Array, "*outputs terms"]
    direction: Float[Array, "*outputs slots rows"]
    index: Int[Array, "*outputs slots"]
    err: Float[Array, "*outputs slots"]
    count: Int[Array, "*outputs"]
    going: Bool[Array, "*outputs"]


class Path(eqx.Module):
    """Chosen terms in order: ERR as shares of `power`, the weighted `<y, y>`.

    `coefficient` is the least-squares value with all of them, `cond` the condition
    number of their scaled columns.
    """

    index: Int[Array, "outputs slots"]
    err: Float[Array, "outputs slots"]
    count: Int[Array, " outputs"]
    power: Float[Array, " outputs"]
    coefficient: Float[Array, "outputs slots"]
    cond: Float[Array, " outputs"]


def _column(v, factor, term):
    return jnp.prod(v[factor[term]], axis=0)


def _orthogonalise(column, direction):
    """Off the chosen directions, twice: once leaves cancellation of order eps *
    cond.
    """
    for _ in range(2):
        column = column - direction.T @ (direction @ column)
    return column


def forward_ols(
    v: Float[Array, "vars rows"],
    y: Float[Array, "outputs rows"],
    weight: Float[Array, "outputs rows"],
    factor: Int[Array, "terms degree"],
    position: Int[Array, " terms"],
    candidate: Bool[Array, " terms"],
    forced: Int[Array, " forced"],
    *,
    max_terms: int,
    rho: Float[Array, ""],
    tau: Float[Array, ""],
    tau_absolute: Float[Array, ""],
) -> Path:
    """Run the search for every output at once; they share each pass over the pool.

    `position` comes from `arrays.contraction.positions`, `candidate` is False for terms
    passed over from the start, `forced` terms are chosen first, in their order.
    """
    degree = factor.shape[1]
    outputs, rows = y.shape
    root = jnp.sqrt(weight)
    target = y * root
    power = jnp.sum(target**2, axis=1)
    norm = contract(v**2, weight, degree)[:, position]

    def products(vectors):
        return contract(v, vectors * root, degree)[:, position]

    def choose(o, s: State):
        """One pick for one output: the best candidate, made exact, or its removal."""
        usable = s.alive & (s.d > tau * norm[o]) & (s.d > tau_absolute)
        score = jnp.where(usable, s.b**2 / jnp.where(usable, s.d, 1.0), -jnp.inf)
        best = jnp.argmax(score)
        if forced.shape[0]:
            first = forced[jnp.minimum(s.count, forced.shape[0] - 1)]
            # A forced term that fails its threshold is dead, and the search goes on.
            is_forced = (s.count < forced.shape[0]) & s.alive[first]
            best = jnp.where(is_forced, first.astype(best.dtype), best)
        found = jnp.any(usable)
        column = _orthogonalise(_column(v, factor, best) * root[o], s.direction)
        exact = column @ column
        accept = s.going & found & (exact > tau * norm[o, best])
        accept &= exact > tau_absolute
        q = jnp.where(accept, column / jnp.sqrt(jnp.where(accept, exact, 1.0)), 0.0)
        gain = q @ target[o]
        slot = jnp.where(accept, s.count, max_terms)
        err = gain**2 / jnp.where(power[o] > 0, power[o], 1.0)
        after = dataclasses.replace(
            s,
            alive=s.alive.at[best].set(s.alive[best] & ~s.going),
            direction=s.direction.at[slot].set(q, mode="drop"),
            index=s.index.at[slot].set(best.astype(s.index.dtype), mode="drop"),
            err=s.err.at[slot].set(err, mode="drop"),
            count=s.count + accept.astype(s.count.dtype),
        )
        left = 1.0 - jnp.sum(after.err)
        going = s.going & found & (after.count < max_terms) & (left > rho)
        return dataclasses.replace(after, going=going), q, gain

    def body(s: State):
        s, q, gain = jax.vmap(choose)(jnp.arange(outputs), s)
        # Nothing accepted (a candidate was only removed), or nothing left to choose:
        # the pool need not be read.
        read = jnp.any(q != 0) & jnp.any(s.going)
        c = jax.lax.cond(read, products, lambda q: jnp.zeros_like(norm), q)
        return dataclasses.replace(s, b=s.b - c * gain[:, None], d=s.d - c**2)

    start = State(
        b=products(target),
        d=norm,
        alive=jnp.broadcast_to(candidate[None] & True, norm.shape) & (norm > 0),
        direction=jnp.zeros((outputs, max_terms, rows), y.dtype),
        index=jnp.zeros((outputs, max_terms), factor.dtype),
        err=jnp.zeros((outputs, max_terms), y.dtype),
        count=jnp.zeros(outputs, int),
        going=power > 0,
    )
    end = jax.lax.while_loop(lambda s: jnp.any(s.going), body, start)
    return _finish(end, v, target, root, factor, power, max_terms)


def _finish(s: State, v, target, root, factor, power, max_terms) -> Path:
    def coefficients(o):
        used = jnp.arange(max_terms) < s.count[o]
        columns = jnp.prod(v[factor[s.index[o]]], axis=1) * root[o][None]
        r = s.direction[o] @ columns.T
        r = jnp.where(
            used[:, None] & used[None], jnp.triu(r), jnp.eye(max_terms, dtype=r.dtype)
        )
        theta = jax.scipy.linalg.solve_triangular(
            r, jnp.where(used, s.direction[o] @ target[o], 0.0)
        )
        norm = jnp.sqrt(jnp.sum(r**2, axis=0))
        singular = jnp.linalg.svd(r / norm[None], compute_uv=False)
        return theta, singular[0] / singular[-1]

    theta, cond = jax.vmap(coefficients)(jnp.arange(target.shape[0]))
    return Path(s.index, s.err, s.count, power, theta, cond)
