"""Masks of a run: where it may begin, and which samples count."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Int

from jaxnarx.arrays import usable
from jaxnarx.data import Batch
from jaxnarx.models import Network


@dataclasses.dataclass(frozen=True, eq=False)
class Masks:
    """Masks of the samples at which a dataset can be used, host arrays.

    `start` is the first sample of each record with a complete measured history (the
    longest record's length where there is none), where its free run begins, and `first`
    the one that is predicted first: of a network with hidden channels its window
    later. `end` is the one behind the last sample with any valid signal; `anchors` all
    samples that could be the first; `scored` where the output is measured and counts,
    and the inputs of its window are valid.
    """

    start: Int[np.ndarray, " records"]
    first: Int[np.ndarray, " records"]
    end: Int[np.ndarray, " records"]
    anchors: Bool[np.ndarray, "records time"]
    scored: Bool[np.ndarray, "records time outputs"]


def tables(network: Network) -> tuple[tuple[int, int], ...]:
    """All (signal, lag) a network looks at, terms and scheduling together."""
    rows = [*network.variables, *(r for m in network.models for r in m.scheduling)]
    return tuple(dict.fromkeys(rows))


def make_masks(network: Network, batch: Batch, window: int = 0) -> Masks:
    """Starts, possible anchors and scored samples, see `Masks`.

    `window` samples in a row, of which inputs and modelled outputs are valid, lie
    between the begin of a run and the first that counts.
    """
    measured = len(network.channels.measured.all)
    rows = tuple(r for r in tables(network) if r[0] < measured)
    inputs = tuple(r for r in rows if r[0] not in network.signals)
    present = np.any(batch.valid, axis=2)
    time: int = present.shape[1]
    end = time - np.argmax(present[:, ::-1], axis=1)
    there = np.arange(time)[None] < end[:, None]
    anchors = usable(batch.valid, rows, network.history) & there
    good = usable(batch.valid, inputs, network.history)
    outputs = batch.valid[
        :, :, len(network.channels.inputs) + np.array(network.modelled)
    ]
    if window:
        anchors = _behind(anchors & outputs.all(axis=2), window) & there
    first = np.where(np.any(anchors, axis=1), np.argmax(anchors, axis=1), time)
    after = np.arange(time)[None] >= first[:, None]
    if batch.scored is not None:
        good &= batch.scored
    scored = (good & after)[:, :, None] & outputs
    scored = np.pad(scored, ((0, 0), (0, 0), (0, network.hidden)))
    start = np.where(first < time, first - window, time)
    return Masks(start, first, end, anchors, scored)


def _behind(
    seen: Bool[np.ndarray, "records time"], window: int
) -> Bool[np.ndarray, "records time"]:
    """Samples with so many seen ones in a row before them."""
    count = np.cumsum(np.pad(seen, ((0, 0), (1, 0))), axis=1)[:, :-1]
    found = np.zeros_like(seen)
    earlier = count[:, : max(seen.shape[1] - window, 0)]
    found[:, window:] = count[:, window:] - earlier == window
    return found


def first_anchor(masks: Any) -> Bool[Array | np.ndarray, "records time"]:
    """Anchors of a free run: the first usable sample of each record.

    Past its last valid sample every one is an anchor: padding then cannot run away.
    `masks` are `Masks`, or arrays of a program with these names.
    """
    at = np.arange(masks.anchors.shape[1])[None]
    return (at == masks.start[:, None]) | (at >= masks.end[:, None])


def window_anchors(
    masks: Any, horizon: int | Int[Array, ""]
) -> Bool[Array | np.ndarray, "records time"]:
    """The anchors of free runs, and a restart every `horizon` samples where the history
    is valid."""
    at = np.arange(masks.anchors.shape[1])[None]
    every = (at - masks.start[:, None]) % horizon == 0
    return first_anchor(masks) | (every & masks.anchors)
