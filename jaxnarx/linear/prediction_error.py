"""Prediction-error minimisation: the sum of squared innovations by
Levenberg-Marquardt.

Parameters and the initial states of every record are sought together; C and the F_i
are kept inside the unit circle by rejecting steps that would leave it. The covariance
of the parameters is s^2 (J'J)^-1 with the states eliminated, s^2 the sum of squares
over the degrees of freedom (Ljung 1999, equations (9.54) to (9.56)).
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.arrays.levenberg import AbstractProblem, Levenberg, Linear
from jaxnarx.arrays.minimise import ROUNDING, minimise
from jaxnarx.linear.recursion import (
    Signals,
    best_states,
    normal_equations,
    residuals,
    states,
    steady,
)
from jaxnarx.linear.stability import radius
from jaxnarx.linear.structure import Structure
from jaxnarx.solution import RESULTS

CUT = 1e-12
"""Directions of the initial states with less than this share of the information of the
best known one are taken as known."""


class PredictionErrorProblem(AbstractProblem):
    """Sum of squared innovations by the parameters and behind them all states."""

    def __init__(self, structure: Structure, data: Signals):
        self.structure, self.data = structure, data
        self.records = data.y.shape[0]
        self.size = structure.size + self.records * states(structure)
        self.wall = np.full(self.size, np.inf)
        self.samples = int(np.asarray(data.known).sum())

    def _parts(self, u: np.ndarray):
        count = self.structure.size
        initial = u[count:].reshape(self.records, -1)
        return jnp.asarray(u[:count]), jnp.asarray(initial)

    def _admissible(self, u: np.ndarray) -> bool:
        p = self.structure.split(u[: self.structure.size])
        return all(radius(np.asarray(x)) < 1 for x in (p.c, *p.f))

    def start(self, parameters: np.ndarray) -> np.ndarray:
        """The vector with these parameters and the best states of the records.

        Innovations are linear in the states: one step from records at rest is enough.
        """
        initial = steady(self.structure, parameters, self.data)
        best = best_states(self.structure, parameters, initial, self.data)
        u = np.concatenate([parameters, best.reshape(-1)])
        return u.astype(self.data.y.dtype)

    def loss(self, u: np.ndarray) -> float:
        """The loss; infinite where C or an F_i is not stable."""
        if not self._admissible(u):
            return float("inf")
        e = residuals(self.structure, *self._parts(u), self.data)
        return float(np.sum(np.asarray(e) ** 2))

    def linear(self, u: np.ndarray) -> Linear:
        """The loss and its normal equations, the states of all records assembled."""
        e, slope, gram = map(
            np.asarray, normal_equations(self.structure, *self._parts(u), self.data)
        )
        own, count = states(self.structure), self.structure.size
        g, h = np.zeros(self.size), np.zeros((self.size, self.size))
        for r in range(self.records):
            first = count + r * own
            at = np.concatenate([np.arange(count), first + np.arange(own)])
            g[at] += slope[r]
            h[np.ix_(at, at)] += gram[r]
        return Linear(float(np.sum(e**2)), g, h)


@dataclasses.dataclass(frozen=True)
class Found:
    """Where a search ended. `information` is J'J with the states eliminated."""

    parameters: Float[np.ndarray, " params"]
    initial: Float[np.ndarray, "records states"]
    information: Float[np.ndarray, "params params"]
    loss: float
    steps: int
    samples: int
    freedom: int
    status: RESULTS


def least_innovations(
    structure: Structure,
    starts: list[Float[np.ndarray, " params"]],
    data: Signals,
    *,
    max_steps: int,
    tolerance: float | int,
) -> Found:
    """Search from the start with the smallest loss by its own best states."""
    problem = PredictionErrorProblem(structure, data)
    vectors = [problem.start(np.asarray(s)) for s in starts]
    losses = [problem.loss(u) for u in vectors]
    losses = [loss if np.isfinite(loss) else np.inf for loss in losses]
    u = vectors[int(np.argmin(losses))]
    stepper = Levenberg(problem)
    state, steps, status = minimise(
        stepper,
        stepper.init(u, problem.linear(u), np.zeros(problem.size)),
        steps=max_steps,
        tolerance=tolerance,
        quiet=1,
        rounding=ROUNDING * problem.samples,
    )
    count = structure.size
    freedom = problem.samples - problem.size
    return Found(
        state.u[:count],
        state.u[count:].reshape(problem.records, -1),
        eliminated(state.linear.gram, count),
        state.loss,
        steps,
        problem.samples,
        freedom,
        status,
    )


def eliminated(
    gram: Float[np.ndarray, "all all"], count: int
) -> Float[np.ndarray, "count count"]:
    """Information about the first `count` parameters when the others are free."""
    a, b, c = gram[:count, :count], gram[:count, count:], gram[count:, count:]
    if not c.size:
        return a
    size = np.sqrt(np.diagonal(c))
    unit = 1 / np.where(size > 0, size, 1.0)
    scaled = np.linalg.pinv(c * np.outer(unit, unit), rcond=CUT, hermitian=True)
    return a - b @ (scaled * np.outer(unit, unit)) @ b.T
