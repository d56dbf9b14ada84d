"""An engine as a member of a population: its records, and what is known of it then."""

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset
from jaxnarx.fleet.information import (
    Information,
    gather_information,
    parts_of,
    skip_begin,
)
from jaxnarx.fleet.population import Posterior, posterior, root_of
from jaxnarx.fleet.prior import FleetPrior
from jaxnarx.simulation import Prepared, prepare


def prepare_member(prior: FleetPrior, data: Dataset) -> Prepared:
    """Records of an engine without their first samples, see `skip_begin`."""
    return skip_begin(prepare(prior.network, data), prior.warm_up)


def sum_records(prior: FleetPrior, data: Dataset) -> Information:
    """Sums of records about the population's mean."""
    runs = prepare_member(prior, data)
    part = jax.device_put(parts_of(runs, ()))
    zero = np.zeros(len(prior.coefficients.free))
    found = gather_information(prior.coefficients, zero, runs, part, 1)
    return Information(*map(np.asarray, found)).total()


def coloured_precision(prior: FleetPrior) -> Float[np.ndarray, " outputs"]:
    """1 over the variance of every output's noise, as many times less as it is
    coloured."""
    population = prior.population
    return 1.0 / (np.asarray(population.noise) * np.asarray(population.colour))


def know_member(prior: FleetPrior, sums: Information) -> Posterior:
    """Mean and covariance of an engine's coefficients, from sums about the mean."""
    population = prior.population
    mean = np.asarray(population.mean)
    root = root_of(population.covariance)
    zero = np.zeros(len(root))
    found = posterior(sums, zero, coloured_precision(prior), mean, root)
    return Posterior(*map(np.asarray, found))
