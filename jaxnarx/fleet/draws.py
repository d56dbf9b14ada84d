"""Engines drawn from a population."""

import jax.numpy as jnp
import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import whole
from jaxnarx.fleet.population import root_of
from jaxnarx.fleet.prior import FleetPrior
from jaxnarx.models import Network


@guard_arguments
def draw_engines(prior: FleetPrior, count: int, *, seed: int = 0) -> list[Network]:
    """So many engines of a fleet, drawn from mean and covariance of its coefficients.

    The same seed gives the same engines. They share arrays' shapes, so that
    `jnx.stack` makes one of them for `vmap`.

    Example:
        prior = jnx.fleet.learn({"one": data, "other": data}, network).value
        engines = jnx.fleet.draw_engines(prior, 8)
    """
    whole(count, "count", 1)
    whole(seed, "seed", 0)
    root = root_of(prior.population.covariance)
    mean = np.asarray(prior.population.mean)
    drawn = np.random.default_rng(seed).normal(size=(count, root.shape[1]))
    return [prior.coefficients.place(jnp.asarray(mean + root @ w)) for w in drawn]
