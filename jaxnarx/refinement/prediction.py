"""Refinement on the one-step error: the search moves the partition alone."""

from collections.abc import Callable

import numpy as np

from jaxnarx.arrays import (
    Driver,
    Levenberg,
    Progress,
    SearchLog,
    SearchState,
    StepFigures,
    StoppingRules,
    begin_levenberg,
    begin_search,
    evaluate_at,
    strip_names,
)
from jaxnarx.models import Network
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.problem import Problem, make_problem
from jaxnarx.refinement.separable import separable
from jaxnarx.refinement.training_data import TrainingData
from jaxnarx.settings import PredictionError
from jaxnarx.solution import RESULTS, Solution


def refine_prediction(
    layout: Layout,
    task: TrainingData,
    guard: TrainingData,
    method: PredictionError,
    prior: np.ndarray | None = None,
    progress: Progress | None = None,
) -> Solution[Network]:
    """The network of the least one-step error; judged by that of the guard.

    Only samples with a complete measured history count. Statuses as `refine`.
    """
    task, guard = task.one_step(), guard.one_step()
    start = np.asarray(layout.gather(layout.base))
    validate = strip_names(make_problem(layout, guard, 1)).loss
    loss = np.asarray(evaluate_at(validate, start))
    log = SearchLog(loss, progress)
    problem = make_problem(layout, task, 1, ridge=method.ridge, prior=prior)
    search = begin_search(begin_levenberg(start), loss)
    search, status = _minimise(search, log, layout, problem, validate, method)
    best = search.best
    detail = f"one-step loss {log.start_loss:.4g} -> {float(best.score.loss):.4g}"
    network = layout.place(np.asarray(best.u))
    stats = log.stats(status, best.score, layout.parameters)
    return Solution(network, status, stats, detail)


def _minimise(
    search: SearchState,
    log: SearchLog,
    layout: Layout,
    problem: Problem,
    validate: Callable,
    method: PredictionError,
) -> tuple[SearchState, RESULTS]:
    """Solve for the coefficients, then move the partition."""
    start = np.asarray(search.best.u)
    part, informed = separable(problem, layout.coefficients(), start)
    if not informed:
        return search, RESULTS.unidentifiable

    def report(now: StepFigures) -> None:
        done = len(log.history) + 1
        where = {"of": method.max_steps + 1, "done": done, "stage": "one step"}
        log.add(now, **where, horizon=1, stage_step=done)

    rules = StoppingRules(method.tolerance, method.patience)
    driver = Driver(Levenberg(part), validate, rules)
    search, begun = driver.start(search)
    report(begun._replace(damping=0.0))
    if not part.outer.size:
        return search, RESULTS.ok
    return driver.minimise(search, method.max_steps, report)
