"""The partition inside the program: models grown or placed, and fitted."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxnarx.models import AbstractValidity, Gaussians
from jaxnarx.partition import (
    best_stage,
    fit_models,
    lolimot,
    place,
    sigmoid_tree,
    validity_of_boxes,
    validity_of_stage,
)
from jaxnarx.settings import Global, Placed, SigmoidTree
from jaxnarx.sweep.identify.settings import Settings, Shape


class GrowthRows(eqx.Module):
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
    shape: Shape, rows: GrowthRows, least: Int[Array, ""], settings: Settings
) -> Divided:
    """Place the models as `shape.grow` says.

    `least` is the smallest sum of validities that a split may leave, the number of
    terms.
    """
    grow, models = shape.grow, shape.models
    ridge = jnp.asarray(settings.growth_ridge)
    if isinstance(grow, Global):
        nowhere = jnp.zeros((1, 0), rows.y.dtype)
        return _fit(rows, Gaussians(nowhere, nowhere), jnp.asarray(1), ridge)
    k_sigma = jnp.asarray(settings.k_sigma)
    if isinstance(grow, Placed):
        count = jnp.asarray(settings.models)
        active = jnp.arange(models) < count
        placed = place(
            rows.z, rows.weight, active, k_sigma, jnp.asarray(settings.seed), at=grow.at
        )
        return _fit(rows, placed, count, ridge)
    data = rows.p, rows.z, rows.y, rows.weight
    common = {
        "ridge": ridge,
        "least": least.astype(rows.y.dtype),
        "max_models": models,
    }
    if isinstance(grow, SigmoidTree):
        smoothness = jnp.asarray(settings.smoothness)
        stages = sigmoid_tree(*data, smoothness=smoothness, **common)
    else:
        stages = lolimot(*data, k_sigma=k_sigma, kind=grow.validity, **common)
    best = best_stage(
        stages.sse,
        stages.effective,
        stages.count,
        jnp.sum((rows.weight > 0).astype(rows.y.dtype)),
        jnp.asarray(settings.models),
        criterion=grow.criterion,
        patience=grow.patience,
    )
    at = jax.tree.map(lambda a: a[best][None], stages)
    if isinstance(grow, SigmoidTree):
        validity = validity_of_stage(at, 0, models)
    else:
        validity = validity_of_boxes(grow.validity, at.low[0], at.high[0], k_sigma)
    return Divided(validity, at.theta[0], at.count[0])


def _fit(
    rows: GrowthRows,
    validity: Gaussians,
    count: Int[Array, ""],
    ridge: Float[Array, ""],
) -> Divided:
    """Local models on a partition that is there."""
    active = jnp.arange(len(validity.centre)) < count
    phi = validity(rows.z, active)
    theta = fit_models(rows.p, rows.y, phi, rows.weight, active, ridge)
    return Divided(validity, theta, count)
