"""The one driver of iterative methods on the host: steps, stops, the best so far."""

import dataclasses
import time as clock
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.arrays.levenberg import (
    NOT_RUN,
    OK,
    AbstractProblem,
    LevenbergState,
    begin,
    has_arrived,
    step,
)
from jaxnarx.arrays.programs import bound, plain, program
from jaxnarx.solution import NAMES, RESULTS, code

ROUNDING_LOSS = 1e-24
"""Loss (a mean square of scaled errors) that is nothing but rounding of float64."""
QUIET_STEPS = 2
"""Steps in a row that gain little, after which a search ends."""

Progress = Callable[[dict[str, Any]], None]


@dataclasses.dataclass(frozen=True)
class Standing:
    """Where a method stands, in numbers of the host.

    `loss` is without the pull to the start, `minimised` with it; `gain` the relative
    decrease of it by the last step, `judged` what a judge says of the point, `state`
    what the method itself remembers.
    """

    u: np.ndarray
    loss: float
    minimised: float
    state: Any
    status: str = "ok"
    damping: float = 0.0
    gain: float = np.inf
    judged: Any = None


@runtime_checkable
class Method(Protocol):
    """`has_arrived` tells where the linearised problem promises no decrease."""

    def step(self, s: Standing) -> Standing: ...
    def has_arrived(self, s: Standing) -> bool: ...


def advanced(
    problem: AbstractProblem, judge: Callable, state: LevenbergState, look: Any
):
    """A step, and what the judge says of the point it has led to.

    Of the start, too, where one is to `look`; of a point that was not left nothing.
    """
    new = step(problem, state)
    there = jnp.where(state.status == NOT_RUN, look, new.status == OK)
    said = eqx.filter_eval_shape(judge, new.u)
    nothing = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), said)
    judged = jax.lax.cond(there, lambda: judge(new.u), lambda: nothing)
    status = new.status.astype(new.gain.dtype)
    figures = [new.linear.loss, new.minimised, new.damping, new.gain, status]
    return new, jnp.stack(figures), judged


@program
def value_at(function: Callable, u: Any) -> Any:
    """A loss or a judge of arrays, compiled, on the host."""
    return function(u)


class Levenberg:
    """The method of `arrays.levenberg`, one program for every accepted step.

    `judge` is a function of arrays that may be an argument of programs.
    """

    def __init__(self, problem: AbstractProblem, judge: Callable = lambda u: ()):
        self.problem, self.judge = plain(problem), plain(judge)
        self._advanced = bound(advanced, self.problem, self.judge)

    def start(self, u: np.ndarray, *, look: bool = False) -> Standing:
        """Take stock of `u`; `judged` where one is to `look`."""
        return self._standing(begin(u), look)

    def step(self, s: Standing) -> Standing:
        """One accepted step, or none; see `LevenbergState` for statuses."""
        return self._standing(s.state, False)

    def _standing(self, state: LevenbergState, look: bool) -> Standing:
        state, figures, judged = self._advanced(state, look)
        loss, minimised, damping, gain, status = np.asarray(figures).tolist()
        judged, name = jax.tree.map(np.asarray, judged), NAMES[int(status)]
        u = np.asarray(state.u)
        return Standing(u, loss, minimised, state, name, damping, gain, judged)

    def has_arrived(self, s: Standing) -> bool:
        """Whether the linearised problem promises no decrease worth naming."""
        return bool(has_arrived(s.state))


def minimise(
    method: Method,
    s: Standing,
    *,
    steps: int,
    tolerance: float | int,
    quiet: int = QUIET_STEPS,
    rounding: float = ROUNDING_LOSS,
    accepted: Callable[[Standing], bool] = lambda _: False,
) -> tuple[Standing, int, RESULTS]:
    """At most so many accepted steps; where they lead, their number, and the status.

    `ok` where `quiet` steps in a row gain less than `tolerance`, where a method stalls
    because no step promises a decrease, and at a loss of `rounding` alone;
    `no_improvement` where `accepted`, which hears of every step, says so;
    `budget_spent`, the usual end; else what the method says.
    """
    small = 0
    for n in range(steps):
        s = method.step(s)
        if s.status == "stalled" and (s.loss <= rounding or method.has_arrived(s)):
            return s, n, RESULTS.ok
        if s.status != "ok":
            return s, n, getattr(RESULTS, s.status)
        enough = accepted(s)
        small = small + 1 if s.gain < tolerance else 0
        if small >= quiet or s.loss <= rounding:
            return s, n + 1, RESULTS.ok
        if enough:
            return s, n + 1, RESULTS.no_improvement
    return s, steps, RESULTS.budget_spent


class Course:
    """A search under way: the best so far by a judge, and its history.

    `score` is the judge's of the start, the smaller the better; `since` counts the
    points after the best one.
    """

    def __init__(self, start: np.ndarray, score: float, progress: Progress | None):
        self.progress = progress
        self.best, self.since = start, 0
        self.score = self.start_score = score
        self.history: list[dict[str, Any]] = []
        self.begin = clock.perf_counter()

    def offer(self, u: np.ndarray, judged: Any) -> dict[str, Any]:
        """Keep `u` if its score is the best; what the history says of it."""
        score = float(judged)
        self.since = 0 if score < self.score else self.since + 1
        if score < self.score:
            self.best, self.score = u, score
        return {"validation": score, "diverged": False}

    def note(self, s: Standing, **where: Any) -> None:
        """Offer where a step has led, write it down, and tell it."""
        row = {"step": len(self.history) + 1} | where
        row |= {"loss": s.loss, "minimised": s.minimised}
        row |= self.offer(s.u, s.judged)
        row |= {"damping": s.damping, "seconds": clock.perf_counter() - self.begin}
        self.history.append(row)
        if self.progress is not None:
            self.progress(row)

    def stats(self, status: RESULTS, parameters: int) -> dict[str, Any]:
        """What every search tells in the end."""
        return {
            "history": self.history,
            "loss": self.score,
            "loss_start": self.start_score,
            "steps": len(self.history),
            "parameters": parameters,
            "seconds": clock.perf_counter() - self.begin,
            "end": NAMES[int(code(status))],
        }
