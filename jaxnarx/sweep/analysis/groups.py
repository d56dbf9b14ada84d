"""Best member of every group, the front of several scores, counts of statuses."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.evaluation import pareto
from jaxnarx.solution import STATUS_NAMES
from jaxnarx.sweep.analysis.table import SweepTable


@guard_arguments
def best_per_group(
    table: SweepTable, group: str | Sequence[str], by: str, *, smallest: bool = True
) -> SweepTable:
    """The row of every group with the best score, in the order the groups appear.

    `group` names the columns whose values make a group, `by` the score. Scores that are
    not finite do not compete; a group without another row is left out. The first of
    equal rows wins. The status does not count: it may come from the test records, which
    must have no part in a choice by validation.
    """
    score = table.numbers(by) * (1.0 if smallest else -1.0)
    best: dict[tuple[Any, ...], int] = {}
    for i, label in enumerate(labels(table, group)):
        if np.isfinite(score[i]) and score[i] < score[best.setdefault(label, i)]:
            best[label] = i
    kept = [i for i in best.values() if np.isfinite(score[i])]
    return table.take(np.array(kept, np.int64))


@guard_arguments
def pareto_front(table: SweepTable, objectives: Sequence[str]) -> SweepTable:
    """The rows that no other beats in all objectives, each to be made small.

    Values that are not finite do not compete; the status does not count, as for
    `best_per_group`. The rows come in the order of the first objective. See
    `jaxnarx.evaluation.pareto`.
    """
    points = np.stack([table.numbers(name) for name in objectives], axis=1)
    points[~np.isfinite(points).all(axis=1)] = np.nan
    chosen = np.flatnonzero(pareto(points))
    return table.take(chosen[np.argsort(points[chosen, 0], kind="stable")])


@guard_arguments
def summary(table: SweepTable) -> dict[str, int]:
    """The number of rows with each status, in the order of the table of statuses."""
    found = table.column("status").tolist()
    names = [*STATUS_NAMES, *sorted(set(found) - set(STATUS_NAMES))]
    return {name: found.count(name) for name in names if name in found}


def labels(table: SweepTable, names: str | Sequence[str]) -> list[tuple[Any, ...]]:
    """The values of some columns, row by row; lists become tuples."""
    names = [names] if isinstance(names, str) else list(names)
    columns = [table.column(name).tolist() for name in names]
    return [tuple(map(_to_tuple, row)) for row in zip(*columns, strict=True)]


def _to_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
