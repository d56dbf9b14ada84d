"""Steps of a stage by any solver of optimistix, for a minimum or for least squares.

The loss is minimised in coordinates that start at zero and in which the start's
J'J has a unit diagonal, and is divided by its value there: the solver's absolute
tolerances then mean the same for every network. Derivatives are those of the run's own
differentiation rule. A solver for least squares sees an error of every sample, and
stores what it needs of their Jacobian; the house's Levenberg-Marquardt does not.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxnarx.arrays import Levenberg, LevenbergState, Standing
from jaxnarx.refinement.problem import Problem

TRIALS = 40
"""Steps of a solver without a new point, at most."""


class ScaledLoss(eqx.Module):
    """The penalised loss in scaled coordinates w: u = origin + w * unit."""

    problem: Problem
    origin: Float[Array, " params"]
    unit: Float[Array, " params"]
    pull: Float[Array, " params"]
    height: Float[Array, ""]

    def place(self, w: Float[Array, " params"]) -> Float[Array, " params"]:
        """Solver coordinates of the layout, inside its walls."""
        wall = self.problem.wall
        return jnp.clip(self.origin + w * self.unit, -wall, wall)

    def ridge(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """Pull towards the origin."""
        return jnp.sum(self.pull * (u - self.origin) ** 2)


def scaled(problem: Problem, s: LevenbergState) -> ScaledLoss:
    """Coordinates of a stage that starts there."""
    return ScaledLoss(problem, jnp.asarray(s.u), *_units(s))


@jax.jit
def _units(s: LevenbergState):
    """Units and pull of the entries, and the height; what has no effect does not
    move."""
    diagonal = jnp.diagonal(s.linear.gram)
    height = jnp.maximum(s.linear.loss, jnp.finfo(diagonal.dtype).tiny)
    # A prior alone moves nothing, least of all a parameter that stands still.
    alive = diagonal > 0
    full = jnp.where(alive, diagonal + s.pull, 1.0)
    return jnp.where(alive, jnp.sqrt(height / full), 0.0), s.pull, height


def objective(w: Float[Array, " params"], s: ScaledLoss):
    """Penalised loss over its value at the start, and nothing beside it."""
    u = s.place(w)
    return (s.problem.loss(u) + s.ridge(u)) / s.height, None


def errors(w: Float[Array, " params"], s: ScaledLoss):
    """What the objective is the sum of squares of, and nothing beside it.

    Entries that do not move are held where they are: a Jacobian with empty columns
    would be singular.
    """
    u, height = s.place(w), jnp.sqrt(s.height)
    pulled = jnp.sqrt(s.pull) * (u - s.origin) / height
    still = jnp.where(s.unit > 0, 0.0, w)
    return (s.problem.roots(u) / height, pulled, still), None


@eqx.filter_jit
def trial(solver: Any, function: Any, w, s: ScaledLoss, inner):
    """One step of the solver: where it stands, its state, that in `u`, and whether it
    has moved, and whether it is done."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        new, inner, _ = solver.step(function, w, s, {}, inner, frozenset())
        done, _ = solver.terminate(function, new, s, {}, inner, frozenset())
    return new, inner, s.place(new), jnp.any(new != w), done


@eqx.filter_jit
def _reached(s: ScaledLoss, judge, u):
    value = s.problem.loss(u)
    return value, value + s.ridge(u), judge(u)


def reached(s: ScaledLoss, judge, u: Array, before: Standing, state) -> Standing:
    """Where a step has led that is taken, whatever it has gained."""
    value, total, judged = jax.device_get(_reached(s, judge, u))
    status = "ok" if np.isfinite(value) else "diverged"
    if status == "diverged":
        return dataclasses.replace(before, status=status)
    value, total = value.item(), total.item()
    gain = 1.0 - total / before.minimised if before.minimised > 0 else 0.0
    return Standing(np.asarray(u), value, total, state, gain=gain, judged=judged)


class AnySolver:
    """Steps of one stage, from where Levenberg-Marquardt has taken stock."""

    def __init__(self, stage: Levenberg, s: Standing, solver: Any):
        self.judge, self.solver = stage.judge, solver
        least = isinstance(solver, optx.AbstractLeastSquaresSolver)
        self.function = errors if least else objective
        self.scaled = scaled(stage.problem, s.state)
        w = jnp.zeros_like(self.scaled.origin)
        self.start = dataclasses.replace(
            s, state=(w, self._begin(w), False), damping=0.0
        )

    def _begin(self, w: Array) -> Any:
        """The solver's state before its first step."""

        @eqx.filter_jit
        def begin(solver, w, s):
            shape, _ = jax.eval_shape(self.function, w, s)
            with jax.numpy_dtype_promotion("standard"):
                return solver.init(self.function, w, s, {}, shape, None, frozenset())

        return begin(self.solver, w, self.scaled)

    def step(self, s: Standing) -> Standing:
        """One accepted step; `stalled` when the solver finds no other point."""
        w, inner, _ = s.state
        for _ in range(TRIALS):
            new = trial(self.solver, self.function, w, self.scaled, inner)
            w, inner, u, moved, done = new
            if bool(moved):
                return reached(self.scaled, self.judge, u, s, (w, inner, bool(done)))
            if bool(done):
                return dataclasses.replace(s, status="stalled", state=(w, inner, True))
        return dataclasses.replace(s, status="stalled")

    def has_arrived(self, s: Standing) -> bool:
        """Whether the solver says that it is done."""
        return bool(s.state[2])
