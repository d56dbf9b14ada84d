"""The one driver of iterative methods on the host: steps, stops, the best so far."""

import time as clock
from collections.abc import Callable
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from jaxnarx.solution import NAMES, RESULTS, code

ROUNDING = 1e-24
"""Loss (a mean square of scaled errors) that is nothing but rounding of float64."""

Progress = Callable[[dict[str, Any]], None]


@runtime_checkable
class State(Protocol):
    """Where a method stands."""

    @property
    def u(self) -> np.ndarray: ...
    @property
    def loss(self) -> float: ...
    @property
    def minimised(self) -> float: ...
    @property
    def damping(self) -> float: ...
    @property
    def gain(self) -> float: ...


S = TypeVar("S", bound=State)


@runtime_checkable
class Stepper(Protocol[S]):
    """A method: `arrived` tells where the linearised problem promises no decrease."""

    def step(self, s: S) -> tuple[S, RESULTS]: ...
    def arrived(self, s: S) -> bool: ...


def minimise(
    stepper: Stepper[S],
    state: S,
    *,
    steps: int,
    tolerance: float | int,
    quiet: int = 2,
    rounding: float = ROUNDING,
    accepted: Callable[[S], bool] = lambda _: False,
) -> tuple[S, int, RESULTS]:
    """At most so many accepted steps; where they lead, their number, and the status.

    `ok` where `quiet` steps in a row gain less than `tolerance`, where a method stalls
    because no step promises a decrease, and at a loss of `rounding` alone;
    `no_improvement` where `accepted`, which hears of every step, says so;
    `budget_spent`, the usual end; else what the method says.
    """
    small = 0
    for n in range(steps):
        state, status = stepper.step(state)
        if status != RESULTS.ok:
            if status == RESULTS.stalled and (
                state.loss <= rounding or stepper.arrived(state)
            ):
                status = RESULTS.ok
            return state, n, status
        enough = accepted(state)
        small = small + 1 if state.gain < tolerance else 0
        if small >= quiet or state.loss <= rounding:
            return state, n + 1, RESULTS.ok
        if enough:
            return state, n + 1, RESULTS.no_improvement
    return state, steps, RESULTS.budget_spent


class Course:
    """A search under way: the best so far by a judge, and its history.

    `judge` gives the score of a point, the smaller the better; `since` counts the
    points after the best one.
    """

    def __init__(
        self,
        judge: Callable[[np.ndarray], float],
        start: np.ndarray,
        progress: Progress | None,
    ):
        self.judge, self.progress = judge, progress
        self.best, self.since = start, 0
        self.score = self.start_score = judge(start)
        self.history: list[dict[str, Any]] = []
        self.begin = clock.perf_counter()

    def offer(self, u: np.ndarray) -> dict[str, Any]:
        """Keep `u` if its score is the best; what the history says of it."""
        score = self.judge(u)
        self.since = 0 if score < self.score else self.since + 1
        if score < self.score:
            self.best, self.score = u, score
        return {"validation": score, "diverged": False}

    def note(self, state: State, u: np.ndarray | None = None, **where: Any) -> None:
        """Offer where a step has led (`u` where that is not the state's own), write it
        down, and tell it."""
        row = {"step": len(self.history) + 1} | where
        row |= {"loss": state.loss, "minimised": state.minimised}
        row |= self.offer(state.u if u is None else u)
        row |= {"damping": state.damping, "seconds": clock.perf_counter() - self.begin}
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
