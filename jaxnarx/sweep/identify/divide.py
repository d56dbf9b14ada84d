"""The partition inside the program: models placed, fitted, and moved at random."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.methods import Identification
from jaxnarx.models import AbstractValidity, Gaussians
from jaxnarx.partition import (
    local_fit,
    lolimot,
    sigmoid_tree,
    validity_of_boxes,
    validity_of_stage,
)
from jaxnarx.sweep.identify.settings import Settings

ROUNDS = 10
"""Rounds of the search for clusters."""
NARROWEST = 0.1
"""Least extension of a cluster, as a share of one of as many equal boxes."""


class Rows(eqx.Module):
    """Regressors of the chosen terms, scaled scheduling variables, target, weight."""

    p: Float[Array, "terms rows"]
    z: Float[Array, "dims rows"]
    y: Float[Array, " rows"]
    weight: Float[Array, " rows"]


class Divided(eqx.Module):
    """Validity functions and coefficients; models past `count` are inactive."""

    validity: AbstractValidity
    theta: Float[Array, "models terms"]
    count: Int[Array, ""]


def divide(
    method: Identification, rows: Rows, least: Int[Array, ""], settings: Settings
) -> Divided:
    """Place the models as `method.partition` says.

    `least` is the smallest sum of validities that a split may leave, the number of
    terms.
    """
    models = method.max_models
    if not len(rows.z):
        nowhere = jnp.zeros((1, 0), rows.y.dtype)
        validity = Gaussians(nowhere, nowhere)
        everything = fitted(rows, validity, jnp.asarray([True]), settings)
        return Divided(validity, everything, jnp.asarray(1))
    if method.partition in ("random", "cluster"):
        return _placed(method, rows, settings)
    data = rows.p, rows.z, rows.y, rows.weight
    common = {
        "ridge": jnp.asarray(settings.growth_ridge),
        "least": least.astype(rows.y.dtype),
        "max_models": models,
    }
    last = jnp.asarray(settings.models) - 1
    if method.partition == "tree":
        tree = sigmoid_tree(
            *data, smoothness=jnp.asarray(settings.smoothness), **common
        )
        at = jax.tree.map(lambda a: a[last][None], tree)
        validity = validity_of_stage(at, 0, models)
    else:
        k_sigma, kind = jnp.asarray(settings.k_sigma), method.validity
        boxes = lolimot(*data, k_sigma=k_sigma, kind=kind, **common)
        at = jax.tree.map(lambda a: a[last][None], boxes)
        validity = validity_of_boxes(kind, at.low[0], at.high[0], k_sigma)
    return Divided(validity, at.theta[0], at.count[0])


def fitted(
    rows: Rows,
    validity: AbstractValidity,
    active: Bool[Array, " models"],
    settings: Settings,
) -> Float[Array, "models terms"]:
    """Local least squares, pulled to the global model by `growth_ridge`."""
    ridge = jnp.asarray(settings.growth_ridge)
    start = jnp.zeros(len(rows.p), rows.p.dtype)
    both = rows.p, rows.y
    prior = local_fit(*both, rows.weight, prior=start, ridge=jnp.zeros_like(ridge))
    weights = validity(rows.z, active) * rows.weight[None]
    theta = jax.lax.map(
        lambda w: local_fit(*both, w, prior=prior, ridge=ridge), weights
    )
    return jnp.where(active[:, None], theta, 0.0)


def _placed(method: Identification, rows: Rows, settings: Settings) -> Divided:
    """Gaussians at samples drawn at random, or at the means of clusters from there."""
    count = jnp.asarray(settings.models)
    active = jnp.arange(method.max_models) < count
    noise = jax.random.gumbel(
        jax.random.key(settings.seed), rows.weight.shape, rows.z.dtype
    )
    drawn = jnp.where(rows.weight > 0, noise, -jnp.inf)
    _, at = jax.lax.top_k(drawn, method.max_models)
    centre = rows.z[:, at].T
    dims = centre.shape[1]
    even = count.astype(centre.dtype) ** (-1.0 / dims)
    extension = jnp.full_like(centre, 1.0) * even
    if method.partition == "cluster":
        centre, spread = clusters(rows, centre, active)
        extension = jnp.maximum(jnp.sqrt(12.0) * spread, NARROWEST * even)
    width = jnp.asarray(settings.k_sigma) * extension
    validity = Gaussians(centre, jnp.log(width))
    return Divided(validity, fitted(rows, validity, active, settings), count)


def clusters(
    rows: Rows, centre: Float[Array, "models dims"], active: Bool[Array, " models"]
) -> tuple[Float[Array, "models dims"], Float[Array, "models dims"]]:
    """Means and standard deviations of clusters of samples, from given means.

    S. Lloyd, "Least squares quantization in PCM", 1982: every sample belongs to the
    nearest mean, and every mean to its samples. One without samples stays.
    """

    def shares(centre):
        away = jnp.sum((rows.z[None] - centre[:, :, None]) ** 2, axis=1)
        nearest = jnp.argmin(jnp.where(active[:, None], away, jnp.inf), axis=0)
        own = jax.nn.one_hot(nearest, len(centre), axis=0, dtype=rows.z.dtype)
        own = own * (rows.weight > 0).astype(own.dtype)[None]
        mass = jnp.sum(own, axis=1)[:, None]
        return own / jnp.maximum(mass, 1.0), mass > 0

    def move(_, centre):
        own, there = shares(centre)
        return jnp.where(there, own @ rows.z.T, centre)

    centre = jax.lax.fori_loop(0, ROUNDS, move, centre)
    own, _ = shares(centre)
    square = jnp.maximum(own @ rows.z.T**2 - (own @ rows.z.T) ** 2, 0.0)
    return centre, jnp.sqrt(square)
