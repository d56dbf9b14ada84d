"""Validation records held out of training, chosen so that they ask for interpolation.

Taking every fifth record may take every record of one regime (fuel cut-off, say), and
then validation measures extrapolation. Here a record is held out only if another one
resembles it and stays in training.
"""

import numpy as np

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.record import Record
from jaxnarx.errors import DataError, SpecError


def _features(data: Dataset) -> np.ndarray:
    """Level, spread and extremes of every input of every record, in unit scale."""
    scale = np.concatenate([r.u for r in data]).std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    rows = []
    for record in data:
        u = record.u / scale
        parts = [u.mean(axis=0), u.std(axis=0), *np.quantile(u, (0.01, 0.99), axis=0)]
        rows.append(np.concatenate(parts))
    return np.array(rows)


def hold_out(data: Dataset, *, share: float | int = 0.2) -> tuple[Dataset, Dataset]:
    """Split into training and validation; about `share` of the samples validate.

    With four records or more whole ones are held out: those most alike to a record that
    stays. With fewer, or where no record is small enough for that, the last part of
    every record is cut off. The order of records is kept.
    """
    if not 0 < share < 1:
        raise SpecError(
            f"the share held out must lie between 0 and 1, got {share}", field="share"
        )
    if len(data) < 4:
        return _cut(data, share)
    points = _features(data)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    wanted, taken = share * data.samples, 0
    held: list[int] = []
    kept: set[int] = set()
    for flat in np.argsort(distance, axis=None).tolist():
        a, b = divmod(flat, len(data))
        free = [i for i in (max(a, b), min(a, b)) if i not in held and i not in kept]
        if {a, b} & set(held) or not free:
            continue
        size = len(data.records[free[0]])
        if taken + size > 1.25 * wanted:
            continue
        held.append(free[0])
        kept.add(a + b - free[0])
        taken += size
        if taken >= 0.8 * wanted:
            break
    if not held:
        return _cut(data, share)
    train = [i for i in range(len(data)) if i not in held]
    return data[train], data[sorted(held)]


def _cut(data: Dataset, share: float | int) -> tuple[Dataset, Dataset]:
    def part(record: Record, rows: slice, name: str) -> Record:
        start = record.start_row + (rows.start or 0)
        return Record(record.u[rows], record.y[rows], record.valid[rows], name, start)

    first, last = [], []
    for record in data:
        edge = int(round(len(record) * (1 - share)))
        if not 0 < edge < len(record):
            raise DataError(
                f"{record.name} has {len(record)} rows, of which a share of {share:g} "
                "cannot be held out. Name validation records, or take another share."
            )
        first.append(part(record, slice(0, edge), record.name))
        last.append(part(record, slice(edge, None), f"{record.name} (end)"))
    return (
        Dataset(tuple(first), data.channels, data.sample_time),
        Dataset(tuple(last), data.channels, data.sample_time),
    )
