"""Refinement on the one-step error: the search moves the partition alone."""

import dataclasses

import numpy as np

from jaxnarx.arrays.levenberg import Levenberg, State
from jaxnarx.arrays.minimise import Course, Progress, minimise
from jaxnarx.methods import PredictionError
from jaxnarx.models import Network
from jaxnarx.refinement.layout import Layout
from jaxnarx.refinement.problem import Problem
from jaxnarx.refinement.separable import Separable
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
    judge = Problem(layout, guard, guard.anchors(1)).loss
    course = Course(judge, start, progress)
    inner = layout.coefficients()
    outer = np.setdiff1d(np.arange(start.size), inner)
    part = Separable(Problem(layout, task, task.anchors(1)), inner, outer, start)
    status = _search(course, layout, part, method, prior)
    detail = f"one-step loss {course.start_score:.4g} -> {course.score:.4g}"
    network = layout.place(course.best)
    return Solution(network, status, course.stats(status, layout.parameters), detail)


def _search(
    course: Course,
    layout: Layout,
    part: Separable,
    method: PredictionError,
    prior: np.ndarray | None,
) -> RESULTS:
    """Solve for the coefficients, then move the partition."""
    start, p = course.best, course.best[part.outer]
    whole = part.problem.linear(start)
    if not np.any(np.diagonal(whole.gram) > 0):
        return RESULTS.unidentifiable
    pull = method.ridge * np.diagonal(whole.gram)
    if prior is not None:
        # Weighed against the noise that least squares of all coefficients leaves.
        slope = np.asarray(layout.slope(start))
        noise = part.loss(p) / max(int(part.samples), 1)
        pull = pull + noise * (slope * prior) ** 2
    part.pull = pull[part.inner]
    linear = part.linear(p)
    stepper = Levenberg(part)
    state = stepper.init(p, linear, pull[part.outer])

    def accepted(state: State) -> bool:
        done = len(course.history) + 1
        where = {"of": method.max_steps + 1, "done": done, "stage": "one step"}
        course.note(state, part.u, **where, horizon=1, stage_step=done)
        return course.since >= method.patience

    accepted(dataclasses.replace(state, damping=0.0))
    if not p.size:
        return RESULTS.ok
    steps, tolerance = method.max_steps, method.tolerance
    return minimise(
        stepper, state, steps=steps, tolerance=tolerance, accepted=accepted
    )[2]
