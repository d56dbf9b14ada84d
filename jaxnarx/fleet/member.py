"""An engine as a member of a population: its records, and what is known of it then."""

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset
from jaxnarx.fleet.climb import Climb, climb, sums_about
from jaxnarx.fleet.information import Information, parts_of, skip_begin
from jaxnarx.fleet.population import Posterior, posterior, root_of
from jaxnarx.fleet.prior import FleetPrior
from jaxnarx.simulation import Prepared, prepare


def prepare_member(prior: FleetPrior, data: Dataset) -> Prepared:
    """Records of an engine without their first samples, see `skip_begin`."""
    return skip_begin(prepare(prior.network, data), prior.warm_up)


def sum_records(prior: FleetPrior, data: Dataset) -> Information:
    """Sums of records, told about the population's mean."""
    runs = prepare_member(prior, data)
    at = find_member(prior, runs)
    return sums_about(prior.coefficients, at, runs, parts_of(runs, ()), 1).total()


def find_member(prior: FleetPrior, runs: Prepared) -> Float[np.ndarray, " params"]:
    """Coefficients that sums are expanded about: the population's mean, or where runs
    are not linear in them the most probable ones."""
    population = prior.population
    mean = np.zeros(len(prior.coefficients.free))
    if prior.linear:
        return mean
    part = jax.device_put(parts_of(runs, ()))
    root, colour = root_of(population.covariance), np.asarray(population.colour)
    drawn = Climb(np.asarray(population.mean), root, colour)
    return climb(prior.coefficients, runs, part, drawn, mean)


def know_member(prior: FleetPrior, sums: Information) -> Posterior:
    """Mean and covariance of an engine's coefficients, from sums about the mean."""
    population = prior.population
    mean = np.asarray(population.mean)
    root = root_of(population.covariance)
    zero = np.zeros(len(root))
    found = posterior(sums, zero, np.asarray(population.precision), mean, root)
    return Posterior(*map(np.asarray, found))
