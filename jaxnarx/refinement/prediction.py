"""Refinement on the one-step error: the search moves the partition alone."""

import time as clock
from typing import Any

import jax
import numpy as np

from jaxnarx.methods import PredictionError
from jaxnarx.models import Network
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.levenberg import Levenberg
from jaxnarx.refinement.problem import Problem
from jaxnarx.refinement.search import Progress
from jaxnarx.refinement.separable import Separable
from jaxnarx.refinement.task import Task
from jaxnarx.solution import NAMES, RESULTS, Solution, code


class _Prediction:
    """Bookkeeping of one search: the best so far by the guard, and the history."""

    def __init__(self, layout: Layout, task: Task, guard: Task, method, progress):
        self.layout, self.method, self.progress = layout, method, progress
        task, guard = task.one_step(), guard.one_step()
        self.judge = Problem(layout, guard, guard.anchors(1)).loss
        self.best = np.asarray(layout.gather(layout.base))
        self.start_score = self.score = self.judge(self.best)
        self.begin = clock.perf_counter()
        self.since = 0
        self.history: list[dict[str, Any]] = []
        inner = layout.coefficients()
        outer = np.setdiff1d(np.arange(self.best.size), inner)
        problem = Problem(layout, task, task.anchors(1))
        self.part = Separable(problem, inner, outer, self.best)

    def consider(
        self, u: np.ndarray, loss: float, minimised: float, damping: float
    ) -> None:
        """Keep `u` if its guard score is the best."""
        score = self.judge(u)
        if score < self.score:
            self.best, self.score, self.since = u, score, 0
        else:
            self.since += 1
        row = {
            "step": len(self.history) + 1,
            "of": self.method.max_steps + 1,
            "done": len(self.history) + 1,
            "stage": "one step",
            "horizon": 1,
            "stage_step": len(self.history) + 1,
            "loss": loss,
            "minimised": minimised,
            "validation": score,
            "diverged": False,
            "damping": damping,
            "seconds": clock.perf_counter() - self.begin,
        }
        self.history.append(row)
        if self.progress is not None:
            self.progress(row)

    def run(self, prior: np.ndarray | None) -> RESULTS:
        """Solve for the coefficients, then move the partition."""
        p = self.best[self.part.outer]
        whole = self.part.problem.linear(self.best)
        if not np.any(np.diagonal(whole.gram) > 0):
            return RESULTS.unidentifiable
        pull = self.method.ridge * np.diagonal(whole.gram)
        if prior is not None:
            # Weighed against the noise that least squares of all coefficients leaves.
            slope = np.asarray(self.layout.slope(jax.device_put(self.best)))
            noise = self.part.loss(p) / max(int(self.part.samples), 1)
            pull = pull + noise * (slope * prior) ** 2
        self.part.pull = pull[self.part.inner]
        linear = self.part.linear(p)
        self.consider(self.part.u, linear.loss, linear.loss, 0.0)
        if not p.size:
            return RESULTS.ok
        stepper = Levenberg(self.part)
        state = stepper.init(p, linear, pull[self.part.outer])
        small = 0
        for _ in range(self.method.max_steps):
            state, status = stepper.step(state)
            if status != RESULTS.ok:
                stalled = status == RESULTS.stalled
                return RESULTS.ok if stalled and stepper.arrived(state) else status
            self.consider(self.part.u, state.loss, state.minimised, state.damping)
            small = small + 1 if state.gain < self.method.tolerance else 0
            if small >= 2:
                return RESULTS.ok
            if self.since >= self.method.patience:
                return RESULTS.no_improvement
        return RESULTS.budget_spent


def refine_prediction(
    layout: Layout,
    task: Task,
    guard: Task,
    method: PredictionError,
    prior: np.ndarray | None = None,
    progress: Progress | None = None,
) -> Solution[Network]:
    """The network of the least one-step error; judged by that of the guard.

    Only samples with a complete measured history count. Statuses as `refine`.
    """
    search = _Prediction(layout, task, guard, method, progress)
    status = search.run(prior)
    stats = {
        "history": search.history,
        "loss": search.score,
        "loss_start": search.start_score,
        "steps": len(search.history),
        "parameters": layout.parameters,
        "seconds": clock.perf_counter() - search.begin,
        "end": NAMES[int(code(status))],
    }
    detail = f"one-step loss {search.start_score:.4g} -> {search.score:.4g}"
    network = layout.place(search.best)
    return Solution(network, status, stats, detail)
