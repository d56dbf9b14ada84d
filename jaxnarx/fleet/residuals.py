"""Colour of what a model leaves: how many samples tell as much as one."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.arrays import program
from jaxnarx.fleet.coefficients import FleetCoefficients
from jaxnarx.simulation import Prepared, scaled_run

LONGEST_LAG = 200
"""Lags over which correlations are summed at most."""


@program
def run_errors(
    coefficients: FleetCoefficients, v: Float[Array, " params"], runs: Prepared
) -> Float[Array, "records time outputs"]:
    """Errors of the free run, scaled; zero where no sample counts."""
    outputs = runs.scored.shape[-1]
    run = scaled_run(coefficients.place(v), runs)
    error = run[..., :outputs] - runs.drive.measured[..., :outputs]
    return jnp.where(runs.scored, error, 0.0)


def colour_of(
    coefficients: FleetCoefficients, v: Float[np.ndarray, " params"], runs: Prepared
) -> Float[np.ndarray, " outputs"]:
    """1 + 2 sum_k rho_k of the errors, up to the first correlation below zero: the
    samples that weigh as much as one of white noise (M. S. Bartlett, J. R. Stat. Soc. B
    8, 1946)."""
    error = np.asarray(run_errors(coefficients, v, runs))
    counted = np.asarray(runs.scored)
    found = []
    for o in range(error.shape[2]):
        mean = error[..., o][counted[..., o]].mean() if counted[..., o].any() else 0.0
        e = np.where(counted[..., o], error[..., o] - mean, 0.0)
        size = 2 * e.shape[1]
        power = np.abs(np.fft.rfft(e, size, axis=1)) ** 2
        rho = np.fft.irfft(power, size, axis=1).sum(axis=0)[: LONGEST_LAG + 1]
        if not rho[0] > 0:
            found.append(1.0)
            continue
        rho = rho / rho[0]
        below = np.flatnonzero(rho < 0)
        stop = int(below[0]) if len(below) else len(rho)
        found.append(float(1 + 2 * rho[1:stop].sum()))
    return np.array(found)
