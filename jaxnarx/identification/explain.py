"""The choice of a leaderboard in words, and its rows as plain tables."""

import math
from typing import Any

from jaxnarx.formatting import ratio_text
from jaxnarx.identification.leaderboard import (
    AGAINST_PHYSICS,
    LEAST_ERROR,
    Candidate,
    Leaderboard,
)

LINEAR_FAMILIES = (
    "constant",
    "arx",
    "oe",
    "filtered inputs",
    "oe with filtered inputs",
)
"""Families without products and regions, in small letters."""
UNEVEN_FACTOR = 1.25
"""Times the pooled error from which a group is said to be served worse."""
OPERATION_DIGITS = 7
"""Behind the point; smaller figures are written with powers of ten."""
RULE_WORDS = {
    "near": "the cheapest to compute within one standard error of the best (that of "
    "the difference, group by group: column `above best`) and 5 %, safest first, or "
    "the cheapest within one standard error alone where its nested error is smaller",
    "share": "the cheapest to compute within 5 % of the best, safest first",
    "best": "the smallest error, whatever it costs",
}
"""The choice by its rule."""
DOMINANT_WORDS = (
    "the cheapest to compute of those within one standard error of the best whose "
    "geometric mean over groups is within 5 % of the least, for one group has most of "
    "the loss"
)
"""... where groups disagree."""
NONE_NEAR = {
    "near": "none within its standard error is as safe and cheaper",
    "share": "none within 5 % is as safe and cheaper",
}


def is_linear(row: Candidate) -> bool:
    """Whether a candidate is of a linear family."""
    return row.family.lower() in LINEAR_FAMILIES


def title(row: Candidate) -> str:
    """`12 (OE: order 2)`."""
    return f"{row.number} ({row.family}: {row.name})"


def figure(row: Candidate) -> str:
    """`0.131 ± 0.004`, or what became of the candidate."""
    if row.free_run is None:
        return row.status
    if not row.standard_error:
        return ratio_text(row.free_run)
    digits = max(1 - math.floor(math.log10(row.standard_error)), 0)
    if digits > OPERATION_DIGITS:
        return f"{row.free_run:.3g} ± {row.standard_error:.2g}"
    return f"{row.free_run:.{digits}f} ± {row.standard_error:.{digits}f}"


def candidate_in_use(
    board: Leaderboard, output: str, taken: int | None = None
) -> Candidate:
    """The row of the model in use: chosen by hand, by the rule, or else the safest."""
    if taken is not None:
        return next(r for r in board.of(output) if r.number == taken)
    return board.choose(output) or safest(board, output)


def safest(board: Leaderboard, output: str) -> Candidate:
    """The candidate to use where every one is vetoed: the mean, else the one that
    diverges least."""
    rows = board.of(output)
    told = {"constant": 0, "diverged": 1}
    return min(
        rows, key=lambda r: (told.get(r.family, told.get(r.status, 2)), r.diverged)
    )


def pareto(board: Leaderboard, output: str) -> list[Candidate]:
    """Candidates that no other beats in error at the same cost; cheapest first."""
    rows = [r for r in board.of(output) if r.eligible and r.operations is not None]
    front: list[Candidate] = []
    for row in sorted(rows, key=lambda r: (r.operations, r.free_run)):
        if not front or _less(row, front[-1]):
            front.append(row)
    return front


def _less(row: Candidate, other: Candidate) -> bool:
    return (row.free_run or 0.0) < (other.free_run or 0.0)


def sentences(board: Leaderboard, output: str, taken: int | None = None) -> list[str]:
    """Why this one, what others would cost, and which records it serves worst."""
    row = candidate_in_use(board, output, taken)
    told = [_choice(board, output, row)]
    told += [*_proven(board, row), *_physics(row)]
    told += [*_best(board, row), *_others(board, row)]
    told += [*_linear(board, row), *_explain_vetoes(board, output)]
    told += [*_explain_signs(board, output), *_groups(board, row)]
    return told


def describe(
    board: Leaderboard, output: str, taken: int | None = None
) -> dict[str, Any]:
    """The rows of an output, best first, and the words, as plain values for files."""
    row, front = candidate_in_use(board, output, taken), pareto(board, output)
    return {
        "rows": [
            _row_table(board, n, r, r == row) for n, r in enumerate(board.of(output))
        ],
        "rule": board.rule,
        "chosen": getattr(board.choose(output), "number", None),
        "used": row.number,
        "pareto": [r.number for r in front],
        "text": sentences(board, output, taken),
    }


def _row_table(
    board: Leaderboard, place: int, row: Candidate, is_used: bool
) -> dict[str, Any]:
    name, error = board.worst_group(row) or ("", None)
    above = board.above_best(row) or (None, None)
    return {"rank": place + 1, "used": is_used, "linear": is_linear(row)} | (
        row.to_dict()
        | {
            "groups": dict(zip(board.group_names, row.promised_groups, strict=False)),
            "promised": row.promised,
            "worst_group": name,
            "worst_group_error": error,
            "above_best": above[0],
            "above_best_standard_error": above[1],
        }
    )


def _choice(board: Leaderboard, output: str, row: Candidate) -> str:
    chosen, named = board.choose(output), f"{output}: {title(row)}"
    if chosen is None:
        return (
            f"{named}. Every candidate is vetoed: none stays bounded in free run on "
            "all records left out. This is the safest of them."
        )
    told = f"{named}, free run {figure(row)} on records left out{_nested(row)}"
    if row != chosen:
        return f"{told}: chosen by hand in place of {title(chosen)}, {figure(chosen)}."
    if board.rule == "near" and board.dominant_group(output):
        return f"{told}: {DOMINANT_WORDS}."
    if row == board.best(output) and board.rule in NONE_NEAR:
        return f"{told}: the best, and {NONE_NEAR[board.rule]}."
    return (
        f"{told}: {RULE_WORDS.get(board.rule, f'chosen by the rule {board.rule!r}')}."
    )


def _nested(row: Candidate) -> str:
    """The nested error of a row in words, where it is known."""
    if row.nested is None or row.promised is None:
        return ""
    told = f"nested {ratio_text(row.nested)}: made again without every group"
    if row.promised != row.nested:
        told += f"; {ratio_text(row.promised)} promised of all records"
    return f" ({told})"


def _proven(board: Leaderboard, row: Candidate) -> list[str]:
    """That nothing makes it run away, where that is proven."""
    if not row.bounded:
        return []
    told = "Its runs are proven to stay bounded while its inputs are"
    first = "; among equals such candidates come first" * (board.rule in NONE_NEAR)
    return [f"{told}{first}."]


def _physics(row: Candidate) -> list[str]:
    """The price of the signs that physics asks, where they are constraints."""
    if row.unconstrained is None or row.free_run is None:
        return []
    told = "Its gains at rest have the signs that physics asks"
    ratio = row.unconstrained / max(row.free_run, LEAST_ERROR)
    same = abs(ratio - 1) < 5e-4
    more = f"{abs(ratio - 1):.1%} {'more' if ratio > 1 else 'less'}"
    figures = "the same" if same else f"{ratio_text(row.unconstrained)}, {more}"
    told = f"{told}; without constraints its error on records left out is {figures}."
    detail = f"{row.detail[:1].upper()}{row.detail[1:]}."
    return [told, detail] if row.detail else [told]


def _best(board: Leaderboard, row: Candidate) -> list[str]:
    best = board.best(row.output)
    if best is None or best == row or row.free_run is None:
        return []
    difference, error = board.above_best(row) or (0.0, 0.0)
    told = f" (by {difference:.2g} ± {error:.2g}, group by group)"
    return [f"The best itself, {title(best)}, {_price(best, row)}{told}."]


def _others(board: Leaderboard, row: Candidate) -> list[str]:
    """The price of the best of each family that is neither this nor that of the
    best."""
    best = board.best(row.output) or row
    for other in board.of(row.output):
        if other.eligible and not is_linear(other):
            if other.family not in (row.family, best.family):
                return [
                    f"The best of another family, {title(other)}, {_price(other, row)}."
                ]
    return []


def _price(other: Candidate, row: Candidate) -> str:
    """The price and the gain of another candidate: `takes 3 times the ... for ...`. for
    ...`."""
    if other.operations is None:
        cost = "takes an unknown number of operations"
    elif not row.operations:
        cost = f"takes {other.operations} operations"
    elif (times := f"{other.operations / row.operations:.2g}") == "1":
        cost = "takes as many operations"
    else:
        cost = f"takes {times} times the operations"
    if other.free_run is None or not row.free_run:
        return cost
    change = other.free_run / row.free_run - 1
    if change >= 1:
        return f"{cost} and has {change + 1:.2g} times the error"
    if abs(change) < 5e-4:
        return f"{cost} and has the same error"
    return f"{cost} and has {abs(change):.1%} {'more' if change > 0 else 'less'} error"


def _linear(board: Leaderboard, row: Candidate) -> list[str]:
    """The gain by nonlinearity."""
    best = board.best(row.output)
    rows = [
        r for r in board.of(row.output) if r.eligible and is_linear(r) != is_linear(row)
    ]
    if not rows or not row.free_run or (is_linear(row) and rows[0] == best):
        return []
    kind = "linear" if is_linear(rows[0]) else "nonlinear"
    factor = (rows[0].free_run or 0.0) / row.free_run
    return [
        f"The best {kind} model, {title(rows[0])}, has {factor:.2f} times the error "
        f"({figure(rows[0])})."
    ]


def _explain_vetoes(board: Leaderboard, output: str) -> list[str]:
    rows = board.of(output)
    lost = sum(r.status == "diverged" for r in rows)
    if not lost:
        return []
    is_are = "diverges" if lost == 1 else "diverge"
    return [f"{lost} of {len(rows)} candidates {is_are} on records left out: vetoed."]


def _explain_signs(board: Leaderboard, output: str) -> list[str]:
    rows = board.of(output)
    lost = sum(r.status == AGAINST_PHYSICS for r in rows)
    if not lost:
        return []
    does = "contradicts" if lost == 1 else "contradict"
    return [f"{lost} of {len(rows)} candidates {does} physics: vetoed."]


def _groups(board: Leaderboard, row: Candidate) -> list[str]:
    worst = board.worst_group(row)
    known = [e for e in row.promised_groups if e is not None]
    if worst is None or len(known) < 2 or not row.promised:
        return []
    name, error = worst
    if dominant := board.dominant_group(row.output):
        name, share = dominant
        return [
            f"The group {name} has {share:.0%} of the loss. Look at its records first "
            "(unit, sensor, operating mode; jaxnarx check names those in another "
            "unit); if they are right, measure more like them."
        ]
    if error < UNEVEN_FACTOR * row.promised:
        return [f"No group stands out ({min(known):.3g} to {error:.3g})."]
    return [
        f"Worst served is the group {name}: {error:.3g}, {error / row.promised:.2g} "
        "times the error of all. Look at its records first (jaxnarx check names those "
        "in another unit); if they are right, more like them would help most."
    ]
