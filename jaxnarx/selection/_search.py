"""The one search behind every selector: terms enter, leave and are exchanged.

Each round, for every lane (an output, or one of several weightings):

1. the candidate that lowers the squared error most is taken in. With the constant in
   the model that is the one with the largest correlation with the residual, after both
   are freed of the chosen columns (thesis appendix A); without, the largest ERR;
2. if its F is not above `f_in` it is refused, and this stage ends;
3. terms whose partial F is below `f_out` leave, the smallest first, and do not come
   back, so nothing can cycle;
4. once no stage is left, single terms are exchanged as long as that lowers the squared
   error at equal size. Every exchange is followed by step 3 with `f_last`.

Candidates are ranked by their coordinates on the chosen directions (`basis`), so one
round costs at most one pass over the pool; lanes share it.

Chen, Billings, Luo, "Orthogonal least squares methods and their application to
non-linear system identification", Int. J. Control 50 (1989); thesis (5.5) to (5.26),
appendices A and B.
"""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import contract
from jaxnarx.regressors import evaluate
from jaxnarx.selection.basis import (
    Basis,
    Lane,
    chosen_mask,
    empty,
    enter,
    leave,
    partial_f,
    project,
    record_direction,
    remaining_moments,
    squared_error,
    swaps,
)
from jaxnarx.selection.path import PartialFHistory

ENTERING, EXCHANGING, DONE = range(3)
LEAST_EXCHANGE_GAIN = 1e-9
"""Share of the squared error an exchange must save ..."""
ROUNDING_POWER_SHARE = 1e-12
"""... beside this share of the output's power, which rounding can feign."""


TIE_SHARE = 1e-10
"""Share by which the scores of equal columns may differ: their sums round apart."""


class Program(eqx.Module):
    """The settings of a search, the same for every selector: candidates, and when it
    ends.

    `stages` says which terms may enter in each stage, `limits` how many; those of
    `keep` never leave. F levels of zero switch their test off. The search enters anew
    after exchanges, at most `rounds` times. A term enters after its `parents` (places
    past the pool are none), for which it makes way, and they do not leave before it.
    """

    stages: Bool[Array, "stages terms"]
    limits: Int[Array, " stages"]
    keep: Bool[Array, " terms"]
    rho: Float[Array, ""]
    tau: Float[Array, ""]
    tau_absolute: Float[Array, ""]
    f_in: Float[Array, ""]
    f_out: Float[Array, ""]
    f_last: Float[Array, ""]
    rounds: Int[Array, ""]
    parents: Int[Array, "terms parts"] | None = None


class LaneState(eqx.Module):
    """The state of one lane. `alive` terms may still enter.

    `awaited` is the product for which a part was just taken in, past the pool for none.
    """

    basis: Basis
    alive: Bool[Array, "*lanes terms"]
    phase: Int[Array, "*lanes"]
    stage: Int[Array, "*lanes"]
    entered: Int[Array, "*lanes"]
    awaited: Int[Array, "*lanes"]
    started: Int[Array, "*lanes"]
    rounds: Int[Array, "*lanes"]
    changed: Bool[Array, "*lanes"]
    history: PartialFHistory


def make_lanes(
    v: Float[Array, "vars rows"],
    y: Float[Array, "lanes rows"],
    weight: Float[Array, "lanes rows"],
    factor: Int[Array, "terms degree"],
    position: Int[Array, " terms"],
    start: Int[Array, "lanes start"],
    starts: Int[Array, " lanes"],
) -> Lane:
    """Every output, or weighting, as a lane, with two passes over the pool.

    `position` comes from `arrays.contraction.positions`; the first `starts` terms of
    `start` enter before any choice.
    """
    norm, moment = jax.lax.map(
        lambda a: contract(v, a[0], factor.shape[1], squared=a[1])[:, position],
        (jnp.stack([weight, weight * y]), jnp.array([True, False])),
    )
    root = jnp.sqrt(weight)
    return Lane(
        target=y * root,
        root=root,
        norm=norm,
        moment=moment,
        power=jnp.sum(weight * y**2, axis=1),
        samples=jnp.sum((weight > 0).astype(y.dtype), axis=1),
        start=start,
        starts=starts,
    )


def search(
    v: Float[Array, "vars rows"],
    lanes: Lane,
    factor: Int[Array, "terms degree"],
    position: Int[Array, " terms"],
    program: Program,
    *,
    max_terms: int,
    removes: bool,
    exchanges: bool,
) -> tuple[Basis, PartialFHistory, Bool[Array, "lanes terms"]]:
    """Run the search on every lane at once; they share each pass over the pool.

    `removes` and `exchanges` are static: a plain forward search does not carry their
    code. Also returns which candidates were collinear with the chosen terms when they
    were last looked at.
    """
    degree = factor.shape[1]

    def products(vectors):
        return contract(v, vectors * lanes.root, degree)[:, position]

    rounds = 4 * max_terms + 16 if removes else 0

    def body(s: LaneState) -> LaneState:
        swapped = jnp.zeros(s.phase.shape, bool)
        incoming = jnp.zeros(s.phase.shape, int)
        if removes:
            s, incoming, swapped = _exchange(program, lanes, s, exchanges)
        take = partial(_take, program, factor, v, removes)
        s, q, entered = jax.vmap(take)(lanes, s, incoming, swapped)
        # After the last entry of a forward search nobody asks for the coordinates.
        read = jnp.any(entered) & jnp.any(s.phase != DONE)
        c = jax.lax.cond(read, products, lambda q: jnp.zeros_like(lanes.norm), q)
        basis = jax.vmap(record_direction)(s.basis, c, entered)
        s = dataclasses.replace(s, basis=basis)
        return _tidy(program, lanes, s, entered, rounds) if removes else s

    begin = jax.vmap(partial(_start, program, max_terms, rounds))(lanes)
    end = jax.lax.while_loop(lambda s: jnp.any(s.phase != DONE), body, begin)
    collinear = jax.vmap(partial(_collinear, program))(lanes, end)
    return end.basis, end.history, collinear


def _collinear(program: Program, lane: Lane, s: LaneState) -> Bool[Array, " terms"]:
    """Candidates of which too little is left beside the chosen terms."""
    _, d = remaining_moments(s.basis, lane)
    candidates = jnp.any(program.stages, axis=0) & (lane.norm > 0)
    candidates &= ~chosen_mask(s.basis, lane.norm.shape[0])
    return candidates & ~_has_enough_norm(program, lane, d)


def _has_enough_norm(program: Program, lane: Lane, d: Float[Array, " terms"]):
    return (d > program.tau * lane.norm) & (d > program.tau_absolute)


def _admissible(
    program: Program, s: LaneState, *, joining: bool = False
) -> Bool[Array, " terms"] | bool:
    """Terms of which every part is in the model, or may join it before them."""
    if program.parents is None:
        return True
    there = chosen_mask(s.basis, s.alive.shape[0])
    there = there | s.alive if joining else there
    return jnp.all(jnp.append(there, True)[program.parents], axis=1)


def _first_part(program: Program, s: LaneState, term: Int[Array, ""]):
    """The smallest part that a product still lacks, or the product itself."""
    if program.parents is None:
        return term
    parts = jnp.append(program.parents[term][::-1], term).astype(term.dtype)
    there = jnp.append(chosen_mask(s.basis, s.alive.shape[0]), True)
    return parts[jnp.argmax(~there[parts] | (parts == term))]


def _awaited_product(s: LaneState, usable: Bool[Array, " terms"], best: Int[Array, ""]):
    """The product for which a part made way, or else the best candidate."""
    term = jnp.minimum(s.awaited, usable.shape[0] - 1).astype(best.dtype)
    return jnp.where((s.awaited < usable.shape[0]) & usable[term], term, best)


def _terms_that_stay(program: Program, s: LaneState) -> Bool[Array, " slots"]:
    """Terms that stay: kept ones, and parts of chosen or awaited terms."""
    index = s.basis.index
    keep = program.keep[index]
    if program.parents is None:
        return keep
    part = jnp.any(program.parents[index][:, :, None] == index[None, None], axis=1)
    waits = (s.phase == ENTERING) & (s.awaited < s.alive.shape[0])
    wanted = program.parents[jnp.minimum(s.awaited, s.alive.shape[0] - 1)]
    keep |= waits & jnp.any(wanted[:, None] == index[None], axis=0)
    return keep | jnp.any(part & s.basis.used[:, None], axis=0)


def _start(program: Program, max_terms: int, rounds: int, lane: Lane) -> LaneState:
    zero = jnp.asarray(0)
    return LaneState(
        basis=empty(max_terms, lane),
        alive=lane.norm > 0,
        phase=jnp.where(lane.power > 0, ENTERING, DONE),
        stage=zero,
        entered=zero,
        awaited=jnp.asarray(lane.norm.shape[0]),
        started=zero,
        rounds=program.rounds,
        changed=jnp.asarray(False),
        history=PartialFHistory.empty(rounds, max_terms, lane.target.dtype),
    )


def _candidate(program: Program, lane: Lane, s: LaneState):
    """Best term of this stage, whether there is one, and whether it was asked for.

    Also the term for which it makes way, itself if none, and what that one would save.
    """
    b, d = remaining_moments(s.basis, lane)
    usable = s.alive & program.stages[s.stage]
    usable &= _admissible(program, s, joining=True)
    usable &= _has_enough_norm(program, lane, d)
    score = jnp.where(usable, b**2 / jnp.where(usable, d, 1.0), -jnp.inf)
    # Of copies the first, whatever rounding says; in a pool that is the simplest one.
    best = jnp.argmax(score >= (1.0 - TIE_SHARE) * jnp.max(score))
    found, asked = jnp.any(usable), jnp.asarray(False)
    if program.parents is not None:
        best = _awaited_product(s, usable, best)
    wanted, promised = best, score[best]
    best = _first_part(program, s, best)
    if lane.start.shape[0]:
        asked = s.started < lane.starts
        first = lane.start[jnp.minimum(s.started, lane.start.shape[0] - 1)]
        best = jnp.where(asked, first.astype(best.dtype), best)
        wanted = jnp.where(asked, best, wanted)
        found = jnp.where(asked, s.alive[first], found)
    return best, found, asked, wanted, promised


def _take(
    program: Program,
    factor,
    v,
    removes: bool,
    lane: Lane,
    s: LaneState,
    incoming,
    swapped,
):
    """Take in the best candidate, or `incoming`; say what phase follows."""
    entering = s.phase == ENTERING
    best, found, asked, wanted, promised = _candidate(program, lane, s)
    part = (best != wanted) & ~swapped
    term = jnp.where(swapped, incoming, best)
    full = s.basis.count >= s.basis.index.shape[0]
    room = asked | (s.entered < program.limits[s.stage])
    tried = (entering & found & room & ~full) | swapped
    off, along = project(s.basis, evaluate(factor[term][None], v)[0] * lane.root)
    exact = off @ off
    fits = (exact > program.tau * lane.norm[term]) & (exact > program.tau_absolute)
    passes = jnp.asarray(True)
    if removes:
        saved = (off @ lane.target) ** 2 / jnp.where(fits, exact, 1.0)
        f = _entry_f(lane, s, jnp.where(part, promised, saved))
        passes = asked | swapped | (program.f_in <= 0) | (f > program.f_in)
    accept = tried & fits & passes
    basis, q = enter(s.basis, lane, term, off, along, accept)
    gone = accept | (tried & ~fits)
    s = dataclasses.replace(
        s,
        basis=basis,
        alive=s.alive.at[term].set(s.alive[term] & ~gone),
        awaited=jnp.where(accept & part, wanted, lane.norm.shape[0]).astype(
            s.awaited.dtype
        ),
        started=s.started + (entering & asked).astype(s.started.dtype),
        entered=s.entered + (accept & entering & ~asked).astype(s.entered.dtype),
    )
    refused = ~found | (fits & ~passes)
    return (
        _next_stage(program, lane, s, entering, asked, refused, full, removes),
        q,
        accept,
    )


def _entry_f(lane: Lane, s: LaneState, saved: Float[Array, ""]) -> Float[Array, ""]:
    """F of a term that lowers the squared error by `saved`, thesis (5.13)."""
    left = jnp.maximum(squared_error(s.basis, lane) - saved, 0.0)
    floor = jnp.finfo(left.dtype).eps ** 2 * lane.power
    spare = lane.samples - (s.basis.count + 1).astype(lane.samples.dtype)
    return jnp.where(spare > 0, saved * spare / jnp.maximum(left, floor), 0.0)


def _next_stage(program, lane, s: LaneState, entering, asked, refused, full, removes):
    if not removes:
        # Known at once, which spares the last term's pass over the pool.
        full = s.basis.count >= s.basis.index.shape[0]
    explained = 1.0 - jnp.sum(s.basis.gain**2) / lane.power <= program.rho
    ended = refused | (s.entered >= program.limits[s.stage])
    ended &= entering & ~asked
    last = s.stage == program.stages.shape[0] - 1
    over = (entering & (full | explained)) | (ended & last)
    after = EXCHANGING if removes else DONE
    return dataclasses.replace(
        s,
        phase=jnp.where(over, after, s.phase),
        stage=s.stage + (ended & ~last).astype(s.stage.dtype),
        entered=jnp.where(ended, 0, s.entered),
    )


def _exchange(program: Program, lanes: Lane, s: LaneState, exchanges: bool):
    """Drop the term whose exchange saves most; without one, end or enter anew."""
    active = s.phase == EXCHANGING
    zero = jnp.zeros(active.shape, int)
    if exchanges:

        def look(s):
            return jax.vmap(partial(_best_exchange, program))(lanes, s, active)

        def rest(s):
            return s, zero, active & False

        s, incoming, worth = jax.lax.cond(jnp.any(active), look, rest, s)
    else:
        incoming, worth = zero, active & False
    again = active & ~worth & s.changed & (s.rounds > 0)
    phase = jnp.where(active & ~worth, jnp.where(again, ENTERING, DONE), s.phase)
    s = dataclasses.replace(
        s,
        phase=phase,
        rounds=s.rounds - again.astype(s.rounds.dtype),
        changed=(s.changed | worth) & ~again,
    )
    return s, incoming, worth


def _best_exchange(program: Program, lane: Lane, s: LaneState, active):
    basis = s.basis
    usable = jnp.any(program.stages, axis=0) & (lane.norm > 0) & _admissible(program, s)
    usable &= ~chosen_mask(basis, lane.norm.shape[0])
    saved, term = swaps(basis, lane, usable, program.tau, program.parents)
    saved = jnp.where(_terms_that_stay(program, s), -jnp.inf, saved)
    slot = jnp.argmax(saved)
    least = (
        LEAST_EXCHANGE_GAIN * squared_error(basis, lane)
        + ROUNDING_POWER_SHARE * lane.power
    )
    worth = active & (saved[slot] > least)
    return (
        dataclasses.replace(s, basis=leave(basis, slot, worth)),
        term[slot],
        worth,
    )


def _tidy(
    program: Program, lanes: Lane, s: LaneState, entered, rounds: int
) -> LaneState:
    """Remove what has too small a partial F, smallest first; write the history."""

    def weakest(s: LaneState):
        f = jax.vmap(partial_f)(s.basis, lanes)
        free = jnp.where(jax.vmap(partial(_terms_that_stay, program))(s), jnp.inf, f)
        slot = jnp.argmin(free, axis=1)
        level = jnp.where(s.phase == ENTERING, program.f_out, program.f_last)
        level = jnp.where(s.started < lanes.starts, 0.0, level)
        smallest = jnp.take_along_axis(free, slot[:, None], axis=1)[:, 0]
        return f, slot, (smallest < level) & (s.phase != DONE)

    def remove(carry):
        s, _, slot, wanted, removed = carry
        s = dataclasses.replace(
            s,
            basis=jax.vmap(leave)(s.basis, slot, wanted),
            changed=s.changed | (wanted & (s.phase == EXCHANGING)),
        )
        return s, *weakest(s), removed | wanted

    carry = (s, *weakest(s), jnp.zeros_like(entered))
    s, f, _, _, removed = jax.lax.while_loop(lambda c: jnp.any(c[3]), remove, carry)
    history = jax.vmap(PartialFHistory.append)(s.history, s.basis, f, entered | removed)
    phase = jnp.where(history.rounds >= rounds, DONE, s.phase)
    return dataclasses.replace(s, history=history, phase=phase)
