"""References prepared for runs of a cascade."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays import usable
from jaxnarx.data import Dataset, stack_records
from jaxnarx.errors import DataError
from jaxnarx.inverse.loop import Loop
from jaxnarx.simulation import match_records, tables


class TaskSignals(eqx.Module):
    """Signals and validity of all records, as the loop wants them."""

    signals: Float[Array, "records time signals"]
    valid: Bool[Array, "records time signals"]


@dataclasses.dataclass(frozen=True, eq=False)
class CascadeTask:
    """Records and the samples at which they can be run and scored, host arrays.

    `anchors` are all samples with a complete valid history, `start` the first of each
    record (the longest record's length where there is none), `end` the one behind its
    last; `scored` where the reference is valid and the other inputs are.
    """

    data: Dataset
    batch: TaskSignals
    anchors: Bool[np.ndarray, "records time"]
    start: Int[np.ndarray, " records"]
    end: Int[np.ndarray, " records"]
    scored: Bool[np.ndarray, "records time targets"]
    reference: Float[np.ndarray, "records time targets"]

    def anchor(self, horizon: int | None = None) -> Bool[np.ndarray, "records time"]:
        """The samples at which runs start: once a record, or anew every `horizon`
        samples.

        Behind the end every sample is one: padding then cannot run away.
        """
        at = np.arange(self.anchors.shape[1])[None]
        since = at - self.start[:, None]
        first = (since == 0) | (at >= self.end[:, None])
        if horizon is None:
            return first
        return first | (self.anchors & (since > 0) & (since % horizon == 0))


def make_task(loop: Loop, references: Dataset) -> CascadeTask:
    """Prepare `references`, which have the channels of the forward network.

    `DataError` where no record has enough valid samples to start from.
    """
    forward, inverse = loop.forward, loop.inverse
    data = match_records(forward, references)
    batch = stack_records(data)
    sources = loop.wiring.source
    rows = set(tables(forward)) | {(s, 1) for s in loop.command_signals}
    # What lies ahead is the reference's future: only its present must be valid.
    rows |= {(sources[s][0], max(d - sources[s][1], 0)) for s, d in tables(inverse)}
    anchors = usable(batch.valid, tuple(rows), loop.history)
    time: int = anchors.shape[1]
    start = np.where(anchors.any(axis=1), anchors.argmax(axis=1), time)
    if np.all(start == time):
        longest = max(data, key=len)
        raise DataError(
            f"no record can be run: the cascade needs {loop.history} valid samples to "
            f"start from (record {longest.name!r} has {len(longest)} rows)"
        )
    computed = {*forward.signals, *loop.command_signals}
    given = tuple(r for r in tables(forward) if r[0] not in computed)
    good = usable(batch.valid, given, loop.history)
    good &= np.arange(time)[None] >= start[:, None]
    target = np.array(forward.signals)[np.array(loop.wiring.targets)]
    return CascadeTask(
        data,
        TaskSignals(batch.signals, jnp.asarray(batch.valid)),
        anchors,
        start,
        np.array([len(r) for r in data]),
        good[:, :, None] & batch.valid[:, :, target],
        np.asarray(batch.signals)[:, :, target],
    )


def spreads(loop: Loop, task: CascadeTask) -> Float[np.ndarray, " targets"]:
    """Standard deviation of every scored reference; where it rests, its range in
    training."""
    target = np.array(loop.forward.signals)[np.array(loop.wiring.targets)]
    wide = (np.asarray(loop.forward.high) - np.asarray(loop.forward.low))[target]
    found = []
    for o, fallback in enumerate(wide):
        values = task.reference[:, :, o][task.scored[:, :, o]]
        size = values.std() if values.size else 0.0
        small = 1e-6 * max(fallback, np.finfo(float).tiny)
        found.append(size if size > small else fallback if fallback > 0 else 1.0)
    return np.array(found, task.reference.dtype)
