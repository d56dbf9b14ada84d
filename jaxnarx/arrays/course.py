"""A search as arrays: steps of a method, what a judge says of them, the best, the end.

A method makes steps, see `AbstractMethod`. `advance` makes one of them, has the point
judged, keeps the best so far and says when a stage ends; all of it is arrays. Two
drivers: `minimise` on the host, one program per step, with a history and a callback,
and the loop of a sweep inside its own program.
"""

import abc
import time as clock
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.programs import bound, plain, program
from jaxnarx.solution import NAMES, RESULTS, code

ROUNDING_LOSS = 1e-24
"""Loss (a mean square of scaled errors) that is nothing but rounding of float64."""
QUIET_STEPS = 2
"""Steps in a row that gain little, after which a stage ends."""
NEVER = 2**30
"""A number of steps that no search makes."""

OK, NO_IMPROVEMENT, NOT_RUN = map(NAMES.index, ("ok", "no_improvement", "not_run"))

Vector = Float[Array | np.ndarray, " params"]
Number = Float[Array | np.ndarray, ""]
Count = Int[Array | np.ndarray, ""]
Flag = Bool[Array | np.ndarray, ""]

Progress = Callable[[dict[str, Any]], None]


class AbstractState(eqx.Module):
    """Where a method stands.

    `minimised` is the loss and the pull to the start, `gain` its relative decrease by
    the last step. `status` is the code of that of the last step: `ok` where the method
    has moved, `not_run` before the first, which takes stock of the start and does not
    move, and else why it has not.
    """

    minimised: Number
    gain: Number
    damping: Number
    status: Count

    @property
    @abc.abstractmethod
    def u(self) -> Any:
        """The point."""

    @property
    @abc.abstractmethod
    def loss(self) -> Any:
        """The loss there, without the pull."""


class AbstractMethod(eqx.Module):
    """What makes steps: of Levenberg-Marquardt, of a solver of optimistix or optax."""

    @abc.abstractmethod
    def step(self, s: Any) -> Any:
        """One step that is taken, or none."""

    @abc.abstractmethod
    def has_arrived(self, s: Any) -> Flag:
        """Whether no step from here promises a decrease worth naming."""


class Judged(eqx.Module):
    """Whether a free run diverges, and its loss; one without a loss diverges."""

    diverged: Flag
    loss: Number

    def better(self, other: "Judged") -> Flag:
        """Whether this is the better one: a network that runs beats one that does
        not."""
        same = self.diverged == other.diverged
        return jnp.where(same, self.loss < other.loss, other.diverged)

    @property
    def told(self) -> tuple[bool, float]:
        """On the host; the smaller is the better one."""
        return bool(self.diverged), float(self.loss)


class JudgedPoint(eqx.Module):
    """Parameters, what a judge says of them, and the number of the attempt that has
    led there."""

    u: Vector
    judged: Judged
    attempt: Count


class Standing(eqx.Module):
    """The best so far. Nothing with a loss above `limit`, the start's, is `best`.

    `lead` is the best since the search began anew, whatever its loss; `since` counts
    the points after it.
    """

    best: JudgedPoint
    lead: JudgedPoint
    limit: Number
    since: Count

    def offered(self, here: JudgedPoint) -> "Standing":
        """With a point that may be the best."""
        best = here.judged.better(self.best.judged) & (here.judged.loss <= self.limit)
        leads = here.judged.better(self.lead.judged)
        return Standing(
            chosen(best, here, self.best),
            chosen(leads, here, self.lead),
            jnp.asarray(self.limit),
            jnp.where(leads, 0, self.since + 1),
        )


class Rules(eqx.Module):
    """When a stage ends: after `quiet` steps in a row that gain less than `tolerance`,
    at a loss of `rounding` alone, and after `patience` steps without a better point.
    """

    tolerance: Number
    patience: Count
    quiet: Count
    rounding: Number


def rules(
    tolerance: float | int,
    *,
    patience: int = NEVER,
    quiet: int = QUIET_STEPS,
    rounding: float = ROUNDING_LOSS,
) -> Rules:
    """The rules of one stage, as arrays of the host."""
    return Rules(*map(np.asarray, (float(tolerance), patience, quiet, rounding)))


class Course(eqx.Module):
    """A search under way: where its method stands, and the best so far by a judge.

    `attempt` is the number of the present one, `here` what the judge has said last.
    `small` counts steps in a row that gained little, `steps` all that were taken. A
    stage that has `ended` makes no more of them: `status` is then `no_improvement`
    where patience has ended it, and else the method's.
    """

    state: Any
    standing: Standing
    attempt: Count
    here: Judged
    steps: Count
    small: Count
    ended: Flag
    status: Count

    @property
    def best(self) -> JudgedPoint:
        """The best so far."""
        return self.standing.best


def begin_course(state: Any, judged: Judged | None = None) -> Course:
    """A search from where a method begins; without a judge no point is the best."""
    u, zero = state.u, np.asarray(0)
    if judged is None:
        judged = Judged(np.asarray(False), np.asarray(np.inf, u.dtype))
    point = JudgedPoint(u, judged, zero)
    standing = Standing(point, point, judged.loss, zero)
    ended, none = np.asarray(False), np.asarray(NOT_RUN)
    return Course(state, standing, zero, judged, zero, zero, ended, none)


def advance(
    method: AbstractMethod,
    judge: Callable[[Any], Any] | None,
    ends: Rules,
    c: Course,
    look: Any = True,
) -> Course:
    """One step, and what comes of it; the first takes stock of where a stage begins.

    That point is judged where one is to `look`, every other one that is reached always.
    A `judge` gives a `Judged`, or a loss alone.
    """
    fresh = c.state.status == NOT_RUN
    state = method.step(c.state)
    moved = ~fresh & (state.status == OK)

    def reached() -> tuple[Judged, Standing]:
        said = _judged(judge, state.u)
        return said, c.standing.offered(JudgedPoint(state.u, said, c.attempt))

    def stayed() -> tuple[Judged, Standing]:
        return jax.tree.map(jnp.asarray, (c.here, c.standing))

    here, standing = stayed()
    if judge is not None:
        visited = moved | (fresh & look)
        here, standing = jax.lax.cond(visited, reached, stayed)
    since = jnp.where(fresh, 0, standing.since)
    small = jnp.where(moved & (state.gain < ends.tolerance), c.small + 1, 0)
    quiet = (small >= ends.quiet) | (state.loss <= ends.rounding)
    enough = since >= ends.patience
    status = jnp.where(moved & enough & ~quiet, NO_IMPROVEMENT, state.status)
    return Course(
        state,
        eqx.tree_at(lambda s: s.since, standing, since),
        jnp.asarray(c.attempt),
        here,
        c.steps + moved.astype(c.steps.dtype),
        small,
        ~fresh & (~moved | quiet | enough),
        status.astype(c.status.dtype),
    )


def _judged(judge: Any, u: Any) -> Judged:
    said = judge(u)
    return said if isinstance(said, Judged) else Judged(jnp.zeros((), bool), said)


def chosen(first: Flag, a: Any, b: Any) -> Any:
    """The first of two trees of the same structure, or the second."""
    return jax.tree.map(lambda x, y: jnp.where(first, x, y), a, b)


@program
def offer(standing: Standing, here: JudgedPoint) -> Standing:
    """The best so far with a point that may be it, on the host."""
    return standing.offered(here)


@program
def value_at(function: Callable, u: Any) -> Any:
    """A loss or a judge of arrays, compiled, on the host."""
    return function(u)


class StepFigures(NamedTuple):
    """What a step has come to, in numbers of the host; `validation` and `diverged` are
    what the judge says."""

    loss: float
    minimised: float
    damping: float
    validation: float
    diverged: bool
    moved: bool
    ended: bool
    status: str


class Driver:
    """A stage driven from the host: one program for every step.

    Method and judge may hold networks, and are used without the names of channels.
    """

    def __init__(self, method: AbstractMethod, judge: Callable | None, ends: Rules):
        self.method, self.judge, self.ends = plain(method), judge, ends

    def start(self, c: Course, *, look: bool = True) -> tuple[Course, StepFigures]:
        """Take stock of where a stage begins, and judge it where one is to `look`."""
        step, tree, leaves = self._step(c)
        leaves, now = step(leaves, look)
        return jax.tree.unflatten(tree, leaves), now

    def minimise(
        self, c: Course, steps: int, told: Callable[[StepFigures], Any] = lambda _: None
    ) -> tuple[Course, RESULTS]:
        """At most so many steps of a stage, each that is taken `told`; and its status.

        `ok` where the steps gain little, where a method stalls because none promises a
        decrease, and at a loss of rounding alone; `no_improvement` where patience is
        spent; `budget_spent`, the usual end; else what the method says.
        """
        step, tree, leaves = self._step(c)
        status = RESULTS.budget_spent
        for _ in range(steps):
            leaves, now = step(leaves, True)
            if now.moved:
                told(now)
            if now.ended:
                status = self._status(jax.tree.unflatten(tree, leaves), now)
                break
        return jax.tree.unflatten(tree, leaves), status

    def _step(self, c: Course) -> tuple[Callable, Any, list]:
        """The program of a step on the leaves of a course, its tree, and its leaves.

        The tree is made anew at the end alone: for small problems that, step by step,
        took a tenth of the time.
        """
        leaves, tree = jax.tree.flatten(c)
        run = bound(_advance_and_tell, self.method, self.judge, self.ends, tree)

        def step(leaves: list, look: bool) -> tuple[list, StepFigures]:
            leaves, figures = run(leaves, look)
            *numbers, diverged, moved, ended, status = np.asarray(figures).tolist()
            loss, minimised, damping, validation = numbers
            return leaves, StepFigures(
                loss,
                minimised,
                damping,
                validation,
                diverged=bool(diverged),
                moved=bool(moved),
                ended=bool(ended),
                status=NAMES[int(status)],
            )

        return step, tree, leaves

    def _status(self, c: Course, now: StepFigures) -> RESULTS:
        stalled, rests = now.status == "stalled", now.loss <= self.ends.rounding
        if stalled and (rests or bool(value_at(self.method.has_arrived, c.state))):
            return RESULTS.ok
        return getattr(RESULTS, now.status)


def _advance_and_tell(method, judge, ends, tree, leaves, look) -> tuple[list, Array]:
    c = jax.tree.unflatten(tree, leaves)
    new = advance(method, judge, ends, c, look)
    s, here = new.state, new.here
    figures = [s.loss, s.minimised, s.damping, here.loss, here.diverged]
    figures += [new.steps > c.steps, new.ended, new.status]
    figures = [jnp.asarray(f).astype(s.gain.dtype) for f in figures]
    return jax.tree.leaves(new), jnp.stack(figures)


class History:
    """The steps of a search as its user sees them."""

    def __init__(self, start: Judged, progress: Progress | None):
        self.start, self.progress = float(start.loss), progress
        self.rows: list[dict[str, Any]] = []
        self.begin = clock.perf_counter()

    def note(self, now: StepFigures, *, name: str = "", **where: Any) -> None:
        """Write down where a step has led, in the attempt of that name, and tell it."""
        row = {"step": len(self.rows) + 1} | where
        row |= {"loss": now.loss, "minimised": now.minimised}
        row |= {"validation": now.validation, "diverged": now.diverged}
        row |= {"start": name} if name else {}
        row |= {"damping": now.damping, "seconds": clock.perf_counter() - self.begin}
        self.rows.append(row)
        if self.progress is not None:
            self.progress(row)

    def stats(self, status: RESULTS, best: Judged, parameters: int) -> dict[str, Any]:
        """What every search tells in the end."""
        return {
            "history": self.rows,
            "loss": float(best.loss),
            "loss_start": self.start,
            "steps": len(self.rows),
            "parameters": parameters,
            "seconds": clock.perf_counter() - self.begin,
            "end": NAMES[int(code(status))],
        }
