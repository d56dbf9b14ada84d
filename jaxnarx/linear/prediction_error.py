"""Prediction-error minimisation: the sum of squared innovations by
Levenberg-Marquardt.

Parameters and the initial states of every record are sought together; C and the F_i
are kept inside the unit circle by rejecting steps that would leave it. The covariance
of the parameters is s^2 (J'J)^-1 with the states eliminated, s^2 the sum of squares
over the degrees of freedom (Ljung 1999, equations (9.54) to (9.56)).
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.arrays import (
    ROUNDING_LOSS,
    AbstractProblem,
    Driver,
    Levenberg,
    Linear,
    StoppingRules,
    begin_levenberg,
    begin_search,
    has_stable_roots,
)
from jaxnarx.linear.recursion import (
    Signals,
    best_states,
    normal_equations,
    residuals,
    states,
    steady,
)
from jaxnarx.linear.structure import Structure
from jaxnarx.solution import RESULTS

LEAST_INFORMATION_SHARE = 1e-12
"""Directions of the initial states with less than this share of the information of the
best known one are taken as known."""


class PredictionErrorProblem(AbstractProblem):
    """Sum of squared innovations by the parameters and behind them all states."""

    structure: Structure = eqx.field(static=True)
    data: Signals

    @property
    def wall(self) -> Float[Array, " params"]:
        """Nothing is bounded."""
        records = self.data.y.shape[0]
        size = self.structure.size + records * states(self.structure)
        return jnp.full(size, jnp.inf, self.data.y.dtype)

    def _parts(self, u: Float[Array, " params"]):
        count = self.structure.size
        return u[:count], u[count:].reshape(self.data.y.shape[0], -1)

    def is_admissible(self, u: Float[Array, " params"]) -> Bool[Array, ""]:
        """Whether C and all F_i are stable."""
        p = self.structure.split(u[: self.structure.size])
        parts = (p.c, *p.f)
        return jnp.all(jnp.stack([has_stable_roots(jnp.asarray(x)) for x in parts]))

    def _reject_inadmissible(self, u, loss: Float[Array, ""]) -> Float[Array, ""]:
        return jnp.where(self.is_admissible(u), loss, jnp.inf)

    def loss(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """The loss; infinite where C or an F_i is not stable."""
        e = residuals(self.structure, *self._parts(u), self.data)
        return self._reject_inadmissible(u, jnp.sum(e**2))

    def linear(self, u: Float[Array, " params"]) -> Linear:
        """The loss and its normal equations, the states of all records assembled."""
        e, slope, gram = normal_equations(self.structure, *self._parts(u), self.data)
        count, own = self.structure.size, states(self.structure)
        records, size = len(gram), u.shape[0]
        gradient = [jnp.sum(slope[:, :count], axis=0), slope[:, count:].reshape(-1)]
        across = jnp.moveaxis(gram[:, :count, count:], 0, 1).reshape(count, -1)
        each = jnp.arange(records)
        among = jnp.zeros((records, own, records, own), gram.dtype)
        among = among.at[each, :, each].set(gram[:, count:, count:])
        among = among.reshape(size - count, size - count)
        shared = jnp.sum(gram[:, :count, :count], axis=0)
        whole = jnp.block([[shared, across], [across.T, among]])
        loss = self._reject_inadmissible(u, jnp.sum(e**2))
        return Linear(u, loss, jnp.concatenate(gradient), whole)

    def pull(self, start: Linear) -> Float[Array, " params"]:
        """None: the data alone speak."""
        return jnp.zeros_like(start.gradient)


def start_vector(
    structure: Structure, parameters: Float[np.ndarray, " params"], data: Signals
) -> Float[np.ndarray, " all"]:
    """The vector with these parameters and the best states of the records.

    Innovations are linear in the states: one step from records at rest is enough.
    """
    initial = steady(structure, parameters, data)
    best = best_states(structure, parameters, initial, data)
    return np.concatenate([parameters, best.reshape(-1)]).astype(data.y.dtype)


@dataclasses.dataclass(frozen=True)
class PredictionErrorEnd:
    """The end of a search. `information` is J'J with the states eliminated."""

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
) -> PredictionErrorEnd:
    """Search from the start with the smallest loss by its own best states."""
    samples = int(np.asarray(data.known).sum())
    rules = StoppingRules(tolerance, quiet=1, rounding=ROUNDING_LOSS * samples)
    driver = Driver(Levenberg(PredictionErrorProblem(structure, data)), None, rules)
    places, losses = [], []
    for start in starts:
        u = start_vector(structure, np.asarray(start), data)
        place, begun = driver.start(begin_search(begin_levenberg(u)))
        places.append(place)
        losses.append(begun.loss if np.isfinite(begun.loss) else np.inf)
    end, status = driver.minimise(places[int(np.argmin(losses))], max_steps)
    u, linear = np.asarray(end.state.u), end.state.linear
    count = structure.size
    return PredictionErrorEnd(
        u[:count],
        u[count:].reshape(data.y.shape[0], -1),
        eliminate(np.asarray(linear.gram), count),
        float(linear.loss),
        int(end.steps),
        samples,
        samples - u.size,
        status,
    )


def eliminate(
    gram: Float[np.ndarray, "all all"], count: int
) -> Float[np.ndarray, "count count"]:
    """Information about the first `count` parameters when the others are free."""
    a, b, c = gram[:count, :count], gram[:count, count:], gram[count:, count:]
    if not c.size:
        return a
    size = np.sqrt(np.diagonal(c))
    unit = 1 / np.where(size > 0, size, 1.0)
    scaled = np.linalg.pinv(
        c * np.outer(unit, unit), rcond=LEAST_INFORMATION_SHARE, hermitian=True
    )
    return a - b @ (scaled * np.outer(unit, unit)) @ b.T
