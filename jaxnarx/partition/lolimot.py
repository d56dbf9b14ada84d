"""LOLIMOT: the worst local model's box is halved, again and again.

Boxes tile the unit cube of the scheduling variables; a box's Gaussian has its middle as
centre and `k_sigma` times its extension as width. Each stage takes the local model with
the largest sum of validity times squared error, tries halving its box in every
dimension, fits only the two new models by least squares weighted with their validity,
and keeps the split with the smallest total squared error. A split is forbidden when
either child's validities sum to less than its number of parameters; a model without an
allowed split is locked and the next worst is tried.

O. Nelles and R. Isermann, "Basis function networks for interpolation of local linear
models", CDC 1996; thesis section 6.2. The published curves need every detail above, and
weights that enter the squared error once, not twice.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.least_squares import cholesky_solve
from jaxnarx.models import Gaussians


class Growth(eqx.Module):
    """State of the growth at fixed capacity; slots past `count` are empty."""

    low: Float[Array, "models dims"]
    high: Float[Array, "models dims"]
    theta: Float[Array, "models terms"]
    locked: Bool[Array, " models"]
    count: Int[Array, ""]
    sse: Float[Array, ""]
    going: Bool[Array, ""]


class Stage(eqx.Module):
    """One stage of the growth as it is kept: the network so far and its figures."""

    low: Float[Array, "models dims"]
    high: Float[Array, "models dims"]
    theta: Float[Array, "models terms"]
    count: Int[Array, ""]
    sse: Float[Array, ""]
    effective: Float[Array, ""]


def gaussians(low, high, k_sigma) -> Gaussians:
    """Validity functions of boxes."""
    extension = jnp.where(high > low, high - low, 1.0)
    return Gaussians((low + high) / 2, jnp.log(k_sigma * extension))


def _fit(p, y, weight):
    """Weighted least squares of one local model by its scaled normal equations.

    A factorisation of the full columns for every trial would cost the whole growth;
    columns are scaled to unit norm and carry a ridge of 1e-12.
    """
    weighted = p * weight[None]
    return cholesky_solve(weighted @ p.T, weighted @ y)


def _effective(p, phi, weight, count):
    """Effective number of parameters, the trace of the local smoothing matrices."""

    def one(phi_m):
        w = phi_m * weight
        gram = (p * w[None]) @ p.T
        twice = (p * (w * phi_m)[None]) @ p.T
        solved = jax.vmap(cholesky_solve, in_axes=(None, 1), out_axes=1)(gram, twice)
        return jnp.trace(solved)

    traces = jax.lax.map(one, phi)
    return jnp.sum(jnp.where(jnp.arange(phi.shape[0]) < count, traces, 0.0))


def lolimot(
    p: Float[Array, "terms rows"],
    z: Float[Array, "dims rows"],
    y: Float[Array, " rows"],
    weight: Float[Array, " rows"],
    *,
    k_sigma: Float[Array, ""],
    max_models: int,
) -> Stage:
    """Grow to `max_models`; returns every stage, stacked (stages = max_models).

    `p` holds the regressors of every local model, `z` the scheduling variables scaled
    to [0, 1]. Once no split is allowed the remaining stages repeat the last.
    """
    terms, dims = p.shape[0], z.shape[0]
    slots = jnp.arange(max_models)

    def validity(low, high, count):
        return gaussians(low, high, k_sigma)(z, slots < count)

    def error(phi, theta):
        return jnp.where(weight > 0, y - jnp.sum(phi * (theta @ p), axis=0), 0.0)

    def trial(s: Growth, worst, d):
        middle = (s.low[worst, d] + s.high[worst, d]) / 2
        low = s.low.at[s.count].set(s.low[worst]).at[s.count, d].set(middle)
        high = s.high.at[s.count].set(s.high[worst]).at[worst, d].set(middle)
        phi = validity(low, high, s.count + 1)
        pair = jnp.stack([worst, s.count])
        children = jax.lax.map(lambda m: _fit(p, y, phi[m] * weight), pair)
        theta = s.theta.at[pair].set(children)
        sse = jnp.sum(weight * error(phi, theta) ** 2)
        mass = jnp.sum(jnp.where(weight[None] > 0, phi[pair], 0.0), axis=1)
        sse = jnp.where(jnp.all(mass >= terms), sse, jnp.inf)
        return low, high, theta, sse

    def attempt(s: Growth):
        """Split the worst unlocked model, or lock it."""
        phi = validity(s.low, s.high, s.count)
        loss = jnp.sum(phi * (weight * error(phi, s.theta) ** 2)[None], axis=1)
        free = (slots < s.count) & ~s.locked
        worst = jnp.argmax(jnp.where(free, loss, -jnp.inf))
        trials = jax.lax.map(lambda d: trial(s, worst, d), jnp.arange(dims))
        best = jnp.argmin(trials[3])
        low, high, theta, sse = jax.tree.map(lambda a: a[best], trials)
        allowed = jnp.any(free) & jnp.isfinite(sse)
        split = dataclasses.replace(
            s, low=low, high=high, theta=theta, sse=sse, count=s.count + 1
        )
        locked = dataclasses.replace(
            s, locked=s.locked.at[worst].set(True), going=jnp.any(free)
        )
        return jax.tree.map(lambda a, b: jnp.where(allowed, a, b), split, locked)

    def stage(s: Growth, _):
        target = s.count + 1
        s = jax.lax.while_loop(lambda s: s.going & (s.count < target), attempt, s)
        return s, keep(s)

    def keep(s: Growth) -> Stage:
        phi = validity(s.low, s.high, s.count)
        return Stage(
            s.low, s.high, s.theta, s.count, s.sse, _effective(p, phi, weight, s.count)
        )

    theta = _fit(p, y, weight)
    start = Growth(
        low=jnp.zeros((max_models, dims), p.dtype),
        high=jnp.zeros((max_models, dims), p.dtype).at[0].set(1.0),
        theta=jnp.zeros((max_models, terms), p.dtype).at[0].set(theta),
        locked=jnp.zeros(max_models, bool),
        count=jnp.asarray(1),
        sse=jnp.sum(weight * (y - theta @ p) ** 2),
        going=jnp.asarray(True),
    )
    _, later = jax.lax.scan(stage, start, None, length=max_models - 1)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), keep(start), later)
