"""Partitions that do not grow: Gaussians at samples or clusters; grown ones moved."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import program
from jaxnarx.models import Gaussians, Network, OutputModel
from jaxnarx.partition.local_fit import fit_models
from jaxnarx.partition.training_rows import TrainingRows
from jaxnarx.refinement import Layout, make_layout
from jaxnarx.regressors import evaluate
from jaxnarx.settings import Lolimot, Placed, SigmoidTree

CLUSTER_ROUNDS = 10
"""Rounds of the search for clusters."""
WIDTH_BAND = (0.5, 2.0)
"""Limits of a width that is moved, as multiples of its start."""
NARROWEST_SHARE = 0.1
"""Least extension of a cluster, as a share of one of as many equal boxes."""


def place_output(training: TrainingRows, output: int, method: Placed) -> OutputModel:
    """The model of one output."""
    p, y = training.columns(output)
    numbers = [np.asarray(x, p.dtype) for x in (method.k_sigma, method.ridge)]
    rows = p, training.z, y, training.weight(output)
    most, seed = method.max_models, np.asarray(method.seed)
    validity, theta = _place(*rows, *numbers, seed, most=most, at=method.at)
    theta = training.coefficients(output, theta)
    return training.model(output, theta, validity, most)


@program
def _place(p, z, y, weight, k_sigma, ridge, seed, *, most: int, at):
    active = jnp.ones(most, bool)
    validity = place(z, weight, active, k_sigma, seed, at=at)
    theta = fit_models(p, y, validity(z, active), weight, active, ridge)
    return validity, theta


def place(
    z: Float[Array, "dims rows"],
    weight: Float[Array, " rows"],
    active: Bool[Array, " models"],
    k_sigma: Float[Array, ""],
    seed: Int[Array, ""] | int,
    *,
    at: Literal["samples", "clusters"],
) -> Gaussians:
    """Gaussians at samples drawn at random, or at the means of clusters from there."""
    noise = jax.random.gumbel(jax.random.key(seed), weight.shape, z.dtype)
    drawn = jnp.where(weight > 0, noise, -jnp.inf)
    _, rows = jax.lax.top_k(drawn, len(active))
    centre = z[:, rows].T
    even = jnp.sum(active).astype(z.dtype) ** (-1.0 / len(z))
    extension = jnp.full_like(centre, 1.0) * even
    if at == "clusters":
        centre, spread = clusters(z, weight, centre, active)
        extension = jnp.maximum(jnp.sqrt(12.0) * spread, NARROWEST_SHARE * even)
    return Gaussians(centre, jnp.log(k_sigma * extension))


def clusters(
    z: Float[Array, "dims rows"],
    weight: Float[Array, " rows"],
    centre: Float[Array, "models dims"],
    active: Bool[Array, " models"],
) -> tuple[Float[Array, "models dims"], Float[Array, "models dims"]]:
    """Means and standard deviations of clusters of samples, from given means.

    S. Lloyd, "Least squares quantization in PCM", 1982: every sample belongs to the
    nearest mean, and every mean to its samples. One without samples stays.
    """

    def shares(centre):
        away = jnp.sum((z[None] - centre[:, :, None]) ** 2, axis=1)
        nearest = jnp.argmin(jnp.where(active[:, None], away, jnp.inf), axis=0)
        own = jax.nn.one_hot(nearest, len(centre), axis=0, dtype=z.dtype)
        own = own * (weight > 0).astype(own.dtype)[None]
        mass = jnp.sum(own, axis=1)[:, None]
        return own / jnp.maximum(mass, 1.0), mass > 0

    def move(_, centre):
        own, there = shares(centre)
        return jnp.where(there, own @ z.T, centre)

    centre = jax.lax.fori_loop(0, CLUSTER_ROUNDS, move, centre)
    own, _ = shares(centre)
    square = jnp.maximum(own @ z.T**2 - (own @ z.T) ** 2, 0.0)
    return centre, jnp.sqrt(square)


def scatter_partition(
    layout: Layout,
    network: Network,
    rows: tuple[Array, Array, Array, Array],
    *,
    scatter: Float[Array, ""],
    seed: Int[Array, ""],
    ridge: Float[Array, ""],
) -> Float[Array, " params"]:
    """The vector of a network of one output whose partition is moved at random, its
    local models fitted anew; `rows` are (terms, rows) columns, scheduling, target and
    weight.
    """
    p, z, y, weight = rows
    u = layout.gather(network)
    key = jax.random.fold_in(jax.random.key(seed), 1)
    noise = scatter * jax.random.normal(key, u.shape, u.dtype)
    moved = jnp.where(jnp.isfinite(layout.low), u + noise, u)
    placed = layout.place(jnp.clip(moved, -layout.wall(), layout.wall()))
    model = placed.models[0]
    phi = model.validity(z, model.active)
    theta = fit_models(p, y, phi, weight, model.active, ridge)
    placed = eqx.tree_at(lambda n: n.models[0].local.coefficient, placed, theta)
    return jnp.where(scatter > 0, layout.gather(placed), u)


def move_output(
    training: TrainingRows, output: int, frame: Network, method: Lolimot | SigmoidTree
) -> OutputModel:
    """The model of one output, that of `frame`, with its partition moved at random."""
    layout = make_layout(frame, None, WIDTH_BAND)
    p = evaluate(training.factors[output], training.rows.v)
    rows = p, training.z, training.rows.y[output], training.weight(output)
    numbers = [np.asarray(x, p.dtype) for x in (method.scatter, method.ridge)]
    u = _move(layout, frame, rows, *numbers, np.asarray(method.seed))
    return layout.place(u).models[0]


@program
def _move(layout: Layout, network: Network, rows, scatter, ridge, seed):
    return scatter_partition(
        layout, network, rows, scatter=scatter, seed=seed, ridge=ridge
    )
