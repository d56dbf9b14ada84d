"""Shorten long data to stretches of all records, evenly spread."""

import dataclasses

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.record import Record

MAX_STRETCHES = 8
"""Most stretches of one record ..."""
STRETCH_SAMPLES = 500
"""... which hold so many samples or more, where the record allows it."""

GOLDEN_RATIO = (5**0.5 - 1) / 2
"""Its multiples, less whole numbers, are spread evenly whatever their count."""


def thin_records(data: Dataset, rows: int, shortest: int = 0) -> Dataset:
    """At most about `rows` samples, in their order and at their sample time.

    Every record keeps the same share: a long one as stretches at equal distances, the
    first at its begin and the last at its end, short ones as one stretch, each at
    another place. The stretches are records of their own, of the same group, of at
    least `shortest` samples where the share of a record is that long. Data that fit
    already are returned as they are.
    """
    if data.samples <= rows:
        return data
    share = rows / data.samples
    records = [
        part
        for n, record in enumerate(data)
        for part in _stretches(record, share, n * GOLDEN_RATIO % 1.0, shortest)
    ]
    return dataclasses.replace(data, records=tuple(records))


def _stretches(
    record: Record, share: float, place: float, shortest: int
) -> list[Record]:
    kept = max(int(share * len(record)), 1)
    count = min(MAX_STRETCHES, max(kept // max(STRETCH_SAMPLES, shortest), 1))
    if count == 1:
        first = int(place * (len(record) - kept + 1))
        return [record.part(first, first + kept)]
    size = kept // count
    starts = [n * (len(record) - size) // (count - 1) for n in range(count)]
    return [
        dataclasses.replace(record.part(s, s + size), name=f"{record.name} ({n})")
        for n, s in enumerate(starts, 1)
    ]
