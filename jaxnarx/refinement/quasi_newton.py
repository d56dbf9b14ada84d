"""Quasi-Newton steps (BFGS, L-BFGS) of a stage, by optimistix.

The loss is minimised in coordinates that start at zero and in which the start's
J'J has a unit diagonal, and is divided by its value there: the solver's absolute
tolerances then mean the same for every network. Gradients are those of the run's own
differentiation rule. One step costs a few runs and a gradient; it needs no P x P
matrix with L-BFGS, and no Jacobian with either.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxnarx.arrays.levenberg import State
from jaxnarx.arrays.minimise import Levenberg, Standing
from jaxnarx.refinement.problem import Problem

TRIALS = 40
"""Trial points of one line search, at most."""
MEMORY = 15
"""Past steps that L-BFGS remembers."""


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


def scaled(problem: Problem, s: State) -> ScaledLoss:
    """Coordinates of a stage that starts there."""
    return ScaledLoss(problem, jnp.asarray(s.u), *_units(s))


@jax.jit
def _units(s: State):
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


@eqx.filter_jit
def trial(solver: optx.AbstractMinimiser, w, s: ScaledLoss, inner):
    """One trial of the solver: where it stands, its state, and that in `u`."""
    with jax.numpy_dtype_promotion("standard"):
        w, inner, _ = solver.step(objective, w, s, {}, inner, frozenset())
    return w, inner, s.place(w)


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


class QuasiNewton:
    """Steps of one stage, from where Levenberg-Marquardt has taken stock."""

    def __init__(self, stage: Levenberg, s: Standing, *, limited_memory: bool):
        self.judge = stage.judge
        if limited_memory:
            self.solver = optx.LBFGS(rtol=1e-9, atol=1e-9, history_length=MEMORY)
        else:
            self.solver = optx.BFGS(rtol=1e-9, atol=1e-9)
        self.scaled = scaled(stage.problem, s.state)
        w = jnp.zeros_like(self.scaled.origin)
        struct = jax.ShapeDtypeStruct((), w.dtype)
        with jax.numpy_dtype_promotion("standard"):
            inner = self.solver.init(
                objective, w, self.scaled, {}, struct, None, frozenset()
            )
        self.start = dataclasses.replace(s, state=(w, inner), damping=0.0)

    def step(self, s: Standing) -> Standing:
        """One accepted step; `stalled` when a line search finds no lower point."""
        w, inner = s.state
        before = int(inner.num_accepted_steps)
        for _ in range(TRIALS):
            w, inner, u = trial(self.solver, w, self.scaled, inner)
            # The solver's first trial only evaluates its start.
            if int(inner.num_accepted_steps) > max(before, 1):
                return reached(self.scaled, self.judge, u, s, (w, inner))
            if bool(inner.terminate):
                return s
        return dataclasses.replace(s, status="stalled")

    def has_arrived(self, s: Standing) -> bool:
        """Whether no step promises a decrease any more."""
        return bool(s.state[1].terminate)
