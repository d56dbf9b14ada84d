"""The search on the host: stages of growing horizon, the guard, the history."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.arrays.levenberg import Levenberg, Linear
from jaxnarx.arrays.minimise import Course, Progress, State, minimise
from jaxnarx.arrays.programs import program
from jaxnarx.methods import SimulationError
from jaxnarx.models import Network
from jaxnarx.refinement.criterion import Criterion
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.problem import Problem, restraint
from jaxnarx.refinement.stages import Stage
from jaxnarx.refinement.task import Task
from jaxnarx.simulation import Drive, has_diverged, run
from jaxnarx.solution import RESULTS, Solution


class Guard:
    """Judges networks by the free run of records, from their measured starts."""

    def __init__(self, layout: Layout, task: Task):
        self.layout, self.task = layout, task
        self.data = task.drive, task.anchors(None), task.weight, task.criterion
        self.edges = [np.asarray(a) for a in (layout.base.lower, layout.base.upper)]

    def __call__(self, u: np.ndarray) -> tuple[bool, float]:
        """Whether any record diverges, and the loss."""
        return self._judge(u, False)

    def start(self, u: np.ndarray) -> tuple[bool, float]:
        """The same for the network as it was given; `u` is its vector."""
        return self._judge(u, True)

    def _judge(self, u: np.ndarray, given: bool) -> tuple[bool, float]:
        y, error = _judged(self.layout, u, np.asarray(given), *self.data)
        value, (lower, upper), masks = np.asarray(y), self.edges, self.task.masks
        held = (value <= lower) | (value >= upper)
        bad = any(
            has_diverged(held[n, masks.start[n] : masks.end[n], o])
            for n in np.flatnonzero(masks.scored.any(axis=(1, 2)))
            for o in range(held.shape[2])
        )
        score = float(error)
        return (bad, score) if np.isfinite(score) else (True, np.inf)


@program
def _judged(layout: Layout, u, given, drive: Drive, anchor, weight, rule: Criterion):
    """Free run and loss; of the base itself where it is `given`."""
    placed = layout.place(u)

    def chosen(base, moved):
        return base if base is moved else jnp.where(given, base, moved)

    network = jax.tree.map(chosen, layout.base, placed)
    y = run(network, drive, anchor)
    return y, rule(y, drive.measured, weight)


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
    ):
        self.layout, self.task, self.method = layout, task, method
        self.schedules, self.prior = schedules, prior
        self.limit, self.guard = limit, Guard(layout, guard)
        self.start = np.asarray(layout.gather(layout.base))
        self.start_diverged, score = self.guard.start(self.start)
        self.diverged = self.start_diverged
        super().__init__(lambda _: score, self.start, progress)
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
                self.offer(u)
            for stage in before:
                u, status = self.stage(u, stage)
                self.passed += stage.steps
            end = (u, name) if end is None else end
        assert end is not None
        u, self.attempt = end if self.lead[0] else self.lead[2:]
        self.passed = self.total - last.steps
        return status if before and not last.steps else self.stage(u, last)[1]

    def problem(self, u: np.ndarray, stage: Stage) -> Problem:
        """The loss of a stage, with the restraint that suits the network at `u`."""
        weight, target = self.method.stability, self.method.contraction
        held = restraint(self.layout, u, self.task, weight, target)
        anchors = self.task.anchors(stage.horizon)
        still = self.layout.partition() if stage.only_coefficients else None
        return Problem(self.layout, self.task, anchors, held, still)

    def _stepper(self, problem: Problem, horizon: int | None) -> Any:
        method = self.method
        if method.solver == "levenberg":
            return Levenberg(problem)
        if method.solver != "windows":
            from jaxnarx.refinement.quasi_newton import QuasiNewton

            return QuasiNewton(problem, limited_memory=method.solver == "lbfgs")
        from jaxnarx.refinement.random_windows import RandomWindows

        return RandomWindows(
            problem,
            horizon or self.task.longest,
            batch=method.batch,
            learning_rate=method.learning_rate,
            seed=method.seed,
        )

    def pull(self, linear: Linear, u: np.ndarray) -> np.ndarray:
        """Ridge and prior of a stage that starts at `u`."""
        pull = self.method.ridge * np.diagonal(linear.gram)
        if self.prior is None:
            return pull
        # The noise's variance, in units of the loss, by what is left at the start.
        count = max(int(self.task.masks.scored.sum()), 1)
        slope = np.asarray(self.layout.slope(u))
        return pull + linear.loss / count * (slope * self.prior) ** 2

    def stage(self, u: np.ndarray, stage: Stage) -> tuple[np.ndarray, RESULTS]:
        """The accepted steps of a stage; returns the end and its status."""
        horizon, steps, _ = stage
        if self.limit is not None:
            steps = min(steps, self.limit - self.passed)
        if steps <= 0:
            return u, RESULTS.budget_spent
        problem = self.problem(u, stage)
        stepper = self._stepper(problem, horizon)
        linear = problem.linear(u)
        if not np.any(np.diagonal(linear.gram) > 0):
            return u, RESULTS.unidentifiable
        first, self.since = len(self.history), 0

        def accepted(state: State) -> bool:
            n = len(self.history) - first + 1
            where: dict[str, Any] = {"of": self.total, "done": self.passed + n}
            where["stage"] = "full record" if horizon is None else f"{horizon} samples"
            self.note(state, **where, horizon=horizon, stage_step=n)
            return stage is self.last and self.since >= self.method.patience

        # Batches are noisy: their loss may rest for a while.
        noisy = self.method.solver == "windows"
        state, _, status = minimise(
            stepper,
            stepper.init(u, linear, self.pull(linear, u)),
            steps=steps,
            tolerance=-np.inf if noisy else self.method.tolerance,
            accepted=accepted,
        )
        return state.u, status

    def offer(self, u: np.ndarray) -> dict[str, Any]:
        """Keep `u` if its guard score is the best.

        A network that runs beats one that does not, but no loss above the start's is
        kept.
        """
        diverged, score = found = self.guard(u)
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
