"""Levenberg-Marquardt on streamed normal equations.

Marquardt scaling, a pull towards the start, the Jacobian kept when a step is rejected,
walls, and a status in place of an exception: these are why no library solver is used.
Each trial costs one run, each accepted step one pass of the normal equations.

A method of `arrays.iteration`: driven from the host, or in the loop of a sweep.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.iteration import (
    DIVERGED,
    NOT_RUN,
    OK,
    STALLED,
    UNIDENTIFIABLE,
    AbstractMethod,
    AbstractState,
)
from jaxnarx.arrays.normal_equations import ridge_solve
from jaxnarx.arrays.programs import strip_names, twin

DAMPING_START = 1e-3
DAMPING_LIMIT = 1e10
DAMPING_LEAST = 1e-12
DAMPING_DECREASE, DAMPING_INCREASE = 5.0, 4.0
MAX_BOUNDED_STEP = 2.0
"""Entries with a wall move by no more than this in one step: on the flat ends of their
bounded map a step by curvature would throw them from one limit to the other."""
LEAST_PROMISED_SHARE = 1e-10
"""Share of the loss below which a promised decrease counts as none."""


Vector = Float[Array | np.ndarray, " params"]
Number = Float[Array | np.ndarray, ""]


class Linear(eqx.Module):
    """Loss, J'r (half the gradient) and J'J at a point."""

    u: Vector
    loss: Number
    gradient: Vector
    gram: Float[Array | np.ndarray, "params params"]


class AbstractProblem(eqx.Module):
    """A problem whose loss is minimised."""

    @property
    @abc.abstractmethod
    def wall(self) -> Float[Array, " params"]:
        """Largest magnitude of every entry, infinite for those without limits.

        A solver must not throw the others from one limit to the other.
        """

    @abc.abstractmethod
    def loss(self, u: Float[Array, " params"]) -> Float[Array, ""]:
        """The loss alone: one run."""

    @abc.abstractmethod
    def linear(self, u: Float[Array, " params"]) -> Linear:
        """The loss and its normal equations: a run and its sensitivities.

        They are those of the point `u`, or of `u` with the entries without information,
        in which the method does not step, at their best place.
        """

    @abc.abstractmethod
    def pull(self, start: Linear) -> Float[Array, " params"]:
        """Weights of the squared distance from where a search starts."""


class LevenbergState(AbstractState):
    """The state of a search. `tried` counts trial runs; `linear.loss` is without the
    pull, `minimised` with it: that is what falls from step to step.

    `status` is `stalled` when the damping has reached its limit, `unidentifiable` when
    no parameter has any effect, `diverged` when sensitivities overflow.
    """

    minimised: Number
    gain: Number
    damping: Number
    status: Int[Array | np.ndarray, ""]
    linear: Linear
    origin: Vector
    pull: Vector
    tried: Int[Array | np.ndarray, ""]

    @property
    def u(self) -> Any:
        """The point."""
        return self.linear.u

    @property
    def loss(self) -> Any:
        """The loss there, without the pull."""
        return self.linear.loss


class Levenberg(AbstractMethod):
    """Levenberg-Marquardt on one problem."""

    problem: AbstractProblem

    @property
    def nameless(self) -> "Levenberg":
        """The same method without names of channels, for programs."""
        return twin(self, problem=strip_names(self.problem))

    def step(self, s: LevenbergState) -> LevenbergState:
        """One accepted step, raising the damping until the penalised loss falls.

        Where none is found everything but damping, status and count of trials stays.
        """
        return _step(self.problem, s)

    def has_arrived(self, s: LevenbergState) -> Bool[Array, ""]:
        """Whether the linearised problem promises no decrease worth naming."""
        return _has_arrived(s)


class Trial(eqx.Module):
    """A point that may be taken, and whether what is minimised is lower there."""

    u: Float[Array, " params"]
    damping: Float[Array, ""]
    value: Float[Array, ""]
    tried: Int[Array, ""]
    lower: Bool[Array, ""]


def begin_levenberg(u: Vector) -> LevenbergState:
    """A search from `u` that has not looked at it yet."""
    xp = np if isinstance(u, np.ndarray) else jnp
    zero, far = xp.zeros_like(u), xp.asarray(np.inf, u.dtype)
    linear = Linear(u, far, zero, xp.zeros((u.size, u.size), u.dtype))
    damping = xp.asarray(DAMPING_START, u.dtype)
    figures = far, far, damping, xp.asarray(NOT_RUN)
    return LevenbergState(*figures, linear, u, zero, xp.asarray(0))


def begin_anew(s: LevenbergState, u: Vector) -> LevenbergState:
    """The same inside a program, with the arrays of another search."""
    status = jnp.full_like(s.status, NOT_RUN)
    return eqx.tree_at(lambda s: (s.linear.u, s.status), s, (u, status))


def _step(problem: AbstractProblem, s: LevenbergState) -> LevenbergState:
    fresh = s.status == NOT_RUN
    found = _descend(problem, s, fresh)

    def accept() -> LevenbergState:
        linear = problem.linear(found.u)
        eased = jnp.maximum(found.damping / DAMPING_DECREASE, DAMPING_LEAST)
        value = jnp.where(fresh, linear.loss, found.value)
        gain = 1.0 - value / s.minimised
        return LevenbergState(
            linear=linear,
            damping=jnp.where(fresh, DAMPING_START, eased).astype(eased.dtype),
            minimised=value,
            origin=jnp.where(fresh, linear.u, s.origin),
            pull=jnp.where(fresh, problem.pull(linear), s.pull),
            tried=found.tried,
            gain=jnp.where(fresh, jnp.inf, gain).astype(gain.dtype),
            status=jnp.where(fresh, _outlook(linear), OK).astype(s.status.dtype),
        )

    def stay() -> LevenbergState:
        outlook = _outlook(s.linear)
        status = jnp.where(outlook == OK, STALLED, outlook).astype(s.status.dtype)
        return eqx.tree_at(
            lambda s: (s.damping, s.tried, s.status),
            s,
            (found.damping, found.tried, status),
        )

    return jax.lax.cond(found.lower, accept, stay)


def _outlook(linear: Linear) -> Int[Array, ""]:
    """`ok` where a step can be computed, else the status that says why not."""
    informed = jnp.any(jnp.diagonal(linear.gram) > 0)
    status = jnp.where(informed, OK, UNIDENTIFIABLE)
    return jnp.where(jnp.all(jnp.isfinite(linear.gram)), status, DIVERGED)


def _descend(
    problem: AbstractProblem, s: LevenbergState, fresh: Bool[Array, ""]
) -> Trial:
    """Raise the damping until a trial is lower; a fresh start is taken as it is."""
    wall, here = problem.wall, s.linear.u
    able = _outlook(s.linear) == OK
    reach = jnp.where(jnp.isfinite(wall), MAX_BOUNDED_STEP, jnp.inf)

    def attempt(t: Trial) -> Trial:
        delta = _direction(s, t.damping)
        solved = jnp.all(jnp.isfinite(delta))
        new = jnp.clip(here + jnp.clip(delta, -reach, reach), -wall, wall)
        new = jnp.where(solved, new, here)
        loss = problem.loss(new)
        value = loss + s.pull @ (new - s.origin) ** 2
        lower = solved & jnp.isfinite(loss) & (value < s.minimised)
        damping = jnp.where(lower, t.damping, t.damping * DAMPING_INCREASE)
        return Trial(new, damping, value, t.tried + solved.astype(t.tried.dtype), lower)

    start = Trial(
        jnp.asarray(here),
        jnp.where(fresh, DAMPING_START, s.damping).astype(here.dtype),
        jnp.asarray(s.minimised),
        jnp.where(fresh, 0, s.tried),
        fresh,
    )
    return jax.lax.while_loop(
        lambda t: able & ~t.lower & (t.damping <= DAMPING_LIMIT), attempt, start
    )


@jax.jit
def _has_arrived(s: LevenbergState) -> Bool[Array, ""]:
    delta = _direction(s, jnp.asarray(DAMPING_START, s.u.dtype))
    small = max(LEAST_PROMISED_SHARE, 10 * float(jnp.finfo(s.u.dtype).eps))
    return -(_slope(s) @ delta) < small * s.linear.loss


def _slope(s: LevenbergState) -> Float[Array, " params"]:
    """Half the gradient of what is minimised."""
    return jnp.asarray(s.linear.gradient) + s.pull * (s.linear.u - s.origin)


def _direction(s: LevenbergState, damping: Float[Array, ""]) -> Float[Array, " params"]:
    """Damped step; not finite where the equations cannot be solved.

    Entries without any information (padding, frozen directions) get a zero step.
    """
    gram = jnp.diag(s.pull) + s.linear.gram
    delta = -ridge_solve(gram, _slope(s), damping, least=0.0)
    return jnp.where(jnp.diagonal(gram) > 0, delta, 0.0)
