"""The verb `plan`: which seconds of a new engine tell most about it."""

import dataclasses
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import Number, Pair
from jaxnarx.design import (
    TestPlan,
    asked_samples,
    limits_for,
    make_view,
    plan_by,
)
from jaxnarx.errors import SpecError
from jaxnarx.fleet.coefficients import FleetCoefficients
from jaxnarx.fleet.population import root_of
from jaxnarx.fleet.prior import FleetPrior
from jaxnarx.models import Network
from jaxnarx.solution import Solution

LEAST_SHARE = 1e-4
"""Directions of the population with a smaller share of the largest deviation are left
out."""


class AlongPopulation(eqx.Module):
    """An engine so many deviations from the mean of its fleet, in every direction."""

    coefficients: FleetCoefficients
    root: Float[Array, "params directions"]

    def __call__(self, w: Float[Array, " directions"]) -> Network:
        """The network of that engine."""
        return self.coefficients.place(self.root @ w)


@guard_arguments
def plan(
    prior: FleetPrior,
    *,
    duration: float | int,
    ranges: Mapping[str, Pair] | None = None,
    rates: Mapping[str, Number] | None = None,
    forbidden: Sequence[str] = (),
    limits: Mapping[str, Number | Pair] | None = None,
    hold: Pair | None = None,
    seed: int = 0,
) -> Solution[TestPlan]:
    """The test of this length that tells most about a new engine of a fleet.

    As `jnx.design.plan`, but what is asked is in which direction, and by how much, the
    engine lies from the mean of its fleet: every stretch adds most to log det(1 + R'R),
    R the derivatives of the free run by the deviations of the population, over the
    noise of its donors (Bayesian D-optimality: K. Chaloner, I. Verdinelli, Statistical
    Science 10, 1995, 273-304). Noise counts as coloured as the donors' is.

    Args:
        prior: What was learnt from the fleet.
        duration: Length of the test [s], behind `prior.warm_up` samples at its first
            levels, which `calibrate` does not count.
        ranges, rates, forbidden, limits, hold, seed: As for `jnx.design.plan`.

    Returns:
        `value` is the `TestPlan`. `stats` as of `jnx.design.plan`, and `learnt`, the
        share of the population's variance that the test is expected to remove.

    Raises:
        SpecError: no operating point is allowed, the prior's network has no domain, or
            engines do not differ.

    Example:
        prior = jnx.fleet.learn({"one": data, "other": data}, network).value
        found = jnx.fleet.plan(prior, duration=10)
        print(found.stats["learnt"], found.value.inputs.shape)
    """
    network, own = prior.network, prior.population
    kept = limits_for(network, ranges, rates, forbidden, limits)
    root = root_of(np.asarray(own.covariance))
    size = np.sqrt((root**2).sum(axis=0))
    if not size.max(initial=0.0) > 0:
        raise SpecError("the engines of this fleet do not differ", field="prior")
    root = root[:, size > LEAST_SHARE * size.max(initial=0.0)]
    along = AlongPopulation(prior.coefficients, jnp.asarray(root))
    gain = np.asarray(network.gain)[list(network.signals[: len(network.modelled)])]
    variance = np.asarray(own.noise) * np.maximum(np.asarray(own.colour), 1.0)

    def view(space, reference, lead, size):
        del reference, lead
        # So many rows stand for all samples of a stretch.
        noise = gain * np.sqrt(variance * asked_samples(size) / size)
        return make_view(network, along, root.shape[1], noise, space)

    found = plan_by(network, view, kept, duration, hold, seed, prior.warm_up)
    left = np.trace(root @ np.linalg.solve(found.stats["known"], root.T))
    whole = np.trace(root @ root.T)
    learnt = float(1 - left / whole)
    detail = f"{found.detail}; {100 * learnt:.0f} % of the spread of the fleet removed"
    return dataclasses.replace(
        found, stats={**found.stats, "learnt": learnt}, detail=detail
    )
