"""The verb `compensate`: train an inverse on the tracking error of its cascade."""

import dataclasses
from functools import partial

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import (
    UNREACHED_STEPS,
    Driver,
    Levenberg,
    Progress,
    SearchLog,
    StoppingRules,
    begin_levenberg,
    begin_search,
    evaluate_at,
    strip_names,
)
from jaxnarx.data import Dataset
from jaxnarx.inverse.loop import Loop, connect
from jaxnarx.inverse.task import CascadeTask, make_task, spreads
from jaxnarx.inverse.tracking_problem import TrackingProblem, tracking_problem
from jaxnarx.models import Network
from jaxnarx.refinement import Layout, make_layout
from jaxnarx.settings import ActuatorLimits, TrackingError
from jaxnarx.solution import RESULTS, Solution


@guard_arguments
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

    The criterion is the tracking error of `cascade` plus the price of moving the
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
    """The state of one training, and the best inverse so far by the validation
    records."""

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
        self.guard = strip_names(self._problem(guard, None))
        start = np.asarray(layout.gather(layout.base))
        loss = np.asarray(evaluate_at(self.guard.loss, start))
        self.log = SearchLog(loss, progress)
        self.search = begin_search(begin_levenberg(start), loss)
        self.start_tracking = float(evaluate_at(self.guard.tracking_error, start))

    def _problem(self, task: CascadeTask, horizon: int | None) -> TrackingProblem:
        method = self.method
        terms = method.effort, horizon, method.ridge
        return tracking_problem(self.loop, self.layout, task, self.spread, *terms)

    def solve(self) -> Solution[Network]:
        """Stages of growing windows, then whole records."""
        u, scored = np.asarray(self.search.best.u), self.task.scored
        longest = int(scored.any(axis=2).sum(axis=1).max())
        for horizon in self.method.horizons:
            if horizon < longest:
                u, _ = self._stage(u, horizon, self.method.window_steps)
        best = np.asarray(self.search.best.u)
        if self.method.horizons:
            # Windows may end where the whole record does not hold.
            loss = strip_names(self._problem(self.task, None)).loss
            if evaluate_at(loss, best) < evaluate_at(loss, u):
                u = best
        return self._solution(self._stage(u, None, self.method.max_steps)[1])

    def _stage(
        self, u: np.ndarray, horizon: int | None, steps: int
    ) -> tuple[np.ndarray, RESULTS]:
        method = self.method
        whole = horizon is None
        patience = method.patience if whole else UNREACHED_STEPS
        rules = StoppingRules(method.tolerance, patience)
        levenberg = Levenberg(self._problem(self.task, horizon))
        driver = Driver(levenberg, self.guard.loss, rules)
        begun = dataclasses.replace(self.search, state=begin_levenberg(u))
        begun, _ = driver.start(begun, look=False)
        report = partial(self.log.add, horizon=horizon)
        self.search, status = driver.minimise(begun, steps, report)
        return np.asarray(self.search.state.u), status

    def _solution(self, status: RESULTS) -> Solution[Network]:
        best, log = self.search.best, self.log
        u, loss = np.asarray(best.u), float(best.score.loss)
        network = self.layout.place(u)
        if not loss < log.start_loss:
            # Limits of the bounded coordinates may have moved the start by rounding.
            network = self.layout.base
        stats = log.stats(status, best.score, self.layout.parameters)
        stats |= {
            "tracking": float(evaluate_at(self.guard.tracking_error, u)),
            "tracking_start": self.start_tracking,
        }
        detail = f"tracking loss {log.start_loss:.4g} -> {loss:.4g}"
        return Solution(network, status, stats, detail)
