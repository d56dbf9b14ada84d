"""Refinement on the one-step error: the search moves the partition alone."""

from collections.abc import Callable

import numpy as np

from jaxnarx.arrays import (
    Course,
    Driver,
    History,
    Judged,
    Levenberg,
    Progress,
    StepFigures,
    begin_course,
    begin_levenberg,
    plain,
    rules,
    value_at,
)
from jaxnarx.methods import PredictionError
from jaxnarx.models import Network
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.problem import Problem, make_problem
from jaxnarx.refinement.separable import separable
from jaxnarx.refinement.task import Task
from jaxnarx.solution import RESULTS, Solution


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
    task, guard = task.one_step(), guard.one_step()
    start = np.asarray(layout.gather(layout.base))
    judge = plain(make_problem(layout, guard, 1)).loss
    first = Judged(np.asarray(False), np.asarray(value_at(judge, start)))
    history = History(first, progress)
    course = begin_course(begin_levenberg(start), first)
    problem = make_problem(layout, task, 1, ridge=method.ridge, prior=prior)
    course, status = _search(course, history, layout, problem, judge, method)
    best = course.best
    detail = f"one-step loss {history.start:.4g} -> {float(best.judged.loss):.4g}"
    network = layout.place(np.asarray(best.u))
    stats = history.stats(status, best.judged, layout.parameters)
    return Solution(network, status, stats, detail)


def _search(
    course: Course,
    history: History,
    layout: Layout,
    problem: Problem,
    judge: Callable,
    method: PredictionError,
) -> tuple[Course, RESULTS]:
    """Solve for the coefficients, then move the partition."""
    start = np.asarray(course.best.u)
    part, informed = separable(problem, layout.coefficients(), start)
    if not informed:
        return course, RESULTS.unidentifiable

    def note(now: StepFigures) -> None:
        done = len(history.rows) + 1
        where = {"of": method.max_steps + 1, "done": done, "stage": "one step"}
        history.note(now, **where, horizon=1, stage_step=done)

    ends = rules(method.tolerance, patience=method.patience)
    driver = Driver(Levenberg(part), judge, ends)
    course, begun = driver.start(course)
    note(begun._replace(damping=0.0))
    if not part.outer.size:
        return course, RESULTS.ok
    return driver.minimise(course, method.max_steps, note)
