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

from jaxnarx.models import AbstractValidity, Boxes, Compact, Gaussians
from jaxnarx.partition.local_fit import effective, local_fit


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


def validity_of_boxes(kind: str, low, high, k_sigma) -> AbstractValidity:
    """Validity functions of boxes: `"gaussians"`, `"compact"` or `"boxes"`."""
    if kind == "boxes":
        return Boxes(low, high)
    extension = jnp.where(high > low, high - low, 1.0)
    if kind == "compact":
        return Compact(low, high, jnp.log(k_sigma * extension))
    return Gaussians((low + high) / 2, jnp.log(k_sigma * extension))


def _local_nmse(phi, weight, e, y):
    """Var(e)/Var(y) of every local model's own samples, thesis (6.8)."""
    w = phi * weight[None]
    mass = jnp.sum(w, axis=1)
    mass = jnp.where(mass > 0, mass, 1.0)

    def variance(x):
        mean = w @ x / mass
        return jnp.sum(w * (x[None] - mean[:, None]) ** 2, axis=1) / mass

    spread = variance(jnp.where(weight > 0, y, 0.0))
    return jnp.where(spread > 0, variance(e) / jnp.where(spread > 0, spread, 1.0), 0.0)


def lolimot(
    p: Float[Array, "terms rows"],
    z: Float[Array, "dims rows"],
    y: Float[Array, " rows"],
    weight: Float[Array, " rows"],
    *,
    k_sigma: Float[Array, ""],
    ridge: Float[Array, ""],
    least: Float[Array, ""],
    max_models: int,
    kind: str = "gaussians",
    worst: str = "squares",
    picks: int | None = None,
    first: int | None = None,
) -> Stage:
    """Grow to `max_models`; returns every stage, stacked (stages = max_models).

    `p` holds the regressors of every local model, `z` the scheduling variables scaled
    to [0, 1]. A split is allowed where both children have validities that sum to
    `least` or more. Once no split is allowed the remaining stages repeat the last.
    `worst` is `"squares"` or `"nmse"`; `ridge`, `picks` and `first` are those of
    `local_fit`.
    """
    terms, dims = p.shape[0], z.shape[0]
    slots = jnp.arange(max_models)

    def fit(w, prior, pull):
        return local_fit(p, y, w, prior=prior, ridge=pull, picks=picks, first=first)

    def validity(low, high, count):
        return validity_of_boxes(kind, low, high, k_sigma)(z, slots < count)

    def error(phi, theta):
        return jnp.where(weight > 0, y - jnp.sum(phi * (theta @ p), axis=0), 0.0)

    def trial(s: Growth, parent, d):
        middle = (s.low[parent, d] + s.high[parent, d]) / 2
        low = s.low.at[s.count].set(s.low[parent]).at[s.count, d].set(middle)
        high = s.high.at[s.count].set(s.high[parent]).at[parent, d].set(middle)
        phi = validity(low, high, s.count + 1)
        pair = jnp.stack([parent, s.count])
        own = s.theta[parent]
        children = jax.lax.map(lambda m: fit(phi[m] * weight, own, ridge), pair)
        theta = s.theta.at[pair].set(children)
        sse = jnp.sum(weight * error(phi, theta) ** 2)
        mass = jnp.sum(jnp.where(weight[None] > 0, phi[pair], 0.0), axis=1)
        sse = jnp.where(jnp.all(mass >= least), sse, jnp.inf)
        return low, high, theta, sse

    def attempt(s: Growth):
        """Split the worst unlocked model, or lock it."""
        phi = validity(s.low, s.high, s.count)
        e = error(phi, s.theta)
        if worst == "nmse":
            loss = _local_nmse(phi, weight, e, y)
        else:
            loss = jnp.sum(phi * (weight * e**2)[None], axis=1)
        free = (slots < s.count) & ~s.locked
        parent = jnp.argmax(jnp.where(free, loss, -jnp.inf))
        trials = jax.lax.map(lambda d: trial(s, parent, d), jnp.arange(dims))
        best = jnp.argmin(trials[3])
        low, high, theta, sse = jax.tree.map(lambda a: a[best], trials)
        allowed = jnp.any(free) & jnp.isfinite(sse)
        split = dataclasses.replace(
            s, low=low, high=high, theta=theta, sse=sse, count=s.count + 1
        )
        locked = dataclasses.replace(
            s, locked=s.locked.at[parent].set(True), going=jnp.any(free)
        )
        return jax.tree.map(lambda a, b: jnp.where(allowed, a, b), split, locked)

    def stage(s: Growth, _):
        target = s.count + 1
        s = jax.lax.while_loop(lambda s: s.going & (s.count < target), attempt, s)
        return s, keep(s)

    def keep(s: Growth) -> Stage:
        phi = validity(s.low, s.high, s.count)
        used = (slots < s.count)[:, None]
        used = used & (s.theta != 0) if picks else jnp.broadcast_to(used, s.theta.shape)
        n = effective(p, phi, weight, used, ridge)
        return Stage(s.low, s.high, s.theta, s.count, s.sse, n)

    theta = fit(weight, jnp.zeros(terms, p.dtype), jnp.zeros_like(ridge))
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
