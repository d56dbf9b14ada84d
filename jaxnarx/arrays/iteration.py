"""Iterative searches as arrays: steps, validation, the best so far, stopping rules.

A method makes steps, see `AbstractMethod`. `advance` makes one, scores the point it has
reached, keeps the best so far and says when a stage ends; all of it is arrays. On the
host `Driver` runs one program per step; a sweep calls `advance` in its own loop.
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

from jaxnarx.arrays.programs import bind, program, strip_names
from jaxnarx.solution import RESULTS, STATUS_NAMES, code

ROUNDING_LOSS = 1e-24
"""Loss (a mean square of scaled errors) that is nothing but rounding of float64."""
QUIET_STEPS = 2
"""Steps in a row that gain little, after which a stage ends."""
UNREACHED_STEPS = 2**30
"""A number of steps that no search makes."""

OK, NO_IMPROVEMENT, STALLED, DIVERGED, UNIDENTIFIABLE, NOT_RUN = map(
    STATUS_NAMES.index,
    ("ok", "no_improvement", "stalled", "diverged", "unidentifiable", "not_run"),
)
"""Codes of the statuses that steps and stages have."""

Vector = Float[Array | np.ndarray, " params"]
Number = Float[Array | np.ndarray, ""]
Count = Int[Array | np.ndarray, ""]
Flag = Bool[Array | np.ndarray, ""]

Progress = Callable[[dict[str, Any]], None]


class AbstractState(eqx.Module):
    """The state of a method: the point `u` and its loss.

    `minimised` is the loss with the regularisation, `gain` its relative decrease by the
    last step. `status` is the code of that of the last step: `ok` where the method has
    moved, `not_run` before the first, which evaluates the start and does not move, and
    else why it has not.
    """

    minimised: eqx.AbstractVar[Number]
    gain: eqx.AbstractVar[Number]
    damping: eqx.AbstractVar[Number]
    status: eqx.AbstractVar[Count]

    @property
    @abc.abstractmethod
    def u(self) -> Any:
        """The point."""

    @property
    @abc.abstractmethod
    def loss(self) -> Any:
        """The loss there, without the regularisation."""


class AbstractMethod(eqx.Module):
    """A method that makes steps: Levenberg-Marquardt, a solver of optimistix or of
    optax."""

    @abc.abstractmethod
    def step(self, s: Any) -> Any:
        """One step that is taken, or none."""

    @abc.abstractmethod
    def has_arrived(self, s: Any) -> Flag:
        """Whether no step from here promises a decrease worth naming."""


class ValidationScore(eqx.Module):
    """Whether a free run diverges, and its loss; one without a loss diverges."""

    diverged: Bool[Array | np.ndarray, ""]
    loss: Float[Array | np.ndarray, ""]

    def better(self, other: "ValidationScore") -> Bool[Array | np.ndarray, ""]:
        """Whether this is the better one: a network that runs beats one that does
        not."""
        same = self.diverged == other.diverged
        return jnp.where(same, self.loss < other.loss, other.diverged)

    @property
    def on_host(self) -> tuple[bool, float]:
        """The score as numbers of Python; the smaller is the better one."""
        return bool(self.diverged), float(self.loss)


def as_score(found: Any) -> ValidationScore:
    """A score, or a loss alone, of a run that does not diverge."""
    if isinstance(found, ValidationScore):
        return found
    xp = np if isinstance(found, np.ndarray) else jnp
    return ValidationScore(xp.zeros((), bool), found)


class ScoredPoint(eqx.Module):
    """Parameters, their validation score, and the number of the attempt that has led
    there."""

    u: Vector
    score: ValidationScore
    attempt: Count


class Incumbents(eqx.Module):
    """The best so far; nothing with a loss above `start_loss` is `best`.

    `lead` is the best since the search began anew, whatever its loss; `since` counts
    the points after it.
    """

    best: ScoredPoint
    lead: ScoredPoint
    start_loss: Number
    since: Count

    def include(self, here: ScoredPoint) -> "Incumbents":
        """The incumbents with a point that may be the best."""
        low = here.score.loss <= self.start_loss
        leads = here.score.better(self.lead.score)
        return Incumbents(
            select_tree(here.score.better(self.best.score) & low, here, self.best),
            select_tree(leads, here, self.lead),
            jnp.asarray(self.start_loss),
            jnp.where(leads, 0, self.since + 1),
        )


class StoppingRules(eqx.Module):
    """When a stage ends: after `quiet` steps in a row that gain less than `tolerance`,
    at a loss of `rounding` alone, and after `patience` steps without a better point.
    """

    tolerance: Array = eqx.field(converter=jnp.asarray)
    patience: Array = eqx.field(converter=jnp.asarray, default=UNREACHED_STEPS)
    quiet: Array = eqx.field(converter=jnp.asarray, default=QUIET_STEPS)
    rounding: Array = eqx.field(converter=jnp.asarray, default=ROUNDING_LOSS)


class SearchState(eqx.Module):
    """A search under way: where its method stands, and the best so far.

    `attempt` is the number of the present one, `score` that of the last point that was
    scored. `small` counts steps in a row that gained little, `steps` all that were
    taken. A stage that has `ended` makes no more of them: `status` is then
    `no_improvement` where patience has ended it, and else the method's.
    """

    state: Any
    incumbents: Incumbents
    attempt: Count
    score: ValidationScore
    steps: Count
    small: Count
    ended: Flag
    status: Count

    @property
    def best(self) -> ScoredPoint:
        """The best so far."""
        return self.incumbents.best


def begin_search(state: Any, score: Any = None) -> SearchState:
    """A search from where a method begins, with the score, or the loss, of that point.

    Without one, for searches without validation, the best stays the start.
    """
    u, zero = state.u, np.asarray(0)
    first = as_score(np.asarray(np.inf, u.dtype) if score is None else score)
    point = ScoredPoint(u, first, zero)
    incumbents = Incumbents(point, point, first.loss, zero)
    ended, none = np.asarray(False), np.asarray(NOT_RUN)
    return SearchState(state, incumbents, zero, first, zero, zero, ended, none)


def advance(
    method: AbstractMethod,
    validate: Callable[[Any], Any] | None,
    rules: StoppingRules,
    s: SearchState,
    look: Any = True,
) -> SearchState:
    """One step, its score, the best so far, and whether the stage ends.

    The first step of a stage evaluates its start and does not move: that point is
    scored where one is to `look`, every one that is reached later always. `validate`
    gives a `ValidationScore`, or a loss alone.
    """
    fresh = s.state.status == NOT_RUN
    state = method.step(s.state)
    moved = ~fresh & (state.status == OK)

    def score_point() -> tuple[ValidationScore, Incumbents]:
        assert validate is not None
        score = as_score(validate(state.u))
        return score, s.incumbents.include(ScoredPoint(state.u, score, s.attempt))

    def keep_score() -> tuple[ValidationScore, Incumbents]:
        return jax.tree.map(jnp.asarray, (s.score, s.incumbents))

    score, incumbents = keep_score()
    if validate is not None:
        score, incumbents = jax.lax.cond(
            moved | (fresh & look), score_point, keep_score
        )
    since = jnp.where(fresh, 0, incumbents.since)
    small = jnp.where(moved & (state.gain < rules.tolerance), s.small + 1, 0)
    quiet = (small >= rules.quiet) | (state.loss <= rules.rounding)
    enough = since >= rules.patience
    status = jnp.where(moved & enough & ~quiet, NO_IMPROVEMENT, state.status)
    return SearchState(
        state,
        eqx.tree_at(lambda i: i.since, incumbents, since),
        jnp.asarray(s.attempt),
        score,
        s.steps + moved.astype(s.steps.dtype),
        small,
        ~fresh & (~moved | quiet | enough),
        status.astype(s.status.dtype),
    )


def select_tree(first: Flag, a: Any, b: Any) -> Any:
    """The first of two trees of the same structure, or the second."""
    return jax.tree.map(lambda x, y: jnp.where(first, x, y), a, b)


@program
def update_incumbents(incumbents: Incumbents, here: ScoredPoint) -> Incumbents:
    """The best so far with a point that may be it, on the host."""
    return incumbents.include(here)


@program
def evaluate_at(function: Callable, u: Any) -> Any:
    """A function of arrays, compiled, on the host."""
    return function(u)


class StepFigures(NamedTuple):
    """Figures of one step, as numbers of the host; `validation` and `diverged` are the
    score, `status` is a code."""

    loss: float
    minimised: float
    damping: float
    validation: float
    diverged: float
    moved: float
    ended: float
    status: float

    @property
    def status_name(self) -> str:
        """Why the method has not moved, or `ok`."""
        return STATUS_NAMES[int(self.status)]


class Driver:
    """A stage driven from the host: one program for every step.

    `method` and `validate` may hold networks, and are used without names of channels.
    """

    def __init__(
        self, method: AbstractMethod, validate: Callable | None, rules: StoppingRules
    ):
        self.method, self.validate, self.rules = strip_names(method), validate, rules

    def start(
        self, s: SearchState, *, look: bool = True
    ) -> tuple[SearchState, StepFigures]:
        """Evaluate where a stage begins, and score it where one is to `look`."""
        step, tree, leaves = self._step(s)
        leaves, now = step(leaves, look)
        return jax.tree.unflatten(tree, leaves), now

    def minimise(
        self,
        s: SearchState,
        steps: int,
        report: Callable[[StepFigures], Any] = lambda _: None,
    ) -> tuple[SearchState, RESULTS]:
        """At most so many steps of a stage; `report` hears of each that is taken.

        The status is `ok` where the steps gain little, where a method stalls because
        none promises a decrease, and at a loss of rounding alone; `no_improvement`
        where patience is spent; `budget_spent`, the usual end; else what the method
        says.
        """
        step, tree, leaves = self._step(s)
        status = RESULTS.budget_spent
        for _ in range(steps):
            leaves, now = step(leaves, True)
            if now.moved:
                report(now)
            if now.ended:
                status = self._status(jax.tree.unflatten(tree, leaves), now)
                break
        return jax.tree.unflatten(tree, leaves), status

    def _step(self, s: SearchState) -> tuple[Callable, Any, list]:
        """The program of a step on the leaves of a search, its tree, and its leaves.

        The tree is made anew at the end alone: for small problems that, step by step,
        took a tenth of the time.
        """
        leaves, tree = jax.tree.flatten(s)
        run = bind(_advance_and_tell, self.method, self.validate, self.rules, tree)

        def step(leaves: list, look: bool) -> tuple[list, StepFigures]:
            leaves, figures = run(leaves, look)
            return leaves, StepFigures(*np.asarray(figures).tolist())

        return step, tree, leaves

    def _status(self, s: SearchState, now: StepFigures) -> RESULTS:
        rests = now.loss <= float(self.rules.rounding)
        stalled = now.status_name == "stalled"
        if stalled and (rests or bool(self.method.has_arrived(s.state))):
            return RESULTS.ok
        return getattr(RESULTS, now.status_name)


def _advance_and_tell(
    method, validate, rules, tree, leaves, look
) -> tuple[list, Array]:
    before = jax.tree.unflatten(tree, leaves)
    new = advance(method, validate, rules, before, look)
    s, score = new.state, new.score
    # In the order of StepFigures.
    figures = [s.loss, s.minimised, s.damping, score.loss, score.diverged]
    figures += [new.steps > before.steps, new.ended, new.status]
    numbers = [jnp.asarray(f).astype(s.gain.dtype) for f in figures]
    return jax.tree.leaves(new), jnp.stack(numbers)


class SearchLog:
    """The steps of a search as its user sees them, and the loss it begins with."""

    def __init__(self, start: Any, progress: Progress | None):
        self.start_loss, self.progress = float(as_score(start).loss), progress
        self.history: list[dict[str, Any]] = []
        self.begin = clock.perf_counter()

    def add(self, now: StepFigures, *, name: str = "", **where: Any) -> None:
        """Write down what a step of the attempt `name` has come to, and report it."""
        row = {"step": len(self.history) + 1} | where
        row |= {"loss": now.loss, "minimised": now.minimised}
        row |= {"validation": now.validation, "diverged": bool(now.diverged)}
        row |= {"start": name} if name else {}
        row |= {"damping": now.damping, "seconds": clock.perf_counter() - self.begin}
        self.history.append(row)
        if self.progress is not None:
            self.progress(row)

    def stats(
        self, status: RESULTS, best: ValidationScore, parameters: int
    ) -> dict[str, Any]:
        """Figures that every search returns."""
        return {
            "history": self.history,
            "loss": float(best.loss),
            "loss_start": self.start_loss,
            "steps": len(self.history),
            "parameters": parameters,
            "seconds": clock.perf_counter() - self.begin,
            "end": STATUS_NAMES[int(code(status))],
        }
