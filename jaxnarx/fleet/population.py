"""A population of engines: mean and covariance of coefficients, learnt from donors.

Coefficients of engine e are drawn from a normal distribution, v_e ~ N(mu, Sigma), and
its outputs are those of its free run with noise of variance s_o^2, output by output.
With the sums of `information` the posterior of one engine is a small solve, and mu,
Sigma and s_o^2 are those of the EM algorithm: N. M. Laird, J. H. Ware, Random-effects
models for longitudinal data, Biometrics 38 (1982) 963-974, section 4. Residuals of
engine models are coloured: as many samples tell as much as one, and sums count that
much less, or coefficients would seem known by which donors fit their residuals. About a
network whose run is not linear in its coefficients this is Laplace's approximation.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.arrays import program
from jaxnarx.fleet.information import Arrays, Information

SHRINKAGE_ENGINES = 2.0
"""Engines whose coefficients are independent of one another that the covariance counts
among its donors: few donors leave it singular."""
LEAST_VARIANCE = 1e-10
"""Variance that every coefficient has at least."""
STEPS = 40
"""Steps of the EM algorithm at most ..."""
SETTLED_SHARE = 1e-3
"""... and the share by which the largest spread, and the noise, still move at its
end."""


DonorChunk = tuple[Information, Any, Any]
"""Sums of some donors, the coefficients they are about, and weights."""


class Population(eqx.Module):
    """What engines have in common; coefficients in units of `FleetCoefficients`."""

    mean: Float[Array, " params"]
    covariance: Float[Array, "params params"]
    noise: Float[Array, " outputs"]
    """Variance of what is left of every output, scaled by its gain."""
    colour: Float[Array, " outputs"]
    """Samples of that which tell as much as one that is independent."""

    @property
    def precision(self) -> Float[Arrays, " outputs"]:
        """1 over the variance of every output's noise, as many times less as it is
        coloured."""
        return 1.0 / (self.noise * self.colour)


class Posterior(NamedTuple):
    """Coefficients of engines after their records were seen."""

    mean: Float[Arrays, "*many params"]
    covariance: Float[Arrays, "*many params params"]


@program
def posterior(
    information: Information,
    at: Float[Array, " params"],
    precision: Float[Array, " outputs"],
    mean: Float[Array, " params"],
    root: Float[Array, "params rank"],
) -> Posterior:
    """Coefficients of an engine whose prior is N(mean, root root').

    `information` is that about `at`; `precision` is 1 over the variance of every
    output's noise. In the coordinates of `root`, so that it may be singular.
    """
    gram = jnp.einsum("opq,o->pq", information.gram, precision)
    right = jnp.einsum("op,o->p", information.right, precision) - gram @ (at - mean)
    inner = jnp.eye(root.shape[1], dtype=root.dtype) + root.T @ gram @ root
    factor = jax.scipy.linalg.cho_factor(inner, lower=True)
    moved = mean - root @ jax.scipy.linalg.cho_solve(factor, root.T @ right)
    half = jax.scipy.linalg.solve_triangular(factor[0], root.T, lower=True)
    return Posterior(moved, half.T @ half)


class PassMoments(NamedTuple):
    """What one pass over donors leaves: sums for the next step, figures of each."""

    weight: float
    first: Float[np.ndarray, " params"]
    second: Float[np.ndarray, "params params"]
    error: Float[np.ndarray, " outputs"]
    samples: Float[np.ndarray, " outputs"]
    mean: Float[np.ndarray, "engines params"]
    left: Float[np.ndarray, "engines outputs"]


def expect(
    information: Information,
    at: Float[np.ndarray, "engines params"],
    weight: Float[np.ndarray, " engines"],
    population: Population,
    root: Float[np.ndarray, "params rank"],
) -> PassMoments:
    """Posterior moments of engines, and their sums with these weights.

    As `posterior`, by LAPACK for all at once: on a CPU many small factorisations in one
    program took several times as long.
    """
    square, right, gram, samples = map(np.asarray, information)
    precision, mean = np.asarray(population.precision), np.asarray(population.mean)
    whole = np.einsum("eopq,o->epq", gram, precision)
    slope = np.einsum("eop,o->ep", right, precision)
    slope = slope - np.einsum("epq,eq->ep", whole, at - mean)
    inner = np.eye(root.shape[1]) + root.T @ whole @ root
    half = np.linalg.solve(inner, np.broadcast_to(root.T, (len(at), *root.T.shape)))
    covariance = root @ half
    far = -np.einsum("epq,eq->ep", covariance, slope)
    step = mean + far - at
    bent = np.einsum("eopq,eq->eop", gram, step)
    error = square + np.einsum("eop,ep->eo", 2 * right + bent, step)
    spread = np.einsum("eopq,epq->eo", gram, covariance)
    second = (far * weight[:, None]).T @ far + np.tensordot(weight, covariance, 1)
    return PassMoments(
        float(weight.sum()),
        weight @ far,
        second,
        weight @ (error + spread),
        weight @ samples,
        mean + far,
        np.maximum(error, 0.0) / np.maximum(samples, 1.0),
    )


def begin_population(
    information: Information,
    at: Float[np.ndarray, "engines params"],
    colour: Float[np.ndarray, " outputs"],
) -> Population:
    """A population to begin with: coefficients of its members are the same but for a
    tenth of a standard deviation of the output, all alike."""
    samples = np.maximum(np.asarray(information.samples), 1.0)
    noise = np.median(np.asarray(information.square) / samples, axis=0) / 4
    noise = np.maximum(noise, LEAST_VARIANCE)
    mean = np.median(at, axis=0)
    covariance = 0.01 * np.eye(len(mean))
    return Population(*map(jnp.asarray, (mean, covariance, noise, colour)))


def root_of(covariance: Float[Arrays, "params params"]) -> np.ndarray:
    """R with R R' the covariance."""
    value, vector = np.linalg.eigh(np.asarray(covariance))
    return vector * np.sqrt(np.maximum(value, 0.0))


def fit_population(
    chunks: Sequence[DonorChunk],
    population: Population,
    steps: int = STEPS,
) -> tuple[Population, Float[np.ndarray, "engines params"], np.ndarray]:
    """The population of donors by the EM algorithm, from chunks of their sums, places
    and weights; the coefficients of all; and what is left of every output."""
    means, left = np.zeros((0, 0)), np.zeros((0, 0))
    for _ in range(steps):
        root = root_of(np.asarray(population.covariance))
        found = [expect(*chunk, population, root) for chunk in chunks]
        before, population = population, _maximise(population, found)
        means = np.concatenate([f.mean for f in found])
        left = np.concatenate([f.left for f in found])
        if _is_settled(before, population):
            break
    return population, means, left


def _is_settled(before: Population, after: Population) -> bool:
    """Whether a step moved the spreads of the coefficients and the noise by little."""

    def spread(one: Population) -> np.ndarray:
        return np.sqrt(np.diag(np.asarray(one.covariance)))

    moved = np.abs(spread(after) - spread(before)).max() / spread(after).max()
    noise = np.asarray(after.noise) / np.asarray(before.noise)
    return bool(moved < SETTLED_SHARE and np.abs(noise - 1).max() < SETTLED_SHARE)


def _maximise(population: Population, found: list[PassMoments]) -> Population:
    """The population that is most likely under these moments."""
    count = max(sum(f.weight for f in found), 1e-12)
    move = np.sum([f.first for f in found], axis=0) / count
    second = np.sum([f.second for f in found], axis=0) / count - np.outer(move, move)
    alone = np.diag(np.diag(second))
    share = SHRINKAGE_ENGINES / (count + SHRINKAGE_ENGINES)
    covariance = (1 - share) * second + share * alone
    covariance = (covariance + covariance.T) / 2 + LEAST_VARIANCE * np.eye(len(alone))
    error = np.sum([f.error for f in found], axis=0)
    samples = np.maximum(np.sum([f.samples for f in found], axis=0), 1e-12)
    noise = np.maximum(error / samples, LEAST_VARIANCE)
    mean = np.asarray(population.mean) + move
    mean, covariance, noise = map(jnp.asarray, (mean, covariance, noise))
    return Population(mean, covariance, noise, population.colour)
