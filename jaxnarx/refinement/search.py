"""The search on the host: stages of growing horizon, the guard, the history."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np

from jaxnarx.arrays import (
    NEVER,
    Driver,
    History,
    JudgedPoint,
    Levenberg,
    Progress,
    Standing,
    StepFigures,
    begin_course,
    begin_levenberg,
    offer,
    rules,
)
from jaxnarx.errors import SpecError
from jaxnarx.methods import SimulationError
from jaxnarx.models import Network
from jaxnarx.refinement._stages import Stage
from jaxnarx.refinement.guard import Judged, judged, make_guard
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.problem import Problem, make_problem, restraint
from jaxnarx.refinement.task import Task
from jaxnarx.solution import RESULTS, Solution


def takes_windows(solver: Any) -> bool:
    """Whether a solver is a transformation of optax, which takes gradients of batches.

    `SpecError` where it is no solver at all.
    """
    if solver is None:
        return False
    import optax
    import optimistix

    if isinstance(solver, optax.GradientTransformation):
        return True
    known = optimistix.AbstractMinimiser, optimistix.AbstractLeastSquaresSolver
    if not isinstance(solver, known):
        raise SpecError(
            "solver must be a minimiser or least-squares solver of optimistix, or a "
            f"transformation of optax such as optax.adam(0.01), got {solver!r}",
            field="solver",
        )
    return False


class Search:
    """One refinement, judged by whether a free run diverges and by its loss.

    `limit` ends it at that position of the schedule, as cross-validation asks. `names`
    are those of the attempts, by number; the first is the start itself.
    """

    def __init__(
        self,
        layout: Layout,
        task: Task,
        guard: Task,
        method: SimulationError,
        *,
        schedules: dict[str, list[Stage]],
        prior: np.ndarray | None = None,
        progress: Progress | None = None,
        limit: int | None = None,
        solver: Any = None,
    ):
        self.solver = solver
        self.layout, self.task, self.method = layout, task, method
        self.schedules, self.prior = schedules, prior
        self.limit = limit
        self.guard = make_guard(layout, guard, trained=guard is task)
        self.still = layout.partition()
        self.start = np.asarray(layout.gather(layout.base))
        # Entries near their limits are placed a little off them: the network itself.
        first = judged(self.guard, self.start)
        self.history = History(first, progress)
        self.course = begin_course(begin_levenberg(self.start), first)
        self.first = self.course.best
        self.passed, self.names = 0, [""]
        self.last = next(iter(schedules.values()))[-1]
        self.total = max(sum(s.steps for s in one) for one in schedules.values())

    @property
    def start_diverged(self) -> bool:
        """Whether the start does."""
        return bool(self.first.judged.diverged)

    @property
    def diverged(self) -> bool:
        """Whether the best so far does."""
        return bool(self.course.best.judged.diverged)

    @property
    def score(self) -> float:
        """The best loss so far."""
        return float(self.course.best.judged.loss)

    @property
    def winner(self) -> str:
        """The name of the attempt that has found it; the start has none."""
        return self.names[int(self.course.best.attempt)]

    def run(self, way: str, starts: Sequence[tuple[str, np.ndarray]]) -> RESULTS:
        """One schedule: all stages but the last from every start, the last from the
        best network so far by the guard, or, where none runs, from the first's end.
        """
        *before, last = self.schedules[way]
        standing = eqx.tree_at(lambda s: s.lead, self.course.standing, self.first)
        status, end = RESULTS.ok, None
        for name, u in starts:
            self.passed, attempt = 0, len(self.names)
            self.names.append(name)
            if u is not self.start:
                here = JudgedPoint(u, self.judge(u), np.asarray(attempt))
                standing = offer(standing, here)
            self._follow(standing, attempt)
            for stage in before:
                u, status = self.stage(u, stage)
                self.passed += stage.steps
            standing = self.course.standing
            end = (u, attempt) if end is None else end
        assert end is not None
        lead, (u, attempt) = standing.lead, end
        if not lead.judged.diverged:
            u, attempt = np.asarray(lead.u), max(int(lead.attempt), 1)
        self._follow(standing, attempt)
        self.passed = self.total - last.steps
        return status if before and not last.steps else self.stage(u, last)[1]

    def _follow(self, standing: Standing, attempt: int) -> None:
        new = {"standing": standing, "attempt": np.asarray(attempt)}
        self.course = dataclasses.replace(self.course, **new)

    def judge(self, u: np.ndarray) -> Judged:
        """What the guard says of a point."""
        return judged(self.guard, u)

    def problem(self, u: np.ndarray, stage: Stage) -> Problem:
        """The loss of a stage, with the restraint that suits the network at `u`."""
        weight, target = self.method.stability, self.method.contraction
        return make_problem(
            self.layout,
            self.task,
            stage.horizon,
            ridge=self.method.ridge,
            prior=self.prior,
            still=self.still if stage.only_coefficients else None,
            restraint=restraint(self.layout, u, self.task, weight, target),
            shrink=self.method.shrink,
        )

    def driver(self, u: np.ndarray, stage: Stage) -> Driver:
        """That of a stage; the course has taken stock of its start."""
        # Batches are noisy: their loss may rest for a while.
        noisy = takes_windows(self.solver)
        ends = rules(
            -np.inf if noisy else self.method.tolerance,
            patience=self.method.patience if stage is self.last else NEVER,
        )
        problem = self.problem(u, stage)
        driver = Driver(Levenberg(problem), self.guard, ends)
        begun = dataclasses.replace(self.course, state=begin_levenberg(u))
        self.course, start = driver.start(begun, look=False)
        if self.solver is None or start.status != "ok":
            return driver
        method, state = self.own_solver(problem, stage)
        self.course = dataclasses.replace(self.course, state=state)
        return Driver(method, self.guard, ends)

    def own_solver(self, problem: Problem, stage: Stage) -> tuple[Any, Any]:
        """The method of the user's solver, and where it begins."""
        start = self.course.state
        if not takes_windows(self.solver):
            from jaxnarx.refinement.any_solver import any_solver

            return any_solver(problem, start, self.solver)
        from jaxnarx.refinement.random_windows import random_windows

        length, method = stage.horizon or self.task.longest, self.method
        options = {"batch": method.batch, "seed": method.seed}
        return random_windows(problem, start, length, self.solver, **options)

    def stage(self, u: np.ndarray, stage: Stage) -> tuple[np.ndarray, RESULTS]:
        """The accepted steps of a stage; returns the end and its status."""
        horizon, steps, _ = stage
        if self.limit is not None:
            steps = min(steps, self.limit - self.passed)
        if steps <= 0:
            return u, RESULTS.budget_spent
        driver, first = self.driver(u, stage), len(self.history.rows)
        name = self.names[int(self.course.attempt)]

        def note(now: StepFigures) -> None:
            n = len(self.history.rows) - first + 1
            where: dict[str, Any] = {"of": self.total, "done": self.passed + n}
            where["stage"] = "full record" if horizon is None else f"{horizon} samples"
            self.history.note(now, name=name, **where, horizon=horizon, stage_step=n)

        self.course, status = driver.minimise(self.course, steps, note)
        return np.asarray(self.course.state.u), status

    def solution(self, status: RESULTS) -> Solution[Network]:
        """The best network, and how it was found."""
        # Entries near their limits return a little off them: the start stays as it is.
        best = self.course.best
        u, same = np.asarray(best.u), int(best.attempt) == 0
        network = self.layout.base if same else self.layout.place(u)
        detail = f"free-run loss {self.history.start:.4g} -> {self.score:.4g}"
        if self.diverged:
            status = RESULTS.start_diverged if self.start_diverged else status
            detail += "; no better network was found that runs within its bounds"
        elif self.start_diverged:
            way = self.winner or "growing horizons"
            detail += f"; the start diverged, {way} led to one that does not"
        stats = self.history.stats(status, best.judged, self.layout.parameters)
        stats |= {
            "start_diverged": self.start_diverged,
            "remedy": self.winner if self.start_diverged else "",
        }
        if self.layout.initial is not None:
            offset = u[self.layout.parameters :]
            stats["initial"] = offset.reshape(self.layout.initial.weight.shape)
        return Solution(network, status, stats, detail)
