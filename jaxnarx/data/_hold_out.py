"""Validation records held out of training: one of the groups left out together.

Records that repeat each other's inputs stay on one side: validation on a record whose
like is trained on tests nothing.
"""

import dataclasses

import numpy as np

from jaxnarx.checks import require
from jaxnarx.data._groups import whole_groups
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.repeated_cycles import cycles
from jaxnarx.errors import DataError, SpecError


def hold_out(data: Dataset, *, share: float | int = 0.2) -> tuple[Dataset, Dataset]:
    """Split into training and validation; about `share` of the samples validate.

    The group of whole records (`jaxnarx.data.groups`) whose size is nearest to that is
    held out, the first of equal ones. Where records are too few for that, the last part
    of every one is cut off; those that repeat each other are cut at the same place. The
    order of records is kept.
    """
    if not 0 < share < 1:
        raise SpecError(
            f"the share held out must lie between 0 and 1, got {share}", field="share"
        )
    require(len(data) > 0, "data", "the dataset has no records")
    found = whole_groups(data, max(round(1 / share), 2))
    if found is None:
        return _cut(data, share)
    sizes = np.zeros(len(found))
    for label in found.labels:
        sizes[label[0]] += len(label)
    fold = found.fold(data, int(np.argmin(np.abs(sizes - share * data.samples))))
    return fold.train, fold.left


def _cut(data: Dataset, share: float | int) -> tuple[Dataset, Dataset]:
    edges = {}
    for cycle in cycles(data):
        rows = max(len(data.records[n]) for n in cycle.records)
        for n, begin in zip(cycle.records, cycle.begins, strict=True):
            edge = round(rows * (1 - share)) - begin
            edges[n] = edge if 0 < edge < len(data.records[n]) else None
    if not any(edges.values()):
        longest = max(data, key=len)
        raise DataError(
            f"{longest.name} has {len(longest)} rows, of which a share of {share:g} "
            "cannot be held out. Name validation records, or take another share."
        )
    first = [r.part(0, edges[n]) for n, r in enumerate(data)]
    pairs = [(r, edges[n]) for n, r in enumerate(data) if edges[n]]
    last = [
        dataclasses.replace(r.part(edge, None), name=f"{r.name} (end)")
        for r, edge in pairs
    ]
    return (
        dataclasses.replace(data, records=tuple(first)),
        dataclasses.replace(data, records=tuple(last)),
    )
