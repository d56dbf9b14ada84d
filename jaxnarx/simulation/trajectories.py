"""Trajectories of a run in physical units, and when it counts as diverged."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.data import Batch
from jaxnarx.formatting import align_columns, brief, page, some
from jaxnarx.models import NAN, Network, report_outputs
from jaxnarx.simulation.masks import tables

DIVERGED_SHARE = 0.05
"""A record whose limited samples exceed this share has diverged ..."""


IN_A_ROW = 50
"""... and so has one with this many limited samples in a row."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Trajectories:
    """Outputs of a run, one array per record, in physical units.

    Samples before the first prediction repeat the measurement; those of which a network
    says nothing (`outside="nan"`) are NaN, and not scored. `scored` marks predicted
    samples whose measurement is valid, `limited` those held by the feedback bound (of a
    k-step prediction: those that the bound held on the way, for k = 1 none; or that
    overflow), `held` those of a network with limits whose output is at the edge of its
    trained range in place of what was `computed`, `extrapolated` those with an input
    outside its training range, or in a prediction a measured or computed output;
    `diverged` tells per output whether the record counts as diverged. `hidden` are the
    hidden channels in their own unit; a sample of which one is held by its bound is
    `limited` for all outputs, as in exported code. For a run with `missing="hold"`,
    `missing` marks samples at which an input is missing, which are `extrapolated` too,
    and `invalid` those at which it has been for too long; empty otherwise.
    """

    outputs: tuple[Float[np.ndarray, "_ outputs"], ...]
    computed: tuple[Float[np.ndarray, "_ outputs"], ...]
    scored: tuple[Bool[np.ndarray, "_ outputs"], ...]
    limited: tuple[Bool[np.ndarray, "_ outputs"], ...]
    held: tuple[Bool[np.ndarray, "_ outputs"], ...]
    extrapolated: tuple[Bool[np.ndarray, " _"], ...]
    diverged: tuple[Bool[np.ndarray, " outputs"], ...]
    names: tuple[str, ...]
    output_names: tuple[str, ...]
    hidden: tuple[Float[np.ndarray, "_ hidden"], ...] = ()
    missing: tuple[Bool[np.ndarray, " _"], ...] = ()
    invalid: tuple[Bool[np.ndarray, " _"], ...] = ()

    def __str__(self) -> str:
        """Range, and samples that count or that the bound has held, by record."""
        head = f"Trajectories: {len(self)} records of {', '.join(self.output_names)}"
        heads = "record", "output", "samples", "scored", "limited", "from", "to", ""
        rows: list[tuple[str, ...]] = [heads]
        for n, record in enumerate(self.names):
            for o, name in enumerate(self.output_names):
                y = self.outputs[n][:, o]
                fine = y[np.isfinite(y)]
                ends = (fine.min(), fine.max()) if len(fine) else (np.nan, np.nan)
                masks = self.scored[n][:, o], self.limited[n][:, o]
                counts = [str(len(y)), *(str(int(mask.sum())) for mask in masks)]
                lost = "diverged" if self.diverged[n][o] else ""
                shown = [f"{end:.4g}" for end in ends]
                rows.append((record, name, *counts, *shown, lost))
        lines = align_columns(rows, [True, True, *(False,) * 5, True])
        return "\n".join([head, *some(lines, 24)])

    __repr__, _repr_html_ = brief, page

    def __len__(self) -> int:
        return len(self.outputs)

    def __getitem__(self, record: int) -> Float[np.ndarray, "time outputs"]:
        return self.outputs[record]


def limited_samples(
    network: Network, y: Float[Array, "records time outputs"]
) -> Bool[Array, "records time outputs"]:
    """The samples at which the feedback bound holds the scaled outputs of a run; not
    those at which a hidden channel saturates."""
    held = (y <= network.lower[None, None]) | (y >= network.upper[None, None])
    return held & ~network.saturates[None, None]


def has_diverged(
    held: Bool[Array | np.ndarray, "*rows time"],
    counted: Bool[Array | np.ndarray, "*rows time"] | None = None,
) -> Any:
    """More than 5 % of the samples, or 50 in a row, held by the feedback bound.

    The shares are of the samples that are `counted`, by default all; a flag for every
    row. NumPy in, NumPy out; inside programs too.
    """
    xp = np if isinstance(held, np.ndarray) else jnp
    counted = xp.ones_like(held) if counted is None else counted
    held = held & counted
    count, total = held.sum(axis=-1), counted.sum(axis=-1)
    bad = count.astype(float) > DIVERGED_SHARE * total.astype(float)
    if held.shape[-1] < IN_A_ROW:
        return bad
    so_far = xp.cumsum(held, axis=-1)
    before = xp.concatenate([xp.zeros_like(so_far[..., :1]), so_far], axis=-1)
    in_a_row = before[..., IN_A_ROW:] - before[..., :-IN_A_ROW]
    return bad | (in_a_row == IN_A_ROW).any(axis=-1)


def _extrapolated_samples(
    network: Network, batch: Batch, k: int | None
) -> Bool[np.ndarray, "records time"]:
    """The samples at which an input leaves its range; with `k` a measured output too,
    which the prediction starts from that many steps before."""
    signals = np.asarray(network.complete(batch.signals))
    slack = 1e-9 * (np.asarray(network.high) - np.asarray(network.low))
    outside = (signals < np.asarray(network.low) - slack) | (
        signals > np.asarray(network.high) + slack
    )
    records, time, _ = signals.shape
    mask = np.zeros((records, time), bool)
    for s, d in tables(network):
        if s in network.signals:
            if k is None or s >= len(network.channels.measured.all):
                continue
            d += k - 1
        mask[:, d:] |= outside[:, : max(time - d, 0), s]
    return mask


def make_trajectories(
    network, data, batch, scaled, scored, start, ahead=None, gaps=None
) -> Trajectories:
    """Trajectories of a free run, or of a prediction so many steps `ahead` = (k,
    limited)."""
    own = np.array(network.signals)
    ranges = network.gain, network.low, network.high
    gain, low, high = (np.asarray(a)[own] for a in ranges)
    lower, upper = np.asarray(network.lower), np.asarray(network.upper)
    with np.errstate(over="ignore", invalid="ignore"):
        computed = np.asarray(scaled) * gain
    lost = ~np.isfinite(computed)
    computed = np.where(lost, lower * gain, computed)
    extrapolated = _extrapolated_samples(network, batch, ahead and ahead[0])
    silent = np.zeros_like(extrapolated)
    if network.outside == NAN:
        silent = _extrapolated_samples(network, batch, None)
    if gaps is not None:
        extrapolated |= gaps.missing
        if NAN in (network.nan, network.outside):
            silent |= gaps.missing
    free = ~network.saturates
    if ahead is None:
        held = (np.asarray(scaled) <= lower) | (np.asarray(scaled) >= upper)
    else:
        held = np.asarray(ahead[1])
        extrapolated |= np.any(((computed < low) | (computed > high)) & free, axis=2)
    limited = lost | (held & free)
    count = len(network.modelled)
    limited = limited[..., :count] | limited[..., count:].any(axis=2, keepdims=True)
    outputs, hidden, scored = (
        computed[..., :count],
        computed[..., count:],
        scored[..., :count],
    )
    inputs = np.asarray(batch.signals)[..., : len(network.channels.inputs)]
    edge, at_edge = report_outputs(network, outputs, inputs)
    edge = np.where(silent[..., None], np.nan, edge)
    scored = np.asarray(scored) & ~silent[..., None]
    columns: tuple[list, ...] = ([], [], [], [], [], [], [])
    for n, record in enumerate(data):
        length = len(record)
        first = min(int(start[n]), length)
        values = edge[n, :length], outputs[n, :length]
        for y in values:
            y[:first] = record.y[:first, np.array(network.modelled)]
        masks = limited[n, :length].copy(), at_edge[n, :length].copy()
        for mask in masks:
            mask[:first] = False
        bad = np.asarray(has_diverged(masks[0][first:].T))
        parts = *values, scored[n, :length], *masks, extrapolated[n, :length], bad
        for column, part in zip(columns, parts, strict=True):
            column.append(part)
    marks = {} if gaps is None else {"missing": gaps.missing, "invalid": gaps.invalid}
    return Trajectories(
        *map(tuple, columns),
        names=tuple(data.names),
        output_names=tuple(network.output_names),
        hidden=tuple(h[: len(r)] for h, r in zip(hidden, data, strict=True)),
        **{
            name: tuple(m[: len(r)] for m, r in zip(mask, data, strict=True))
            for name, mask in marks.items()
        },
    )


def join_runs(runs: Sequence[Trajectories]) -> Trajectories:
    """The records of several runs of the same outputs, one behind another."""
    first = runs[0]
    fields = [f.name for f in dataclasses.fields(first) if f.name != "output_names"]
    every = {name: tuple(x for r in runs for x in getattr(r, name)) for name in fields}
    return Trajectories(**every, output_names=first.output_names)
