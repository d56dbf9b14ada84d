"""Coefficients of an engine whose free run is not linear in them.

In w, with v = mean + root w and w ~ N(0, 1), the most probable coefficients minimise

    sum_o N_o / (2 tau_o) log(s_o / N_o) + w'w / 2 ,

s_o the squared error of the free run, N_o its samples, of which tau_o tell as much as
one: the variance of the noise is estimated beside them. Or, with that variance given,
sum_o s_o / (2 sigma_o^2) + w'w / 2. By Levenberg's and Marquardt's damped Gauss-Newton
steps (D. W. Marquardt, J. SIAM 11, 1963, 431-441).
"""

import dataclasses

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.fleet.coefficients import FleetCoefficients
from jaxnarx.fleet.information import Information, gather_information
from jaxnarx.simulation import Prepared

STEPS = 40
"""Runs at most."""
LEAST_GAIN = 0.01
"""Gain in probability, as a logarithm, below which a step is the last."""
DAMPING, LESS, MORE, MOST = 1e-2, 5.0, 6.0, 1e6
"""Damping at first, by what it falls and rises, and where nothing helps."""


@dataclasses.dataclass(frozen=True, eq=False)
class Climb:
    """What an engine's coefficients are drawn from, and how its errors count.

    `count` divides samples: `colour` of the noise, or its variance where that is known.
    """

    mean: Float[np.ndarray, " params"]
    root: Float[np.ndarray, "params rank"]
    count: Float[np.ndarray, " outputs"]
    known_noise: bool = False

    def objective(self, sums: Information, w: np.ndarray) -> float:
        """What is minimised; infinite where the run leaves all bounds."""
        square, samples = map(np.asarray, (sums.square, sums.samples))
        if not (np.all(np.isfinite(square)) and np.all(np.isfinite(sums.gram))):
            return np.inf
        if self.known_noise:
            loss = square / self.count
        else:
            mean = np.maximum(square, 1e-300) / np.maximum(samples, 1.0)
            loss = samples / self.count * np.log(mean)
        return float(loss.sum() / 2 + w @ w / 2)

    def precision(self, sums: Information) -> Float[np.ndarray, " outputs"]:
        """1 over the variance of every output's noise."""
        if self.known_noise:
            return 1.0 / self.count
        square = np.maximum(np.asarray(sums.square), 1e-300)
        return np.asarray(sums.samples) / square / self.count


def climb(
    own: FleetCoefficients,
    runs: Prepared,
    part: Int[Array, "records time"],
    drawn: Climb,
    start: Float[np.ndarray, " params"],
    steps: int = STEPS,
) -> Float[np.ndarray, " params"]:
    """The most probable coefficients near a start, from the samples whose part is 0."""

    def sums_at(w):
        found = gather_information(own, drawn.mean + drawn.root @ w, runs, part, 1)
        return Information(*map(np.asarray, found)).total()

    w = np.linalg.lstsq(drawn.root, start - drawn.mean, rcond=None)[0]
    sums, damping = sums_at(w), DAMPING
    best = drawn.objective(sums, w)
    if not np.isfinite(best):
        return start
    for _ in range(steps):
        precision = drawn.precision(sums)
        gram = np.einsum("opq,o->pq", sums.gram, precision)
        hessian = drawn.root.T @ gram @ drawn.root + np.eye(len(w))
        slope = drawn.root.T @ (precision @ np.asarray(sums.right)) + w
        damped = hessian + damping * np.diag(np.diag(hessian))
        moved = w - np.linalg.solve(damped, slope)
        after = sums_at(moved)
        new = drawn.objective(after, moved)
        if new < best:
            gain = best - new
            w, sums, best, damping = moved, after, new, damping / LESS
            if gain < LEAST_GAIN:
                break
        else:
            damping *= MORE
            if damping > MOST:
                break
    return drawn.mean + drawn.root @ w


def sums_about(
    own: FleetCoefficients,
    v: Float[np.ndarray, " params"],
    runs: Prepared,
    part: Int[np.ndarray, "records time"],
    parts: int,
) -> Information:
    """Sums by part, expanded about `v` and told about zero; host."""
    found = gather_information(own, v, runs, jax.device_put(part), parts)
    found = Information(*map(np.asarray, found))
    return found.shift(-v) if np.any(v) else found
