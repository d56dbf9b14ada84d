"""The search on the host: stages of growing horizon, the guard, the history."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxnarx.arrays import Course, Levenberg, Progress, Standing, minimise
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


class Search(Course):
    """One refinement, judged by whether a free run diverges and by its loss.

    `limit` ends it at that position of the schedule, as cross-validation asks. `lead`
    is the best of the attempts that are under way: whether it diverges, its score, the
    point, and the attempt's name.
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
        self.start_diverged, score = judged(self.guard, self.start).told
        self.diverged = self.start_diverged
        super().__init__(self.start, score, progress)
        self.passed, self.attempt, self.winner = 0, "", ""
        self.last = next(iter(schedules.values()))[-1]
        self.total = max(sum(s.steps for s in one) for one in schedules.values())

    def run(self, way: str, starts: Sequence[tuple[str, np.ndarray]]) -> RESULTS:
        """One schedule: all stages but the last from every start, the last from the
        best network so far by the guard, or, where none runs, from the first's end.
        """
        *before, last = self.schedules[way]
        self.lead = self.start_diverged, self.start_score, self.start, ""
        status, end = RESULTS.ok, None
        for name, u in starts:
            self.passed, self.attempt = 0, name
            if u is not self.start:
                self.offer(u, self.judge(u))
            for stage in before:
                u, status = self.stage(u, stage)
                self.passed += stage.steps
            end = (u, name) if end is None else end
        assert end is not None
        u, self.attempt = end if self.lead[0] else self.lead[2:]
        self.passed = self.total - last.steps
        return status if before and not last.steps else self.stage(u, last)[1]

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

    def begun(self, u: np.ndarray, stage: Stage) -> tuple[Any, Standing]:
        """The method of a stage, and where it stands."""
        method, solver = self.method, self.solver
        levenberg = Levenberg(self.problem(u, stage), self.guard)
        start = levenberg.start(u)
        if solver is None or start.status != "ok":
            return levenberg, start
        if not takes_windows(solver):
            from jaxnarx.refinement.any_solver import AnySolver

            stepped = AnySolver(levenberg, start, solver)
            return stepped, stepped.start
        from jaxnarx.refinement.random_windows import RandomWindows

        windows = RandomWindows(
            levenberg,
            start,
            stage.horizon or self.task.longest,
            solver,
            batch=method.batch,
            seed=method.seed,
        )
        return windows, windows.start

    def stage(self, u: np.ndarray, stage: Stage) -> tuple[np.ndarray, RESULTS]:
        """The accepted steps of a stage; returns the end and its status."""
        horizon, steps, _ = stage
        if self.limit is not None:
            steps = min(steps, self.limit - self.passed)
        if steps <= 0:
            return u, RESULTS.budget_spent
        method, start = self.begun(u, stage)
        first, self.since = len(self.history), 0

        def accepted(s: Standing) -> bool:
            n = len(self.history) - first + 1
            where: dict[str, Any] = {"of": self.total, "done": self.passed + n}
            where["stage"] = "full record" if horizon is None else f"{horizon} samples"
            self.note(s, **where, horizon=horizon, stage_step=n)
            return stage is self.last and self.since >= self.method.patience

        # Batches are noisy: their loss may rest for a while.
        noisy = takes_windows(self.solver)
        end, _, status = minimise(
            method,
            start,
            steps=steps,
            tolerance=-np.inf if noisy else self.method.tolerance,
            accepted=accepted,
        )
        return end.u, status

    def offer(self, u: np.ndarray, judged: Judged) -> dict[str, Any]:
        """Keep `u` if its guard score is the best.

        A network that runs beats one that does not, but no loss above the start's is
        kept.
        """
        diverged, score = found = judged.told
        self.since += 1
        if found < self.lead[:2]:
            self.lead, self.since = (diverged, score, u, self.attempt), 0
        if found < (self.diverged, self.score) and score <= self.start_score:
            self.best, self.score, self.diverged = u, score, diverged
            self.winner = self.attempt
        told = {"validation": score, "diverged": diverged}
        return told | ({"start": self.attempt} if self.attempt else {})

    def solution(self, status: RESULTS) -> Solution[Network]:
        """The best network, and how it was found."""
        # Entries near their limits return a little off them: the start stays as it is.
        same = self.best is self.start
        network = self.layout.base if same else self.layout.place(self.best)
        detail = f"free-run loss {self.start_score:.4g} -> {self.score:.4g}"
        if self.diverged:
            status = RESULTS.start_diverged if self.start_diverged else status
            detail += "; no better network was found that runs within its bounds"
        elif self.start_diverged:
            way = self.winner or "growing horizons"
            detail += f"; the start diverged, {way} led to one that does not"
        stats = self.stats(status, self.layout.parameters)
        stats |= {
            "start_diverged": self.start_diverged,
            "remedy": self.winner if self.start_diverged else "",
        }
        if self.layout.initial is not None:
            offset = self.best[self.layout.parameters :]
            stats["initial"] = offset.reshape(self.layout.initial.weight.shape)
        return Solution(network, status, stats, detail)
