"""Steps, scores and stops of a search: the same on the host and in a program."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.arrays import (
    AbstractProblem,
    Driver,
    Levenberg,
    Linear,
    SearchLog,
    StoppingRules,
    ValidationScore,
    advance,
    begin_levenberg,
    begin_search,
    select_tree,
)
from jaxnarx.solution import RESULTS


class Valley(AbstractProblem):
    """Rosenbrock's function, residuals 1 - a and 10 (b - a^2)."""

    @property
    def wall(self):
        return jnp.full(2, jnp.inf)

    def residuals(self, u):
        return jnp.stack([1.0 - u[0], 10.0 * (u[1] - u[0] ** 2)])

    def loss(self, u):
        return jnp.sum(self.residuals(u) ** 2)

    def linear(self, u):
        r, j = self.residuals(u), jax.jacfwd(self.residuals)(u)
        return Linear(u, r @ r, j.T @ r, j.T @ j)

    def pull(self, start):
        return jnp.zeros_like(start.u)


START = np.array([-1.2, 1.0])


class Near(eqx.Module):
    """A judge that prefers points near one, and calls those left of -1 diverged."""

    point: Any

    def __call__(self, u) -> ValidationScore:
        return ValidationScore(u[0] < -1.0, ((u - self.point) ** 2).sum())


def towards(*point: float) -> Near:
    return Near(np.array(point))


def judged_start(judge: Near) -> ValidationScore:
    loss = np.asarray(((START - judge.point) ** 2).sum())
    return ValidationScore(np.asarray(True), loss)


def begun(judge: Near):
    return begin_search(begin_levenberg(START), judged_start(judge))


@jax.jit
def inside(judge, ends, steps, course):
    """The whole search as one program: stock-taking and so many steps at most."""

    def step(_, c):
        return select_tree(c.ended, c, advance(Levenberg(Valley()), judge, ends, c))

    course = jax.tree.map(jnp.asarray, course)
    return jax.lax.fori_loop(0, steps + 1, step, course)


def on_the_host(judge, ends, steps: int):
    driver, figures = Driver(Levenberg(Valley()), judge, ends), []
    course, _ = driver.start(begun(judge))
    course, status = driver.minimise(course, steps, figures.append)
    return course, status, figures


@pytest.mark.parametrize(
    ("tolerance", "patience", "end"),
    [(0.0, 2**30, "ok"), (0.9999, 2**30, "ok"), (0.0, 3, "no_improvement")],
)
def test_a_program_and_the_host_come_to_the_same(tolerance, patience, end):
    judge, ends = towards(0.2, 0.1), StoppingRules(tolerance, patience=patience)
    course, status, figures = on_the_host(judge, ends, 60)
    same = inside(judge, ends, 60, begun(judge))
    assert status == getattr(RESULTS, end)
    for a, b in zip(jax.tree.leaves(course), jax.tree.leaves(same), strict=True):
        np.testing.assert_allclose(np.asarray(a, float), np.asarray(b, float), 1e-9)
    assert len(figures) == int(course.steps) and bool(course.ended)


def test_the_best_is_the_best_of_all_points_that_were_judged():
    judge = towards(0.2, 0.1)
    course, _, figures = on_the_host(judge, StoppingRules(0.0), 60)
    running = [f.validation for f in figures if not f.diverged]
    assert float(course.best.score.loss) == min(running)
    assert figures[0].validation > min(running) < figures[-1].validation
    at = running.index(min(running))
    later = len(running) - 1 - at
    assert int(course.incumbents.since) == later > 0
    # The valley's end is not the judge's best, and the method has gone there.
    assert float(course.state.loss) < 1e-20


def test_no_point_above_the_start_is_best_though_it_may_lead():
    judge = towards(*START)
    course, _, _ = on_the_host(judge, StoppingRules(0.0), 60)
    # The start diverges: whatever runs leads, but nothing comes nearer to it.
    best, lead = course.incumbents.best, course.incumbents.lead
    assert best.score.diverged and not lead.score.diverged
    np.testing.assert_array_equal(course.best.u, START)


def test_without_a_look_the_start_of_a_stage_is_not_judged():
    judge = towards(1.0, 1.0)
    driver = Driver(Levenberg(Valley()), judge, StoppingRules(0.0))
    runs = ValidationScore(np.asarray(False), np.asarray(9.0))
    far = begin_search(begin_levenberg(START), runs)
    near = dataclasses.replace(far, state=begin_levenberg(np.array([1.1, 1.1])))
    course, _ = driver.start(near, look=False)
    assert float(course.best.score.loss) == 9.0
    course, _ = driver.start(near)
    assert float(course.best.score.loss) == pytest.approx(0.02)


def test_history_tells_every_step_in_numbers_of_the_host():
    rows = []
    judge = towards(1.0, 1.0)
    log = SearchLog(judged_start(judge), rows.append)
    driver = Driver(Levenberg(Valley()), judge, StoppingRules(0.0))
    course, _ = driver.start(begun(judge))
    course, status = driver.minimise(
        course, 4, lambda now: log.add(now, name="first", stage="whole")
    )
    assert rows == log.history and len(rows) == 4
    assert rows[1]["step"] == 2 and rows[1]["start"] == "first"
    stats = log.stats(status, course.best.score, 2)
    assert stats["end"] == "budget_spent" and stats["loss"] < stats["loss_start"]
    assert all(type(row["loss"]) is float for row in rows)
