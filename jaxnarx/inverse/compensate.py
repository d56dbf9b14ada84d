"""The verb `compensate`: train an inverse on the tracking error of its cascade."""

import time as clock
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.inverse.loop import Loop, connect
from jaxnarx.inverse.task import CascadeTask, make_task, spreads
from jaxnarx.inverse.tracking_problem import TrackingProblem, tracking_problem
from jaxnarx.methods.inverse import ActuatorLimits, TrackingError
from jaxnarx.models import Network
from jaxnarx.refinement.layout import Layout, make_layout
from jaxnarx.refinement.levenberg import Levenberg
from jaxnarx.solution import NAMES, RESULTS, Solution, code

Progress = Callable[[dict[str, Any]], None]


def compensate(
    inverse: Network,
    forward: Network,
    references: Dataset,
    method: TrackingError | None = None,
    *,
    validation: Dataset | None = None,
    trainable: Network | None = None,
    limits: ActuatorLimits | None = None,
    progress: Progress | None = None,
) -> Solution[Network]:
    """Train an inverse through a forward network that stays as it is.

    What is minimised is the tracking error of `cascade` plus the price of moving the
    commands, with the limits inside the loop; see `TrackingError`. Coefficients and
    partition of the inverse move, or what is True in `trainable` (`jaxnarx.freeze`).
    `references` and `validation` are as for `cascade`. Outputs that the model itself
    gives (`simulate` under recorded commands) are better references than the recorded
    ones where the model misses more than the inverse: with the recorded ones, the
    inverse is trained to make good an error of the model that the plant does not have.

    After every accepted step the cascade over whole records of `validation` (default:
    of `references`) is scored by the same loss; the best inverse by that score is
    returned, so it is never worse there than the start. `progress` is called on the
    host with a dictionary after every step; `stats["history"]` lists these: step,
    horizon, loss, validation, damping, seconds. `stats["tracking"]` and
    `stats["tracking_start"]` are the validation's mean squared tracking errors in
    variances of the reference, without the price of the effort.

    Statuses: `ok`, `budget_spent`, `no_improvement` (validation stopped it), `stalled`,
    `unidentifiable` where no parameter moves an output, `diverged` where sensitivities
    overflow.
    """
    method = TrackingError() if method is None else method
    loop = connect(inverse, forward, limits)
    task = make_task(loop, references)
    guard = task if validation is None else make_task(loop, validation)
    layout = make_layout(inverse, trainable, method.width_band)
    return _Search(loop, layout, task, guard, method, progress).solve()


class _Search:
    """Where one training stands, and the best inverse so far by the guard."""

    def __init__(
        self,
        loop: Loop,
        layout: Layout,
        task: CascadeTask,
        guard: CascadeTask,
        method: TrackingError,
        progress: Progress | None,
    ):
        self.loop, self.layout, self.task = loop, layout, task
        self.method, self.progress = method, progress
        self.spread = spreads(loop, task)
        self.judge = self._problem(guard, None)
        self.begin = clock.perf_counter()
        self.best = np.asarray(layout.gather(layout.base))
        self.score = self.start_score = self.judge.loss(self.best)
        self.start_tracking = self.judge.tracking(self.best)
        self.since = 0
        self.history: list[dict[str, Any]] = []

    def _problem(self, task: CascadeTask, horizon: int | None) -> TrackingProblem:
        return tracking_problem(
            self.loop, self.layout, task, self.spread, self.method.effort, horizon
        )

    def solve(self) -> Solution[Network]:
        """Stages of growing windows, then whole records."""
        u, longest = self.best, int(self.task.scored.any(axis=2).sum(axis=1).max())
        for horizon in self.method.horizons:
            if horizon < longest:
                u, _ = self._stage(u, horizon, self.method.window_steps)
        problem = self._problem(self.task, None)
        # Windows may end where the whole record does not hold.
        if self.method.horizons and problem.loss(self.best) < problem.loss(u):
            u = self.best
        return self._solution(self._stage(u, None, self.method.max_steps)[1])

    def _stage(
        self, u: np.ndarray, horizon: int | None, steps: int
    ) -> tuple[np.ndarray, RESULTS]:
        problem = self._problem(self.task, horizon)
        solver, linear = Levenberg(problem), problem.linear(u)
        state = solver.init(u, linear, self.method.ridge * np.diagonal(linear.gram))
        small = self.since = 0
        for _ in range(steps):
            state, status = solver.step(state)
            if status != RESULTS.ok:
                if status == RESULTS.stalled and solver.arrived(state):
                    status = RESULTS.ok
                return state.u, status
            self._offer(state, horizon)
            small = small + 1 if state.gain < self.method.tolerance else 0
            if small >= 2:
                return state.u, RESULTS.ok
            if horizon is None and self.since >= self.method.patience:
                return state.u, RESULTS.no_improvement
        return state.u, RESULTS.budget_spent

    def _offer(self, state, horizon: int | None) -> None:
        """Keep the state if its validation is the best so far, and note it."""
        score = self.judge.loss(state.u)
        self.since = 0 if score < self.score else self.since + 1
        if score < self.score:
            self.best, self.score = state.u, score
        row = {
            "step": len(self.history) + 1,
            "horizon": horizon,
            "loss": state.loss,
            "validation": score,
            "damping": state.damping,
            "seconds": clock.perf_counter() - self.begin,
        }
        self.history.append(row)
        if self.progress is not None:
            self.progress(row)

    def _solution(self, status: RESULTS) -> Solution[Network]:
        network = self.layout.place(self.best)
        if not self.score < self.start_score:
            # Limits of the bounded coordinates may have moved the start by rounding.
            network = self.layout.base
        stats = {
            "history": self.history,
            "loss": self.score,
            "loss_start": self.start_score,
            "tracking": self.judge.tracking(self.best),
            "tracking_start": self.start_tracking,
            "steps": len(self.history),
            "parameters": self.layout.parameters,
            "seconds": clock.perf_counter() - self.begin,
            "end": NAMES[int(code(status))],
        }
        detail = f"tracking loss {self.start_score:.4g} -> {self.score:.4g}"
        return Solution(network, status, stats, detail)
