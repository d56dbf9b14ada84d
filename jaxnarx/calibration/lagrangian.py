"""An augmented Lagrangian round by round, each minimised within bounds by L-BFGS-B.

With inequalities g <= 0, multipliers l and a penalty r,

    L = f + sum_k (max(0, l_k + r g_k)^2 - l_k^2) / (2 r) .

After a round l_k becomes max(0, l_k + r g_k), and r grows where limits are still broken
(R. T. Rockafellar, J. Optim. Theory Appl. 12, 1973, 555-562; J. Nocedal, S. J. Wright,
Numerical Optimization, 2006, chapter 17). Bounds are those of R. H. Byrd, P. Lu, J.
Nocedal, C. Zhu, SIAM J. Sci. Comput. 16, 1995: behind a sigmoid in their place values
went to the bounds in one step and stayed, for there it has no slope.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxnarx.arrays import program
from jaxnarx.calibration.problem import (
    CalibrationProblem,
    FreeNumbers,
    Merit,
    begin_numbers,
)

MEMORY = 12
"""Steps that L-BFGS-B remembers."""
LEAST_GAIN = 1e-8
"""Relative gain by which a round ends."""
RUNS_PER_STEP = 3
"""Runs of a step, in the mean, at most."""
LINE_SEARCH_ENDED = 2
"""Status of a search whose line search finds no better point."""
FIRST_PENALTY, LEAST_PENALTY, MOST_PENALTY, GROWTH = 50.0, 0.1, 1e5, 5.0


def first_penalty(merit: Merit) -> float:
    """The penalty of the first round: broken limits weigh as much as twice the
    objective (E. G. Birgin, J. M. Martinez, Practical Augmented Lagrangian Methods,
    2014)."""
    broken = float(np.sum(np.maximum(np.asarray(merit.inequalities), 0.0) ** 2))
    wanted = 2 * max(1.0, abs(float(merit.objective)))
    return float(np.clip(wanted / max(broken, 1e-12), LEAST_PENALTY, FIRST_PENALTY))


@dataclasses.dataclass(frozen=True, eq=False)
class Round:
    """Where a round has ended: free numbers, their merit, steps and runs."""

    free: tuple[FreeNumbers, ...]
    merit: Merit
    steps: int
    runs: int


@program
def lagrangian(
    problem: CalibrationProblem,
    free: tuple[FreeNumbers, ...],
    multipliers: Float[Array, " all"],
    penalty: Float[Array, ""],
    wanted: Float[Array, ""],
) -> tuple[tuple[Float[Array, ""], Merit], tuple[FreeNumbers, ...]]:
    """The Lagrangian with the merit behind it, and its slope; `wanted` is one, or zero
    where only limits count."""

    def value(free: tuple[FreeNumbers, ...]):
        m = problem.merit(free)
        pushed = jnp.maximum(multipliers + penalty * m.inequalities, 0.0)
        held = jnp.sum(pushed**2 - multipliers**2) / (2 * penalty)
        return wanted * m.objective + held, m

    return jax.value_and_grad(value, has_aux=True)(free)


def evaluate_merit(problem: CalibrationProblem, free: tuple[FreeNumbers, ...]) -> Merit:
    """Objective and inequalities of free numbers; by the program of the search."""
    kind = problem.cycle.values.dtype
    rest = np.zeros(problem.conditions, kind), np.ones((), kind), np.ones((), kind)
    return lagrangian(problem, free, *jax.device_put(rest))[0][1]


def minimise(
    problem: CalibrationProblem,
    free: tuple[FreeNumbers, ...],
    multipliers: Float[np.ndarray, " all"],
    penalty: float,
    wanted: float,
) -> Round:
    """One round from here."""
    start, unravel = ravel_pytree(free)
    kind = start.dtype
    _, *bounds = begin_numbers(problem)
    low, high = (np.asarray(ravel_pytree(b)[0]) for b in bounds)
    given = [jnp.asarray(a, kind) for a in (multipliers, penalty, wanted)]
    best: dict[str, Any] = {"value": np.inf}

    def both(x: Float[np.ndarray, " numbers"]) -> tuple[float, np.ndarray]:
        at = unravel(jnp.asarray(x, kind))
        (value, merit), slope = lagrangian(problem, at, *given)
        value, slope = float(value), np.asarray(ravel_pytree(slope)[0], float)
        if not (np.isfinite(value) and np.all(np.isfinite(slope))):
            # A run that diverges: a step half as far is tried then.
            return 1e300, np.zeros_like(slope)
        if value < best["value"]:
            best.update(value=value, free=at, merit=merit)
        return value, slope

    steps, runs, x = 0, 0, np.asarray(start, float)
    most = RUNS_PER_STEP * problem.search.steps
    while steps < problem.search.steps and runs < most:
        found = scipy.optimize.minimize(
            both,
            x,
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(low, high, strict=True)),
            options={
                "maxiter": problem.search.steps - steps,
                "maxfun": most - runs,
                "maxcor": MEMORY,
                "ftol": LEAST_GAIN,
                "gtol": 1e-9,
            },
        )
        steps, runs = steps + int(found.nit), runs + int(found.nfev)
        # At the edge of a limit a line search may end early: it begins anew there.
        if found.status != LINE_SEARCH_ENDED or not found.nit:
            break
        x = found.x
    if "free" not in best:
        empty = jnp.asarray(np.inf, kind)
        merit = Merit(empty, jnp.full_like(given[0], np.inf))
        return Round(free, merit, 0, runs)
    return Round(best["free"], best["merit"], steps, runs)
