"""The search's masks, levels and first terms from its settings."""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
import scipy.special
from jaxtyping import Bool, Int

from jaxnarx.errors import SpecError, suggest
from jaxnarx.regressors import Pool
from jaxnarx.selection._search import Program
from jaxnarx.settings import Backward, ForwardOLS, StepwiseF

Method = ForwardOLS | StepwiseF | Backward

ENTRY_ROUNDS = 3
"""Times that a stepwise search enters anew after exchanges changed the model."""


@dataclasses.dataclass(frozen=True, eq=False)
class SearchPlan:
    """A program, its static settings, and the terms every lane starts from."""

    program: Program
    start: Int[np.ndarray, "lanes start"]
    starts: Int[np.ndarray, " lanes"]
    max_terms: int
    removes: bool
    exchanges: bool
    candidates: int
    f_level: float


def constant_term(pool: Pool) -> int | None:
    """Index of the constant, None in a pool without it."""
    rows = np.flatnonzero(~pool.factor.any(axis=1))
    return int(rows[0]) if rows.size else None


def term_index(pool: Pool, text: str, field: str) -> int:
    """Index of the term that reads `text`; factors in any order, powers as `^2`."""
    names = pool.variable_names
    row: list[int] = []
    rest = text.replace(" ", "") if text not in names else text
    known = {name.replace(" ", ""): v + 1 for v, name in enumerate(names)}
    longest_first = sorted(known, key=len, reverse=True)
    while rest and rest != "1":
        name = next((n for n in longest_first if rest.startswith(n)), None)
        if name is None:
            raise SpecError(
                f"{field} names {text!r}, which is no product of the pool's lagged "
                f"variables. {suggest(rest, names)}",
                field=field,
            )
        rest = rest[len(name) :]
        power = 1
        if rest.startswith("^"):
            digits = rest[1:].split("*", 1)[0]
            if not digits.isdigit() or not 1 <= int(digits) <= pool.degree:
                raise SpecError(f"{field}: power {digits!r} in {text!r}", field=field)
            power, rest = int(digits), rest[1 + len(digits) :]
        row += [known[name]] * power
        rest = rest.removeprefix("*")
    sorted_rows = np.sort(pool.factor, axis=1)
    wanted = np.sort([0] * (pool.degree - len(row)) + row)
    if len(row) <= pool.degree:
        found = np.flatnonzero((sorted_rows == wanted[None]).all(axis=1))
        if found.size:
            return int(found[0])
    raise SpecError(f"{field} names {text!r}, which is not in the pool", field=field)


def f_level(candidates: int, samples: int, terms: int, significance: float) -> float:
    """F that the largest of `candidates` exceeds by chance with that probability.

    The quantile 1 - significance / candidates of F(1, samples - terms), Bonferroni's
    bound; F with one degree of freedom is a squared t.
    """
    spare = max(samples - terms, 1)
    tail = significance / max(candidates, 1) / 2.0
    return float(scipy.special.stdtrit(spare, tail) ** 2)


def adds_constant(method: Method) -> bool:
    """Whether the constant joins the terms when they are chosen."""
    return isinstance(method, ForwardOLS) and method.constant == "after"


def allowed_terms(
    pool: Pool, method: Method, usable: Bool[np.ndarray, " terms"]
) -> Bool[np.ndarray, " terms"]:
    """The usable terms that are not forbidden."""
    allowed = usable.copy()
    for text in method.forbidden:
        allowed[term_index(pool, text, "forbidden")] = False
    return allowed


def _with_parents(
    terms: Sequence[int], parents: Int[np.ndarray, "terms parts"]
) -> list[int]:
    """The terms, each behind its parents."""
    every: dict[int, None] = {}
    for term in terms:
        # Parents with more factors stand in front: fewer of these were dropped.
        own = [int(p) for p in parents[term][::-1] if p < len(parents)]
        every |= dict.fromkeys([*own, term])
    return list(every)


def plan(
    pool: Pool,
    method: Method,
    usable: Bool[np.ndarray, " terms"],
    chosen: Sequence[Sequence[int]],
    samples: int,
    dtype: np.dtype,
    parents: Int[np.ndarray, "terms parts"] | None = None,
) -> SearchPlan:
    """The plan that `search` needs for `method`; `chosen` are the terms every lane
    starts from.

    `usable` is False for terms that may not be chosen at all. With `parents` every term
    enters behind its own, the constant before all others.
    """
    allowed = allowed_terms(pool, method, usable)
    constant = constant_term(pool)
    keep = _forced_terms(pool, method, allowed, constant, parents is not None)
    if parents is not None:
        keep = _with_parents(keep, parents)
        chosen = [_with_parents(terms, parents) for terms in chosen]
    if adds_constant(method):
        allowed[[constant] if constant is not None else []] = False
    starts = [[*keep, *(t for t in terms if t not in keep)] for terms in chosen]
    begun = isinstance(method, Backward) and any(len(c) for c in chosen)
    stages, limits = _stages(pool, method, allowed, begun)
    slots = min(method.max_terms, len(pool))
    slots = max(slots, *(len(s) for s in starts))
    candidates = int(stages.any(axis=0).sum())
    levels = _levels(method, candidates, samples, slots)
    kept = np.zeros(len(pool), bool)
    kept[keep] = True
    forward = isinstance(method, ForwardOLS)
    numbers = {
        "rho": method.rho if isinstance(method, ForwardOLS) else 0.0,
        "tau": method.tau,
        "tau_absolute": method.tau_absolute if isinstance(method, ForwardOLS) else 0.0,
        "f_in": levels[0],
        "f_out": levels[1],
        "f_last": levels[2],
    }
    arrays = {
        "stages": stages,
        "limits": np.asarray(limits),
        "keep": kept,
        "rounds": np.asarray(ENTRY_ROUNDS if _enters_anew(method) else 0),
        "parents": parents,
    }
    arrays |= {name: np.asarray(x, dtype) for name, x in numbers.items()}
    program = Program(**jax.device_put(arrays))
    # As wide as there is room: a program serves any number of first terms.
    table = np.array([s + [0] * (slots - len(s)) for s in starts], np.int64)
    return SearchPlan(
        program,
        table.reshape(len(starts), slots),
        np.array([len(s) for s in starts]),
        slots,
        removes=not forward,
        exchanges=not forward and method.exchange,
        candidates=candidates,
        f_level=levels[2],
    )


def _enters_anew(method: Method) -> bool:
    return isinstance(method, StepwiseF) and method.stages is None


def _forced_terms(
    pool: Pool, method: Method, allowed, constant: int | None, far: bool
) -> list[int]:
    """Terms that enter first, in order, and never leave.

    Where channels are `far` from zero the constant is no candidate like others.
    """
    kept = []
    first = not isinstance(method, ForwardOLS) or method.constant == "first"
    first |= far and not adds_constant(method)
    if first and constant is not None and allowed[constant]:
        kept.append(constant)
    for text in method.forced:
        term = term_index(pool, text, "forced")
        if not allowed[term]:
            raise SpecError(
                f"the forced term {text!r} is forbidden, or its channel is passed "
                "over as constant or a copy",
                field="forced",
            )
        if term not in kept:
            kept.append(term)
    if len(kept) > method.max_terms:
        raise SpecError(
            f"{len(kept)} forced terms, the constant included, but max_terms is "
            f"{method.max_terms}",
            field="max_terms",
        )
    return kept


def _stages(pool: Pool, method: Method, allowed, begun: bool):
    """Terms that may enter in each stage, and how many."""
    if isinstance(method, StepwiseF) and method.stages is not None:
        degrees = (pool.factor > 0).sum(axis=1)
        if len(method.stages) > pool.degree:
            raise SpecError(
                f"stages gives {len(method.stages)} counts for a pool of degree "
                f"{pool.degree}",
                field="stages",
            )
        order = np.arange(1, len(method.stages) + 1)
        return allowed[None] & (degrees[None] == order[:, None]), method.stages
    # A stage without room: the search goes on to removal and exchange at once.
    return allowed[None], (0 if begun else len(pool),)


def _levels(method: Method, candidates: int, samples: int, slots: int):
    """F to enter, F to stay while entering, F to stay at the end."""
    if isinstance(method, ForwardOLS):
        return 0.0, 0.0, 0.0
    default = f_level(candidates, samples, slots, method.significance)
    if isinstance(method, Backward):
        return 0.0, 0.0, default if method.f_out is None else method.f_out
    enter = default if method.f_in is None else method.f_in
    leave = min(default, enter) if method.f_out is None else method.f_out
    if leave > enter:
        raise SpecError(
            f"f_out = {leave:g} exceeds the default f_in = {enter:.3g}; give f_in too",
            field="f_out",
        )
    return enter, leave, leave
