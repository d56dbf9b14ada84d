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
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import (
    DIVERGED,
    OK,
    STALLED,
    AbstractMethod,
    AbstractState,
    LevenbergState,
    program,
    select_tree,
    strip_names,
    twin,
)
from jaxnarx.refinement.problem import Problem

IDLE_STEPS = 40
"""Steps of a solver without a new point, at most."""


class ScaledLoss(eqx.Module):
    """The penalised loss in scaled coordinates w: u = origin + w * unit."""

    problem: Problem
    origin: Float[Array, " params"]
    unit: Float[Array, " params"]
    pull: Float[Array, " params"]
    height: Float[Array, ""]

    @property
    def nameless(self) -> "ScaledLoss":
        """The same loss without names of channels, for programs."""
        return twin(self, problem=strip_names(self.problem))

    def place(self, w: Float[Array, " params"]) -> Float[Array, " params"]:
        """Solver coordinates of the layout, inside its walls."""
        wall = self.problem.wall
        return jnp.clip(self.origin + w * self.unit, -wall, wall)

    def ridge(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """Pull towards the origin."""
        return jnp.sum(self.pull * (u - self.origin) ** 2)


def scale_coordinates(problem: Problem, s: LevenbergState) -> ScaledLoss:
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
    """The errors whose sum of squares is the objective, and nothing beside it.

    Entries that do not move are held where they are: a Jacobian with empty columns
    would be singular.
    """
    u, height = s.place(w), jnp.sqrt(s.height)
    pulled = jnp.sqrt(s.pull) * (u - s.origin) / height
    still = jnp.where(s.unit > 0, 0.0, w)
    return (s.problem.roots(u) / height, pulled, still), None


class SolverState(AbstractState):
    """The state of a solver: scaled coordinates `w`, the arrays of its own state, and
    whether it says that it is done."""

    minimised: Float[Array | np.ndarray, ""]
    gain: Float[Array | np.ndarray, ""]
    damping: Float[Array | np.ndarray, ""]
    status: Int[Array | np.ndarray, ""]
    at: Float[Array, " params"]
    value: Float[Array, ""]
    w: Float[Array, " params"]
    inner: Any
    done: Bool[Array, ""]

    @property
    def u(self) -> Float[Array, " params"]:
        """The point."""
        return self.at

    @property
    def loss(self) -> Float[Array, ""]:
        """The loss there, without the pull."""
        return self.value


def begin_solver(s: Any, w: Float[Array, " params"], inner: Any) -> SolverState:
    """The state before the first step, at the point that `s` has evaluated."""
    minimised, gain, status = map(jnp.asarray, (s.minimised, s.gain, s.status))
    figures = minimised, gain, jnp.zeros_like(gain), status
    here = jnp.asarray(s.u), jnp.asarray(s.loss)
    return SolverState(*figures, *here, w, inner, jnp.asarray(False))


def end_of_step(scaled: ScaledLoss, s: SolverState, w, inner, done) -> SolverState:
    """The end of a step, whatever it has gained; the state before it where the loss is
    not finite."""
    u = scaled.place(w)
    value = scaled.problem.loss(u)
    total = value + scaled.ridge(u)
    gain = jnp.where(s.minimised > 0, 1.0 - total / s.minimised, 0.0)
    figures = total, gain, jnp.zeros_like(s.damping), s.status
    new = SolverState(*figures, u, value, w, inner, done)
    new = select_tree(jnp.isfinite(value), new, s)
    status = jnp.where(jnp.isfinite(value), OK, DIVERGED).astype(s.status.dtype)
    return eqx.tree_at(lambda s: s.status, new, status)


class AnySolver(AbstractMethod):
    """Steps of any solver of optimistix."""

    solver: Any
    scaled: ScaledLoss

    @property
    def nameless(self) -> "AnySolver":
        """The same method without names of channels, for programs."""
        return twin(self, scaled=self.scaled.nameless)

    @property
    def _function(self) -> Any:
        least = isinstance(self.solver, optx.AbstractLeastSquaresSolver)
        return errors if least else objective

    def begin(self, w: Float[Array, " params"]) -> Any:
        """The solver's own state before its first step."""
        shape, _ = jax.eval_shape(self._function, w, self.scaled)
        with jax.numpy_dtype_promotion("standard"):
            return self.solver.init(
                self._function, w, self.scaled, {}, shape, None, frozenset()
            )

    def step(self, s: SolverState) -> SolverState:
        """The next point; `stalled` when the solver finds no other."""
        rest = eqx.filter_eval_shape(self.begin, s.w)
        # What is no array in the solver's state never changes.
        rest = eqx.filter(
            rest, lambda a: isinstance(a, jax.ShapeDtypeStruct), inverse=True
        )

        def trial(carry):
            w, inner, tried, _, _ = carry
            given = self._function, w, self.scaled, {}
            inner = eqx.combine(inner, rest)
            with (
                jax.numpy_dtype_promotion("standard"),
                jax.numpy_rank_promotion("allow"),
            ):
                new, inner, _ = self.solver.step(*given, inner, frozenset())
                given = self._function, new, self.scaled, {}
                done, _ = self.solver.terminate(*given, inner, frozenset())
            inner = eqx.filter(inner, eqx.is_array)
            return new, inner, tried + 1, jnp.any(new != w), jnp.asarray(done)

        no = jnp.asarray(False)
        w, inner, _, moved, done = jax.lax.while_loop(
            lambda c: ~c[3] & ~c[4] & (c[2] < IDLE_STEPS),
            trial,
            (s.w, s.inner, 0, no, no),
        )
        stalled = jnp.asarray(STALLED, s.status.dtype)
        return jax.lax.cond(
            moved,
            lambda: end_of_step(self.scaled, s, w, inner, done),
            lambda: dataclasses.replace(
                s, w=w, inner=inner, done=s.done | done, status=stalled
            ),
        )

    def has_arrived(self, s: SolverState) -> Bool[Array, ""]:
        """Whether the solver says that it is done."""
        return s.done


def any_solver(problem: Problem, s: LevenbergState, solver: Any):
    """The method of a solver, and where it begins."""
    method = AnySolver(solver, scale_coordinates(problem, s))
    w = jnp.zeros_like(method.scaled.origin)
    inner = _begin(method, w)
    return method, begin_solver(s, w, inner)


@program
def _begin(method: AnySolver, w: Float[Array, " params"]) -> Any:
    return eqx.filter(method.begin(w), eqx.is_array)
