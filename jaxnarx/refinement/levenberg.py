"""Levenberg-Marquardt on streamed normal equations, driven from the host.

Marquardt scaling, a ridge towards the start, the Jacobian kept when a step is rejected,
and own stops: these are why no library solver is used. Each trial costs one run, each
accepted step one pass of `normal_equations`.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
import scipy.linalg

from jaxnarx.solution import RESULTS

DAMPING_START = 1e-3
DAMPING_LIMIT = 1e10
SHRINK, GROW = 5.0, 4.0
REACH = 2.0


@dataclasses.dataclass(frozen=True)
class Problem:
    """`loss(u)` and `normal_equations(u) -> (loss, J'r, J'J)` of one stage."""

    loss: Callable[[np.ndarray], float]
    normal_equations: Callable[[np.ndarray], tuple[float, np.ndarray, np.ndarray]]
    wall: np.ndarray
    """Largest magnitude of every entry; infinite where it is free. Entries with a wall
    also move by no more than REACH in one step: on the flat ends of their bounded map a
    step by curvature would throw them from one limit to the other."""


@dataclasses.dataclass(frozen=True)
class State:
    """Where the search stands. `loss` excludes the ridge; `tried` counts trial runs."""

    u: np.ndarray
    loss: float
    gradient: np.ndarray
    gram: np.ndarray
    damping: float
    tried: int = 0
    gain: float = np.inf
    """Relative decrease of the loss by the last accepted step."""


def init(problem: Problem, u: np.ndarray, *, damping: float = DAMPING_START) -> State:
    """Linearise at the start."""
    return State(u, *problem.normal_equations(u), damping)


def _direction(s: State, pull: np.ndarray, origin: np.ndarray) -> np.ndarray | None:
    """Damped step, or None where the equations cannot be solved.

    Entries without any information (padding, frozen directions) get a zero step.
    """
    diagonal = np.diagonal(s.gram) + pull
    alive = diagonal > 0
    if not alive.any():
        return None
    scale = np.sqrt(np.where(alive, diagonal, 1.0))
    gram = (s.gram + np.diag(pull)) / np.outer(scale, scale)
    gram = gram + np.diag(np.where(alive, s.damping, 1.0))
    right = (s.gradient + pull * (s.u - origin)) / scale
    try:
        factor = scipy.linalg.cho_factor(gram, check_finite=True)
    except (scipy.linalg.LinAlgError, ValueError):
        return None
    return np.where(alive, -scipy.linalg.cho_solve(factor, right) / scale, 0.0)


def promise(s: State, pull: np.ndarray, origin: np.ndarray) -> float:
    """Decrease of the penalised loss that the linearised problem promises."""
    fresh = dataclasses.replace(s, damping=DAMPING_START)
    delta = _direction(fresh, pull, origin)
    if delta is None:
        return np.inf
    return -float((s.gradient + pull * (s.u - origin)) @ delta)


def step(
    problem: Problem, s: State, pull: np.ndarray, origin: np.ndarray
) -> tuple[State, RESULTS]:
    """One accepted step, raising the damping until a trial lowers the penalised loss.

    `pull` is the ridge of every parameter towards `origin`. Status `stalled` when the
    damping reaches its limit first; `unidentifiable` when no parameter has any effect;
    `diverged` when sensitivities overflow.
    """

    def penalty(u):
        return float(pull @ (u - origin) ** 2)

    if not np.all(np.isfinite(s.gram)):
        return s, RESULTS.diverged
    if not np.any(np.diagonal(s.gram) > 0):
        return s, RESULTS.unidentifiable
    damping, tried = s.damping, s.tried
    while damping <= DAMPING_LIMIT:
        delta = _direction(dataclasses.replace(s, damping=damping), pull, origin)
        if delta is not None:
            reach = np.where(np.isfinite(problem.wall), REACH, np.inf)
            u = s.u + np.clip(delta, -reach, reach)
            u = np.clip(u, -problem.wall, problem.wall)
            loss = problem.loss(u)
            tried += 1
            if np.isfinite(loss) and loss + penalty(u) < s.loss + penalty(s.u):
                gain = 1.0 - loss / s.loss if s.loss > 0 else 0.0
                damping = max(damping / SHRINK, 1e-12)
                new = State(u, *problem.normal_equations(u), damping, tried, gain)
                return new, RESULTS.ok
        damping *= GROW
    return dataclasses.replace(s, damping=damping, tried=tried), RESULTS.stalled
