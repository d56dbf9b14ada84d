"""Quasi-Newton steps (BFGS, L-BFGS) of a stage, by optimistix.

The loss is minimised in coordinates that start at zero and in which the start's
J'J has a unit diagonal, and is divided by its value there: the solver's absolute
tolerances then mean the same for every network. Gradients are those of the run's own
differentiation rule. One step costs a few runs and a gradient; it needs no P x P
matrix with L-BFGS, and no Jacobian with either.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxnarx.arrays.levenberg import Linear
from jaxnarx.arrays.programs import plain, program, twin
from jaxnarx.refinement.normal import loss
from jaxnarx.refinement.problem import Problem, Restraint
from jaxnarx.solution import RESULTS

TRIALS = 40
"""Trial points of one line search, at most."""
MEMORY = 15
"""Past steps that L-BFGS remembers."""


class Scaled(eqx.Module):
    """The penalised loss in scaled coordinates w: u = origin + w * unit."""

    origin: Float[Array, " params"]
    unit: Float[Array, " params"]
    wall: Float[Array, " params"]
    pull: Float[Array, " params"]
    height: Float[Array, ""]
    data: Any
    restraint: Restraint | None

    @property
    def nameless(self) -> "Scaled":
        """That of the network without names, for programs."""
        return twin(self, data=plain(self.data))

    def place(self, w: Float[Array, " params"]) -> Float[Array, " params"]:
        """Solver coordinates of the layout, inside its walls."""
        return jnp.clip(self.origin + w * self.unit, -self.wall, self.wall)

    def ridge(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """Pull towards the origin."""
        return jnp.sum(self.pull * (u - self.origin) ** 2)

    def penalties(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """Ridge and restraint."""
        if self.restraint is None:
            return self.ridge(u)
        return self.ridge(u) + self.restraint(self.data[0], u)


def scaled(problem: Problem, u, linear: Linear, pull: np.ndarray) -> Scaled:
    """Coordinates of a stage that starts at `u`; entries without effect do not move."""
    diagonal = np.diagonal(linear.gram)
    height = max(linear.loss, float(np.finfo(u.dtype).tiny))
    # A prior alone moves nothing, least of all a parameter that stands still.
    alive = diagonal > 0
    full = np.where(alive, diagonal + pull, 1.0)
    unit = np.where(alive, np.sqrt(height / full), 0.0)
    return Scaled(
        origin=jnp.asarray(u),
        unit=jnp.asarray(unit, u.dtype),
        wall=jnp.asarray(problem.wall, u.dtype),
        pull=jnp.asarray(pull, u.dtype),
        height=jnp.asarray(height, u.dtype),
        data=problem.data,
        restraint=problem.restraint,
    )


def objective(w: Float[Array, " params"], s: Scaled):
    """Penalised loss over its value at the start, and nothing beside it."""
    u = s.place(w)
    layout, *rest = s.data
    value = loss(layout, u, *rest) + s.penalties(u)
    return value / s.height, None


@program
def trial(solver: optx.AbstractMinimiser, w, s: Scaled, inner):
    """One trial of the solver: where it stands, its state, and that in `u`."""
    with jax.numpy_dtype_promotion("standard"):
        w, inner, _ = solver.step(objective, w, s, {}, inner, frozenset())
    return w, inner, s.place(w)


@dataclasses.dataclass(frozen=True)
class State:
    """Where the search stands; `loss` excludes the ridge, `minimised` does not."""

    u: np.ndarray
    loss: float
    minimised: float
    damping: float
    gain: float
    w: Any
    inner: Any


class QuasiNewton:
    """Steps of one stage."""

    def __init__(self, problem: Problem, *, limited_memory: bool):
        self.problem = problem
        if limited_memory:
            self.solver = optx.LBFGS(rtol=1e-9, atol=1e-9, history_length=MEMORY)
        else:
            self.solver = optx.BFGS(rtol=1e-9, atol=1e-9)

    def init(self, u: np.ndarray, linear: Linear, pull: np.ndarray) -> State:
        """Set up at `u`, where the loss is `linear`."""
        self.scaled = scaled(self.problem, u, linear, pull)
        w = jnp.zeros_like(self.scaled.origin)
        struct = jax.ShapeDtypeStruct((), w.dtype)
        with jax.numpy_dtype_promotion("standard"):
            inner = self.solver.init(
                objective, w, self.scaled, {}, struct, None, frozenset()
            )
        return State(u, linear.loss, linear.loss, 0.0, np.inf, w, inner)

    def step(self, s: State) -> tuple[State, RESULTS]:
        """One accepted step; `stalled` when a line search finds no lower point."""
        w, inner = s.w, s.inner
        before = int(inner.num_accepted_steps)
        for _ in range(TRIALS):
            w, inner, u = trial(self.solver, w, self.scaled, inner)
            # The solver's first trial only evaluates its start.
            if int(inner.num_accepted_steps) > max(before, 1):
                u = np.asarray(u)
                value = self.problem.loss(u)
                if not np.isfinite(value):
                    return s, RESULTS.diverged
                total = value + float(self.scaled.ridge(jnp.asarray(u)))
                gain = 1.0 - total / s.minimised if s.minimised > 0 else 0.0
                return State(u, value, total, 0.0, gain, w, inner), RESULTS.ok
            if bool(inner.terminate):
                return s, RESULTS.ok
        return s, RESULTS.stalled

    def arrived(self, s: State) -> bool:
        """Whether no step promises a decrease any more."""
        return bool(s.inner.terminate)
