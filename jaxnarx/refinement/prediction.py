"""Refinement on the one-step error: the search moves the partition alone."""

import dataclasses
from collections.abc import Callable

import numpy as np

from jaxnarx.arrays import (
    Course,
    Levenberg,
    Progress,
    Standing,
    minimise,
    plain,
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
    course = Course(start, float(value_at(judge, start)), progress)
    problem = make_problem(layout, task, 1, ridge=method.ridge, prior=prior)
    status = _search(course, layout, problem, judge, method)
    detail = f"one-step loss {course.start_score:.4g} -> {course.score:.4g}"
    network = layout.place(course.best)
    return Solution(network, status, course.stats(status, layout.parameters), detail)


def _search(
    course: Course,
    layout: Layout,
    problem: Problem,
    judge: Callable,
    method: PredictionError,
) -> RESULTS:
    """Solve for the coefficients, then move the partition."""
    part, informed = separable(problem, layout.coefficients(), course.best)
    if not informed:
        return RESULTS.unidentifiable

    def accepted(s: Standing) -> bool:
        done = len(course.history) + 1
        where = {"of": method.max_steps + 1, "done": done, "stage": "one step"}
        course.note(s, **where, horizon=1, stage_step=done)
        return course.since >= method.patience

    search = Levenberg(part, judge)
    begin = search.start(course.best, look=True)
    accepted(dataclasses.replace(begin, damping=0.0))
    if not part.outer.size:
        return RESULTS.ok
    _, _, status = minimise(
        search,
        begin,
        steps=method.max_steps,
        tolerance=method.tolerance,
        accepted=accepted,
    )
    return status
