"""The verb `compensate`: train an inverse on the tracking error of its cascade."""

import dataclasses
from functools import partial

import numpy as np

from jaxnarx.arrays import (
    NEVER,
    Driver,
    History,
    Judged,
    Levenberg,
    Progress,
    begin_course,
    begin_levenberg,
    plain,
    rules,
    value_at,
)
from jaxnarx.data import Dataset
from jaxnarx.guard import guarded
from jaxnarx.inverse.loop import Loop, connect
from jaxnarx.inverse.task import CascadeTask, make_task, spreads
from jaxnarx.inverse.tracking_problem import TrackingProblem, tracking_problem
from jaxnarx.methods import ActuatorLimits, TrackingError
from jaxnarx.models import Network
from jaxnarx.refinement import Layout, make_layout
from jaxnarx.solution import RESULTS, Solution


@guarded
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
        self.loop, self.layout, self.task, self.method = loop, layout, task, method
        self.spread = spreads(loop, task)
        self.guard = plain(self._problem(guard, None))
        start = np.asarray(layout.gather(layout.base))
        loss = np.asarray(value_at(self.guard.loss, start))
        first = Judged(np.asarray(False), loss)
        self.history = History(first, progress)
        self.course = begin_course(begin_levenberg(start), first)
        self.start_tracking = float(value_at(self.guard.tracking, start))

    def _problem(self, task: CascadeTask, horizon: int | None) -> TrackingProblem:
        method = self.method
        terms = method.effort, horizon, method.ridge
        return tracking_problem(self.loop, self.layout, task, self.spread, *terms)

    def solve(self) -> Solution[Network]:
        """Stages of growing windows, then whole records."""
        u, scored = np.asarray(self.course.best.u), self.task.scored
        longest = int(scored.any(axis=2).sum(axis=1).max())
        for horizon in self.method.horizons:
            if horizon < longest:
                u, _ = self._stage(u, horizon, self.method.window_steps)
        best = np.asarray(self.course.best.u)
        if self.method.horizons:
            # Windows may end where the whole record does not hold.
            loss = plain(self._problem(self.task, None)).loss
            if value_at(loss, best) < value_at(loss, u):
                u = best
        return self._solution(self._stage(u, None, self.method.max_steps)[1])

    def _stage(
        self, u: np.ndarray, horizon: int | None, steps: int
    ) -> tuple[np.ndarray, RESULTS]:
        method = self.method
        whole = horizon is None
        ends = rules(method.tolerance, patience=method.patience if whole else NEVER)
        levenberg = Levenberg(self._problem(self.task, horizon))
        driver = Driver(levenberg, self.guard.loss, ends)
        begun = dataclasses.replace(self.course, state=begin_levenberg(u))
        begun, _ = driver.start(begun, look=False)
        note = partial(self.history.note, horizon=horizon)
        self.course, status = driver.minimise(begun, steps, note)
        return np.asarray(self.course.state.u), status

    def _solution(self, status: RESULTS) -> Solution[Network]:
        best, history = self.course.best, self.history
        u, loss = np.asarray(best.u), float(best.judged.loss)
        network = self.layout.place(u)
        if not loss < history.start:
            # Limits of the bounded coordinates may have moved the start by rounding.
            network = self.layout.base
        stats = history.stats(status, best.judged, self.layout.parameters)
        stats |= {
            "tracking": float(value_at(self.guard.tracking, u)),
            "tracking_start": self.start_tracking,
        }
        detail = f"tracking loss {history.start:.4g} -> {loss:.4g}"
        return Solution(network, status, stats, detail)
