"""Levenberg-Marquardt on streamed normal equations, driven from the host.

Marquardt scaling, a ridge towards the start, the Jacobian kept when a step is rejected,
and own stops: these are why no library solver is used. Each trial costs one run, each
accepted step one pass of the normal equations.
"""

import abc
import dataclasses

import numpy as np
import scipy.linalg

from jaxnarx.solution import RESULTS

DAMPING_START = 1e-3
DAMPING_LIMIT = 1e10
SHRINK, GROW = 5.0, 4.0
REACH = 2.0
"""Entries with a wall move by no more than this in one step: on the flat ends of their
bounded map a step by curvature would throw them from one limit to the other."""
ARRIVED = 1e-10
"""Share of the loss below which a promised decrease counts as none."""


@dataclasses.dataclass(frozen=True)
class Linear:
    """Loss, J'r (half the gradient) and J'J at a point."""

    loss: float
    gradient: np.ndarray
    gram: np.ndarray


class AbstractProblem(abc.ABC):
    """What is minimised.

    Entries with a finite `wall`, the largest magnitude they may take, are the bounded
    ones; a solver must not throw them from one limit to the other.
    """

    wall: np.ndarray

    @abc.abstractmethod
    def loss(self, u: np.ndarray) -> float:
        """The loss alone: one run."""

    @abc.abstractmethod
    def linear(self, u: np.ndarray) -> Linear:
        """The loss and its normal equations: a run and its sensitivities."""


@dataclasses.dataclass(frozen=True)
class State:
    """Where the search stands; `loss` excludes the ridge. `tried` counts trial runs."""

    u: np.ndarray
    linear: Linear
    damping: float
    minimised: float
    """Loss and ridge: what falls from step to step."""
    tried: int = 0
    gain: float = np.inf
    """Relative decrease of it by the last accepted step."""

    @property
    def loss(self) -> float:
        """The loss where the search stands."""
        return self.linear.loss


class Levenberg:
    """Steps of one stage, with a ridge `pull` of every parameter to the start."""

    def __init__(self, problem: AbstractProblem):
        self.problem = problem

    def init(self, u: np.ndarray, linear: Linear, pull: np.ndarray) -> State:
        """Begin at `u`, where the problem is `linear`."""
        self.origin, self.pull = u, pull
        return State(u, linear, DAMPING_START, linear.loss)

    def step(self, s: State) -> tuple[State, RESULTS]:
        """One accepted step, raising the damping until the penalised loss falls.

        Status `stalled` when the damping reaches its limit first; `unidentifiable` when
        no parameter has any effect; `diverged` when sensitivities overflow.
        """
        if not np.all(np.isfinite(s.linear.gram)):
            return s, RESULTS.diverged
        if not np.any(np.diagonal(s.linear.gram) > 0):
            return s, RESULTS.unidentifiable
        damping, tried = s.damping, s.tried
        while damping <= DAMPING_LIMIT:
            u = self._trial(s, damping)
            if u is not None:
                loss = self.problem.loss(u)
                tried += 1
                value = loss + self._penalty(u)
                if np.isfinite(loss) and value < s.minimised:
                    gain = 1.0 - value / s.minimised
                    damping = max(damping / SHRINK, 1e-12)
                    linear = self.problem.linear(u)
                    return State(u, linear, damping, value, tried, gain), RESULTS.ok
            damping *= GROW
        return dataclasses.replace(s, damping=damping, tried=tried), RESULTS.stalled

    def arrived(self, s: State) -> bool:
        """Whether the linearised problem promises no decrease worth naming."""
        delta = self._direction(s, DAMPING_START)
        if delta is None:
            return False
        small = max(ARRIVED, 10 * float(np.finfo(s.u.dtype).eps))
        return -float(self._slope(s) @ delta) < small * s.loss

    def _penalty(self, u: np.ndarray) -> float:
        return float(self.pull @ (u - self.origin) ** 2)

    def _slope(self, s: State) -> np.ndarray:
        return s.linear.gradient + self.pull * (s.u - self.origin)

    def _trial(self, s: State, damping: float) -> np.ndarray | None:
        delta = self._direction(s, damping)
        if delta is None:
            return None
        wall = self.problem.wall
        reach = np.where(np.isfinite(wall), REACH, np.inf)
        new = np.clip(s.u + np.clip(delta, -reach, reach), -wall, wall)
        return new.astype(s.u.dtype)

    def _direction(self, s: State, damping: float) -> np.ndarray | None:
        """Damped step, or None where the equations cannot be solved.

        Entries without any information (padding, frozen directions) get a zero step.
        """
        diagonal = np.diagonal(s.linear.gram) + self.pull
        alive = diagonal > 0
        if not alive.any():
            return None
        scale = np.sqrt(np.where(alive, diagonal, 1.0))
        gram = (s.linear.gram + np.diag(self.pull)) / np.outer(scale, scale)
        gram = gram + np.diag(np.where(alive, damping, 1.0))
        try:
            factor = scipy.linalg.cho_factor(gram, check_finite=True)
        except (scipy.linalg.LinAlgError, ValueError):
            return None
        delta = scipy.linalg.cho_solve(factor, self._slope(s) / scale) / scale
        return np.where(alive, -delta, 0.0)
