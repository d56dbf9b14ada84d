"""The refinement inside the program: Levenberg-Marquardt of a fixed number of steps.

A step raises the damping until the training loss with the pull of the ridge falls, and
then takes the normal equations there; what a step has reached is judged by the free run
of the validation records. The best by that judgement is the result: it is never worse
there than the start. Steps, damping, ridge and limits are those of
`jaxnarx.refinement`, and so are the results; only that a quiet search does not stop
before its last step is not.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.least_squares import cholesky_solve
from jaxnarx.arrays.levenberg import (
    DAMPING_LIMIT,
    DAMPING_START,
    GROW,
    REACH,
    SHRINK,
)
from jaxnarx.methods import PredictionError, SimulationError
from jaxnarx.refinement import Layout, Stage, loss, normal_equations, stages
from jaxnarx.refinement.starts import SHRINK as FACTORS
from jaxnarx.refinement.starts import shrunk
from jaxnarx.simulation import Drive, run
from jaxnarx.sweep.identify.member import Part
from jaxnarx.sweep.identify.score import free_anchors, held
from jaxnarx.sweep.identify.settings import Settings

FULL = 2**30
"""A window longer than any record."""


class Ground(eqx.Module):
    """What a refinement reads and never changes.

    `weight` makes mean squared NRMSE of the training errors, `guard_weight` of those of
    the records that judge; `moving` marks the parameters that are trained, `early`
    those that come first, fewer where the case is `staged`.
    """

    layout: Layout
    drive: Drive
    part: Part
    weight: Float[Array, "records time outputs"]
    guard: Drive
    guard_part: Part
    guard_weight: Float[Array, "_ _ outputs"]
    moving: Bool[Array, " params"]
    early: Bool[Array, " params"]
    staged: Bool[Array, ""]


class Judged(eqx.Module):
    """Whether a free run diverges, and its loss."""

    diverged: Bool[Array, ""]
    loss: Float[Array, ""]

    def better(self, other: "Judged") -> Bool[Array, ""]:
        """Whether this is the better one: a network that runs beats one that does
        not."""
        same = self.diverged == other.diverged
        return jnp.where(same, self.loss < other.loss, other.diverged)


class State(eqx.Module):
    """Where the search stands, and the best so far by judgement.

    No loss above the start's, `limit`, is best.
    """

    u: Float[Array, " params"]
    loss: Float[Array, ""]
    gradient: Float[Array, " params"]
    gram: Float[Array, "params params"]
    damping: Float[Array, ""]
    origin: Float[Array, " params"]
    pull: Float[Array, " params"]
    best: Float[Array, " params"]
    judged: Judged
    limit: Float[Array, ""]
    accepted: Int[Array, ""]


class Turn(eqx.Module):
    """What one turn of the loop does: window length, and its place in the stage.

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
    start: Judged
    best: Judged
    accepted: Int[Array, ""]
    loss: Float[Array, " turns"]
    judged: Float[Array, " turns"]
    factor: Float[Array, ""]


def schedule(method: SimulationError | PredictionError, steps: int) -> Turn:
    """The stages of a staged case, in turns; a stage begins with step zero."""
    order = [Stage(1, steps)]
    if isinstance(method, SimulationError):
        order = stages(list(method.horizons), method.window_steps, steps, staged=True)
    rows = [
        (stage.horizon or FULL, n, stage.only_coefficients, stage is order[-1])
        for stage in order
        for n in range(stage.steps + 1)
    ]
    return Turn(*(jnp.asarray(np.array(column)) for column in zip(*rows, strict=True)))


def active(ground: Ground, turns: Turn, settings: Settings) -> Bool[Array, " turns"]:
    """Which turns a case makes: windows shorter than the longest record, and on full
    records its own number of steps, of coefficients alone where it is staged.
    """
    room = jnp.asarray(settings.steps)
    scored = jnp.any(jnp.asarray(ground.part.scored), axis=2)
    longest = jnp.max(jnp.sum(scored, axis=1))
    full = (turns.last | ground.staged) & (turns.step <= room)
    short = turns.horizon < longest
    own = jnp.where(turns.last | (turns.horizon == FULL), full, short)
    # Windows are no use to a case without any step on full records.
    return own & jnp.any(ground.moving) & (room > 0)


def train(
    ground: Ground, u: Float[Array, " params"], settings: Settings, turns: Turn
) -> Trained:
    """Run the whole schedule from `u`, and where nothing that runs is found, once more
    with shrunk feedback.
    """
    start = judge(ground, u)
    zero = jnp.zeros_like(u)
    begin = State(
        u,
        jnp.asarray(jnp.inf, u.dtype),
        zero,
        jnp.zeros((u.size, u.size), u.dtype),
        jnp.asarray(DAMPING_START, u.dtype),
        u,
        zero,
        u,
        start,
        start.loss,
        jnp.asarray(0),
    )
    ridge = jnp.asarray(settings.ridge)
    made = active(ground, turns, settings)
    # Only the turns that are made, so that the others cost nothing side by side either.
    order, count = jnp.argsort(~made, stable=True), jnp.sum(made)

    def step(n, carry):
        s, loss, judged = carry
        at = order[n]
        s = advanced(ground, s, jax.tree.map(lambda a: a[at], turns), ridge)
        return s, loss.at[at].set(s.loss), judged.at[at].set(s.judged.loss)

    def attempt(carry):
        tried, _, _, s, loss, judged = carry
        factor, u, runs = jax.lax.cond(
            tried == 0,
            lambda: (jnp.ones_like(start.loss), begin.u, jnp.asarray(True)),
            lambda: _shrunk(ground, begin.u),
        )
        s = eqx.tree_at(lambda s: s.u, s, u)
        most = jnp.where(runs, count, 0)
        s, loss, judged = jax.lax.fori_loop(0, most, step, (s, loss, judged))
        return tried + 1, factor, runs, s, loss, judged

    history = jnp.full(made.shape, begin.loss), jnp.full(made.shape, start.loss)
    _, factor, runs, end, *history = jax.lax.while_loop(
        lambda c: (c[0] == 0) | ((c[0] == 1) & c[3].judged.diverged & (count > 0)),
        attempt,
        (0, jnp.ones_like(start.loss), jnp.asarray(True), begin, *history),
    )
    # A turn that is not made leaves everything where it was.
    before = jax.lax.cummax(jnp.where(made, jnp.arange(made.size), -1))
    loss, judged = (
        jnp.where(before < 0, first, column[before])
        for first, column in zip((begin.loss, start.loss), history, strict=True)
    )
    factor = jnp.where(runs, factor, 1.0)
    return Trained(end.best, start, end.judged, end.accepted, loss, judged, factor)


def _shrunk(ground: Ground, u: Float[Array, " params"]):
    """The first factor on the feedback whose free run does not diverge, that start, and
    whether there is one.
    """
    factors = jnp.asarray(FACTORS, u.dtype)

    def smaller(carry):
        n, _, _ = carry
        v = shrunk(ground.layout, u, factors[n])
        return n + 1, v, ~judge(ground, v).diverged

    n, v, runs = jax.lax.while_loop(
        lambda c: ~c[2] & (c[0] < len(FACTORS)), smaller, (0, u, jnp.asarray(False))
    )
    return factors[n - 1], v, runs


def judge(ground: Ground, u: Float[Array, " params"]) -> Judged:
    """The free run of the records that judge."""
    network = ground.layout.place(u)
    y = run(network, ground.guard, free_anchors(ground.guard_part))
    error = y - ground.guard.measured
    weight = ground.guard_weight
    loss = jnp.sum(jnp.where(weight > 0, weight * error**2, 0.0))
    return Judged(held(network, y, ground.guard_part), loss)


class Trial(eqx.Module):
    """A point that may be taken, and whether the loss is lower there."""

    u: Float[Array, " params"]
    damping: Float[Array, ""]
    lower: Bool[Array, ""]


def advanced(ground: Ground, s: State, turn: Turn, ridge: Float[Array, ""]) -> State:
    """One turn: the first of a stage takes stock, the others make a step."""
    fresh = turn.step == 0
    anchor = anchors(ground.part, turn.horizon)
    # The last stage begins at the best so far, unless nothing runs.
    ahead = fresh & turn.last & ~s.judged.diverged
    s = eqx.tree_at(lambda s: s.u, s, jnp.where(ahead, s.best, s.u))
    moving = jnp.where(turn.apart, ground.early, ground.moving)
    ground = eqx.tree_at(lambda g: g.moving, ground, moving)
    found = _step(ground, s, anchor, fresh)
    s = eqx.tree_at(lambda s: s.damping, s, found.damping)

    def reach(s: State) -> State:
        return _reached(ground, s, found, anchor, fresh, ridge)

    return jax.lax.cond(found.lower, reach, lambda s: s, s)


def anchors(part: Part, horizon: Int[Array, ""]) -> Bool[Array, "records time"]:
    """Restarts every `horizon` samples where the measured history is complete."""
    at = jnp.arange(part.anchors.shape[1])[None] - jnp.asarray(part.start)[:, None]
    return free_anchors(part) | ((at % horizon == 0) & jnp.asarray(part.anchors))


def _step(ground: Ground, s: State, anchor, fresh: Bool[Array, ""]) -> Trial:
    """Raise the damping until the penalised loss falls, or no more."""
    here = s.loss + _penalty(s, s.u)

    def attempt(t: Trial) -> Trial:
        u = _damped(ground.layout, s, t.damping)
        safe = jnp.where(jnp.all(jnp.isfinite(u)), u, s.u)
        value = loss(ground.layout, safe, ground.drive, anchor, ground.weight)
        lower = jnp.isfinite(value) & (value + _penalty(s, safe) < here)
        return Trial(safe, jnp.where(lower, t.damping, t.damping * GROW), lower)

    start = jnp.where(fresh, DAMPING_START, s.damping).astype(s.u.dtype)
    return jax.lax.while_loop(
        lambda t: ~t.lower & (t.damping <= DAMPING_LIMIT),
        attempt,
        Trial(s.u, start, fresh),
    )


def _reached(
    ground: Ground, s: State, found: Trial, anchor, fresh, ridge: Float[Array, ""]
) -> State:
    """Linearise where the step has led, and judge it."""
    value, gradient, gram = _linear(ground, found.u, anchor)
    judged = judge(ground, found.u)
    better = judged.better(s.judged) & (judged.loss <= s.limit)
    eased = jnp.maximum(found.damping / SHRINK, 1e-12)
    return State(
        u=found.u,
        loss=value,
        gradient=gradient,
        gram=gram,
        damping=jnp.where(fresh, found.damping, eased),
        origin=jnp.where(fresh, found.u, s.origin),
        pull=jnp.where(fresh, ridge * jnp.diagonal(gram), s.pull),
        best=jnp.where(better, found.u, s.best),
        judged=jax.tree.map(lambda a, b: jnp.where(better, a, b), judged, s.judged),
        limit=s.limit,
        accepted=s.accepted + (~fresh).astype(s.accepted.dtype),
    )


def _linear(ground: Ground, u: Float[Array, " params"], anchor):
    """Loss, J'r and J'J at `u`; zero where parameters rest, or where they overflow."""
    value, gradient, gram = normal_equations(
        ground.layout, u, ground.drive, anchor, ground.weight
    )
    finite = jnp.all(jnp.isfinite(gradient)) & jnp.all(jnp.isfinite(gram))
    keep = ground.moving & finite
    gradient = jnp.where(keep, gradient, 0.0)
    return value, gradient, jnp.where(keep[:, None] & keep[None], gram, 0.0)


def _penalty(s: State, u: Float[Array, " params"]) -> Float[Array, ""]:
    return s.pull @ (u - s.origin) ** 2


def _damped(
    layout: Layout, s: State, damping: Float[Array, ""]
) -> Float[Array, " params"]:
    """Where a damped step leads; not finite where the equations have no solution."""
    slope = s.gradient + s.pull * (s.u - s.origin)
    delta = -cholesky_solve(s.gram + jnp.diag(s.pull), slope, damping, least=0.0)
    wall = layout.wall()
    reach = jnp.where(jnp.isfinite(wall), REACH, jnp.inf)
    return jnp.clip(s.u + jnp.clip(delta, -reach, reach), -wall, wall)
