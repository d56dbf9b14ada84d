"""Less of long data: stretches of all records, evenly spread."""

import dataclasses

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.record import Record

STRETCHES = 8
"""Most stretches of one record ..."""
USUAL = 1000
"""... which hold so many samples or more, where the record allows it."""


def shortened(data: Dataset, rows: int) -> Dataset:
    """At most about `rows` samples, in their order and at their sample time.

    Every record keeps the same share, as stretches at equal distances, the first at its
    begin and the last at its end: one stretch of a short record, several of a long one.
    They are records of their own, of the same group. As they are where `rows` suffice.
    """
    if data.samples <= rows:
        return data
    share = rows / data.samples
    records = [part for record in data for part in _stretches(record, share)]
    return dataclasses.replace(data, records=tuple(records))


def _stretches(record: Record, share: float) -> list[Record]:
    kept = max(int(share * len(record)), 1)
    count = min(STRETCHES, max(kept // USUAL, 1))
    if count == 1:
        return [record.part(0, kept)]
    size = kept // count
    starts = [n * (len(record) - size) // (count - 1) for n in range(count)]
    return [
        dataclasses.replace(record.part(s, s + size), name=f"{record.name} ({n})")
        for n, s in enumerate(starts, 1)
    ]
