"""The refinement inside the program: the stages of Levenberg-Marquardt.

The end of a step is scored by the free run of the validation records, and the best by
that score is the result: it is never worse there than the start. Problem and validation
are those of `jaxnarx.refinement`, steps and stopping rules those of `jaxnarx.arrays`,
and so the results are the verb's.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import (
    UNREACHED_STEPS,
    Levenberg,
    SearchState,
    StoppingRules,
    ValidationScore,
    advance,
    begin_anew,
    begin_levenberg,
    begin_search,
    select_tree,
)
from jaxnarx.refinement import (
    FEEDBACK_FACTORS,
    Layout,
    Problem,
    Stage,
    Validator,
    shrunk,
    squares,
    stages,
)
from jaxnarx.settings import PredictionError, SimulationError
from jaxnarx.simulation import RunInputs, first_anchor, window_anchors
from jaxnarx.sweep.identify.engine_data import Part
from jaxnarx.sweep.identify.score import count_samples
from jaxnarx.sweep.identify.settings import Settings

WHOLE_RECORD = 2**30
"""A window longer than any record."""


class EngineTraining(eqx.Module):
    """The arrays that a refinement reads and never changes.

    `weight` makes mean squared NRMSE of the training errors, `guard_weight` of those of
    the records that judge; `moving` marks the parameters that are trained, `early`
    those that come first, fewer where the case is `staged`.
    """

    layout: Layout
    drive: RunInputs
    part: Part
    weight: Float[Array, "records time outputs"]
    guard: RunInputs
    guard_part: Part
    guard_weight: Float[Array, "_ _ outputs"]
    moving: Bool[Array, " params"]
    early: Bool[Array, " params"]
    staged: Bool[Array, ""]

    @property
    def validate(self) -> Validator:
        """The free run of the records that judge."""
        own, part = squares(1, self.weight.dtype), self.guard_part
        anchor, weight = jnp.asarray(first_anchor(part)), self.guard_weight
        start = jnp.asarray(part.start)
        return Validator(
            self.layout, self.guard, anchor, start, count_samples(part), weight, own
        )

    def problem(self, turn: "Turn", ridge: Float[Array, ""]) -> Problem:
        """The loss of the stage that a turn belongs to."""
        own, moving = squares(1, self.weight.dtype), self.moving
        anchor = jnp.asarray(window_anchors(self.part, turn.horizon))
        moving = jnp.where(turn.apart, self.early, moving)
        at = self.layout, self.drive, anchor, self.weight, own
        return Problem(*at, moving, ridge)


class Turn(eqx.Module):
    """One turn of the loop: window length, and its place in the stage.

    `apart`: a staged case trains its coefficients alone; `last`: the stage is.
    """

    horizon: Int[Array, "*turns"]
    step: Int[Array, "*turns"]
    apart: Bool[Array, "*turns"]
    last: Bool[Array, "*turns"]


class Trained(eqx.Module):
    """The best parameters, whether they are the start's, and the way there.

    `loss` and `judged` hold where the search stood after every turn; `factor` is what
    the feedback of a start that diverges was shrunk by, one where it was not.
    """

    u: Float[Array, " params"]
    start: ValidationScore
    best: ValidationScore
    accepted: Int[Array, ""]
    loss: Float[Array, " turns"]
    judged: Float[Array, " turns"]
    factor: Float[Array, ""]


def schedule(method: SimulationError | PredictionError, steps: int) -> Turn:
    """The stages of a staged case, in turns; a stage begins with step zero."""
    order = [Stage(1, steps)]
    if isinstance(method, SimulationError):
        horizons = [int(h) for h in method.horizons]
        order = stages(horizons, method.window_steps, steps, staged=True)
    rows = [
        (stage.horizon or WHOLE_RECORD, n, stage.only_coefficients, stage is order[-1])
        for stage in order
        for n in range(stage.steps + 1)
    ]
    return Turn(*(jnp.asarray(np.array(column)) for column in zip(*rows, strict=True)))


def active(
    data: EngineTraining, turns: Turn, settings: Settings
) -> Bool[Array, " turns"]:
    """Which turns a case makes: windows shorter than the longest record, and on full
    records its own number of steps, of coefficients alone where it is staged.
    """
    room = jnp.asarray(settings.steps)
    scored = jnp.any(jnp.asarray(data.part.scored), axis=2)
    longest = jnp.max(jnp.sum(scored, axis=1))
    full = (turns.last | data.staged) & (turns.step <= room)
    short = turns.horizon < longest
    own = jnp.where(turns.last | (turns.horizon == WHOLE_RECORD), full, short)
    # Windows are no use to a case without any step on full records.
    return own & jnp.any(data.moving) & (room > 0)


def train(
    data: EngineTraining, u: Float[Array, " params"], settings: Settings, turns: Turn
) -> Trained:
    """Run the whole schedule from `u`, and where nothing that runs is found, once more
    with shrunk feedback.
    """
    start = data.validate(u)
    begin = begin_search(begin_levenberg(u), start)
    begin = jax.tree.map(jnp.asarray, begin)
    made = active(data, turns, settings)
    # Only the turns that are made, so that the others cost nothing side by side either.
    order, count = jnp.argsort(~made, stable=True), jnp.sum(made)

    def step(n, carry):
        c, loss, judged = carry
        at = order[n]
        turn = jax.tree.map(lambda a: a[at], turns)
        c = jax.lax.cond(
            c.ended & (turn.step > 0),
            lambda: c,
            lambda: take_turn(data, c, turn, settings),
        )
        reached = c.best.score.loss
        return c, loss.at[at].set(c.state.loss), judged.at[at].set(reached)

    def attempt(carry):
        tried, _, _, c, loss, judged = carry
        factor, u, runs = jax.lax.cond(
            tried == 0,
            lambda: (jnp.ones_like(start.loss), begin.state.u, jnp.asarray(True)),
            lambda: _shrunk(data, begin.state.u),
        )
        c = eqx.tree_at(lambda c: c.state.linear.u, c, u)
        most = jnp.where(runs, count, 0)
        c, loss, judged = jax.lax.fori_loop(0, most, step, (c, loss, judged))
        return tried + 1, factor, runs, c, loss, judged

    history = jnp.full(made.shape, jnp.inf, u.dtype), jnp.full(made.shape, start.loss)
    _, factor, runs, end, *history = jax.lax.while_loop(
        lambda c: (c[0] == 0) | ((c[0] == 1) & c[3].best.score.diverged & (count > 0)),
        attempt,
        (0, jnp.ones_like(start.loss), jnp.asarray(True), begin, *history),
    )
    # A turn that is not made leaves everything where it was.
    before = jax.lax.cummax(jnp.where(made, jnp.arange(made.size), -1))
    loss, judged = (
        jnp.where(before < 0, first, column[before])
        for first, column in zip((jnp.inf, start.loss), history, strict=True)
    )
    factor = jnp.where(runs, factor, 1.0)
    best = end.best
    return Trained(best.u, start, best.score, end.steps, loss, judged, factor)


def _shrunk(data: EngineTraining, u: Float[Array, " params"]):
    """The first factor on the feedback whose free run does not diverge, that start, and
    whether there is one.
    """
    factors = jnp.asarray(FEEDBACK_FACTORS, u.dtype)

    def smaller(carry):
        n, _, _ = carry
        v = shrunk(data.layout, u, factors[n])
        return n + 1, v, ~data.validate(v).diverged

    n, v, runs = jax.lax.while_loop(
        lambda c: ~c[2] & (c[0] < len(FEEDBACK_FACTORS)),
        smaller,
        (0, u, jnp.asarray(False)),
    )
    return factors[n - 1], v, runs


def take_turn(
    data: EngineTraining, c: SearchState, turn: Turn, settings: Settings
) -> SearchState:
    """One turn: the first of a stage evaluates its start, the others make a step."""
    fresh = turn.step == 0
    # The last stage begins at the best so far, unless nothing runs.
    ahead = turn.last & ~c.best.score.diverged
    again = begin_anew(c.state, jnp.where(ahead, c.best.u, c.state.u))
    c = dataclasses.replace(c, state=select_tree(fresh, again, c.state))
    patience = jnp.where(turn.last, settings.patience, UNREACHED_STEPS)
    rules = StoppingRules(settings.tolerance, patience)
    problem = data.problem(turn, jnp.asarray(settings.ridge))
    return advance(Levenberg(problem), data.validate, rules, c)
