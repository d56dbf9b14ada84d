"""The search on the host: stages of growing horizon, the guard, the history."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np

from jaxnarx.arrays import (
    UNREACHED_STEPS,
    Driver,
    Incumbents,
    Levenberg,
    Progress,
    ScoredPoint,
    SearchLog,
    StepFigures,
    StoppingRules,
    begin_levenberg,
    begin_search,
    evaluate_at,
    update_incumbents,
)
from jaxnarx.errors import SpecError
from jaxnarx.models import Network
from jaxnarx.refinement._stages import Stage
from jaxnarx.refinement.gain_penalty import SignPenalty
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.problem import Problem, make_problem, restraint
from jaxnarx.refinement.training_data import TrainingData
from jaxnarx.refinement.validation import make_validator
from jaxnarx.settings import SimulationError
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
    """One refinement, validated by whether a free run diverges and by its loss.

    `limit` ends it at that position of the schedule, as cross-validation asks. `names`
    are those of the attempts, by number; number 0 is the start itself, and the first
    attempt from there has no name either.
    """

    def __init__(
        self,
        layout: Layout,
        task: TrainingData,
        guard: TrainingData,
        method: SimulationError,
        *,
        schedules: dict[str, list[Stage]],
        prior: np.ndarray | None = None,
        progress: Progress | None = None,
        limit: int | None = None,
        solver: Any = None,
        signs: SignPenalty | None = None,
    ):
        self.solver, self.signs = solver, signs
        self.layout, self.task, self.method = layout, task, method
        self.schedules, self.prior = schedules, prior
        self.limit = limit
        self.validate = make_validator(
            layout, guard, trained=guard is task, signs=signs
        )
        self.still = layout.partition()
        self.start = np.asarray(layout.gather(layout.base))
        # Entries near their limits are placed a little off them: the network itself.
        first = evaluate_at(self.validate, self.start)
        self.log = SearchLog(first, progress)
        self.state = begin_search(begin_levenberg(self.start), first)
        self.first = self.state.best
        self.passed, self.names = 0, [""]
        self.last = next(iter(schedules.values()))[-1]
        self.total = max(sum(s.steps for s in one) for one in schedules.values())

    @property
    def start_diverged(self) -> bool:
        """Whether the start does."""
        return bool(self.first.score.diverged)

    @property
    def diverged(self) -> bool:
        """Whether the best so far does."""
        return bool(self.state.best.score.diverged)

    @property
    def score(self) -> float:
        """The best loss so far."""
        return float(self.state.best.score.loss)

    @property
    def winner(self) -> str:
        """The name of the attempt that has found it; the start has none."""
        return self.names[int(self.state.best.attempt)]

    def run(self, way: str, starts: Sequence[tuple[str, np.ndarray]]) -> RESULTS:
        """One schedule: all stages but the last from every start, the last from the
        best network so far by the guard, or, where none runs, from the first's end.
        """
        *before, last = self.schedules[way]
        found = eqx.tree_at(lambda i: i.lead, self.state.incumbents, self.first)
        status, end = RESULTS.ok, None
        for name, u in starts:
            self.passed, attempt = 0, len(self.names)
            self.names.append(name)
            if u is not self.start:
                score = evaluate_at(self.validate, u)
                here = ScoredPoint(u, score, np.asarray(attempt))
                found = update_incumbents(found, here)
            self._follow(found, attempt)
            for stage in before:
                u, status = self.stage(u, stage)
                self.passed += stage.steps
            found = self.state.incumbents
            end = (u, attempt) if end is None else end
        assert end is not None
        lead, (u, attempt) = found.lead, end
        if not lead.score.diverged:
            # From the start itself goes the first attempt: 0 is left to it alone.
            u, attempt = np.asarray(lead.u), max(int(lead.attempt), 1)
        self._follow(found, attempt)
        self.passed = self.total - last.steps
        return status if before and not last.steps else self.stage(u, last)[1]

    def _follow(self, found: Incumbents, attempt: int) -> None:
        new = {"incumbents": found, "attempt": np.asarray(attempt)}
        self.state = dataclasses.replace(self.state, **new)

    def problem(self, u: np.ndarray, stage: Stage) -> Problem:
        """The loss of a stage, with the restraints that suit the network at `u`."""
        weight, target = self.method.stability, self.method.contraction
        return make_problem(
            self.layout,
            self.task,
            stage.horizon,
            ridge=self.method.ridge,
            prior=self.prior,
            still=self.still if stage.only_coefficients else None,
            restraints=[
                restraint(self.layout, u, self.task, weight, target),
                self.signs,
            ],
            shrink=self.method.shrink,
        )

    def begin_stage(self, u: np.ndarray, stage: Stage) -> Driver:
        """Evaluate the start of a stage; returns its driver."""
        # Batches are noisy: their loss may rest for a while.
        noisy = takes_windows(self.solver)
        rules = StoppingRules(
            -np.inf if noisy else self.method.tolerance,
            self.method.patience if stage is self.last else UNREACHED_STEPS,
        )
        problem = self.problem(u, stage)
        driver = Driver(Levenberg(problem), self.validate, rules)
        begun = dataclasses.replace(self.state, state=begin_levenberg(u))
        self.state, start = driver.start(begun, look=False)
        if self.solver is None or start.status_name != "ok":
            return driver
        method, state = self.own_solver(problem, stage)
        self.state = dataclasses.replace(self.state, state=state)
        return Driver(method, self.validate, rules)

    def own_solver(self, problem: Problem, stage: Stage) -> tuple[Any, Any]:
        """The method of the user's solver, and where it begins."""
        start = self.state.state
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
        driver, first = self.begin_stage(u, stage), len(self.log.history)
        name = self.names[int(self.state.attempt)]

        def report(now: StepFigures) -> None:
            n = len(self.log.history) - first + 1
            where: dict[str, Any] = {"of": self.total, "done": self.passed + n}
            where["stage"] = "full record" if horizon is None else f"{horizon} samples"
            self.log.add(now, name=name, **where, horizon=horizon, stage_step=n)

        self.state, status = driver.minimise(self.state, steps, report)
        return np.asarray(self.state.state.u), status

    def solution(self, status: RESULTS) -> Solution[Network]:
        """The best network, and how it was found."""
        # Entries near their limits return a little off them: the start stays as it is.
        best = self.state.best
        u, same = np.asarray(best.u), int(best.attempt) == 0
        network = self.layout.base if same else self.layout.place(u)
        both = " and penalty of gains" * (self.signs is not None)
        detail = f"free-run loss{both} {self.log.start_loss:.4g} -> {self.score:.4g}"
        if self.diverged:
            status = RESULTS.start_diverged if self.start_diverged else status
            detail += "; no better network was found that runs within its bounds"
        elif self.start_diverged:
            way = self.winner or "growing horizons"
            detail += f"; the start diverged, {way} led to one that does not"
        stats = self.log.stats(status, best.score, self.layout.parameters)
        stats |= {
            "start_diverged": self.start_diverged,
            "remedy": self.winner if self.start_diverged else "",
        }
        if self.layout.initial is not None:
            offset = u[self.layout.parameters :]
            stats["initial"] = offset.reshape(self.layout.initial.weight.shape)
        return Solution(network, status, stats, detail)
