"""Switching between models at run time, by priority (thesis section 8.3).

Models of different kinds, such as a NARX network of the middle of the operating range,
an output-error model and a linear one for everything, are listed by priority. At every
sample the first one that is valid acts, the last one where no other is. All are fed
back the output that acted, so that a change of models starts where the last one stood.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import free_run, program
from jaxnarx.data import Dataset, stack_records
from jaxnarx.errors import DataError, SpecError, suggest
from jaxnarx.models import Network, depth, recursion, report_outputs
from jaxnarx.simulation import (
    RunInputs,
    Trajectories,
    first_anchor,
    has_diverged,
    make_drive,
    make_masks,
    match_records,
    tables,
)
from jaxnarx.solution import RESULTS, Solution

Region = Mapping[str, tuple[float | int, float | int]]
"""Lower and upper limit of some channels, in their units."""


@guard_arguments
def switch(
    networks: Sequence[Network],
    data: Dataset,
    *,
    regions: Sequence[Region | None] | None = None,
    hold: int = 0,
) -> Solution[Trajectories]:
    """Free run of several networks, the first valid one acting (physical units).

    A network is valid where the channels of its entry in `regions` lie within their
    limits; without an entry, where the inputs that it uses lie in their training range.
    With `hold` it must have been so for that many samples before, which keeps a noisy
    border from switching to and fro. The networks model the same outputs of the same
    channels; outputs in a region are measured ones.

    The run starts where all have their history; an output is held within the widest of
    the feedback bounds, and reported within the trained range of the network that acts
    if that has limits. `stats["acting"]` holds, per record, the place in `networks` of
    the one that acts (-1 before the start), `stats["share"]` how often each does.
    Status `diverged` as in `simulate`.
    """
    _check(networks, regions, hold)
    regions = [None] * len(networks) if regions is None else regions
    data = [match_records(network, data) for network in networks][0]
    batch = stack_records(data)
    masks = [make_masks(network, batch) for network in networks]
    start = np.max([m.start for m in masks], axis=0)
    if np.all(start == batch.signals.shape[1]):
        raise DataError("no record has the samples that all networks start from")
    anchor = first_anchor(dataclasses.replace(masks[0], start=start))
    scored = np.all([m.scored for m in masks], axis=0)
    scored &= (np.arange(scored.shape[1])[None] >= start[:, None])[:, :, None]
    pairs = zip(networks, regions, strict=True)
    signals = np.asarray(batch.signals)
    valid = [_hold(_valid(n, r, signals), hold) for n, r in pairs]
    valid[-1] = np.ones_like(valid[-1])
    acting = np.argmax(valid, axis=0)
    drives = [make_drive(network, batch) for network in networks]
    y = _run(tuple(networks), drives, jnp.asarray(anchor), jnp.asarray(acting))
    found = tuple(map(np.asarray, y))
    return _solution(networks, data, found, scored, start, acting)


def _check(networks: Sequence[Network], regions, hold: int) -> None:
    if not networks or (regions is not None and len(regions) != len(networks)):
        raise SpecError(
            f"give networks by priority and a region, or None, for each; got "
            f"{len(networks)} networks and {len(regions or ())} regions",
            field="networks",
        )
    first = networks[0]
    for network in networks:
        same = network.channels == first.channels
        if not same or network.modelled != first.modelled or network.parallel:
            raise SpecError(
                "networks that switch model the same outputs of the same channels, "
                "and none is fed back outputs of its local models",
                field="networks",
            )
    if hold < 0:
        raise SpecError(f"hold must not be negative, got {hold}", field="hold")


def _valid(network: Network, region: Region | None, signals):
    """The samples at which the signals lie within the limits."""
    names = network.channels.names
    if region is None:
        inputs = len(network.channels.inputs)
        used = sorted({s for s, _ in tables(network) if s < inputs})
        low, high = np.asarray(network.low), np.asarray(network.high)
        limits = {s: (float(low[s]), float(high[s])) for s in used}
    else:
        unknown = [name for name in region if name not in names]
        if unknown:
            known = suggest(unknown[0], names)
            raise SpecError(f"no channel {unknown[0]!r}. {known}", field="regions")
        limits = {names.index(name): ends for name, ends in region.items()}
    good = np.ones(signals.shape[:2], bool)
    for s, (low, high) in limits.items():
        slack = 1e-9 * (high - low)
        x = signals[:, :, s]
        good &= (x >= low - slack) & (x <= high + slack)
    return good


def _hold(
    valid: Bool[np.ndarray, "records time"], hold: int
) -> Bool[np.ndarray, "records time"]:
    """The samples that are valid, as are the last `hold` ones, those before a record
    too."""
    good = valid.copy()
    for k in range(1, min(hold, valid.shape[1]) + 1):
        good[:, k:] &= valid[:, :-k]
    return good


@program
def _run(
    networks: tuple[Network, ...],
    drives: list[RunInputs],
    anchor: Bool[Array, "records time"],
    acting: Int[Array, "records time"],
) -> tuple[Float[Array, "records time outputs"], Bool[Array, "records time outputs"]]:
    """Outputs in physical units, and where they are held at a bound."""
    units = [n.gain[np.array(n.signals)] for n in networks]
    lower = jnp.min(
        jnp.stack([n.lower * u for n, u in zip(networks, units, strict=True)]), axis=0
    )
    upper = jnp.max(
        jnp.stack([n.upper * u for n, u in zip(networks, units, strict=True)]), axis=0
    )
    depths = [depth(network) for network in networks]

    def one(drives, anchor, acting):
        parts = [recursion(n, d.v, d.x) for n, d in zip(networks, drives, strict=True)]

        def step(params, drive, history):
            total = jnp.zeros(history.shape[0], history.dtype)
            for n, (advance, _, _) in enumerate(parts):
                own, unit = params[n]
                y = advance(own, drive[1][n], history[:, : depths[n]] / unit[:, None])
                total = jnp.where(drive[0] == n, y * unit, total)
            return total

        params = [(p, u) for (_, p, _), u in zip(parts, units, strict=True)]
        drive = acting, [d for _, _, d in parts]
        measured = drives[0].measured * units[0][None]
        return free_run(
            step, params, drive, measured, anchor, lower, upper, depth=max(depths)
        )

    y = jax.vmap(one)(drives, anchor, acting)
    return y, (y <= lower[None, None]) | (y >= upper[None, None])


def _solution(networks, data: Dataset, run, scored, start, acting) -> Solution:
    network: Network = networks[0]
    columns: list[list] = [[] for _ in range(8)]
    for n, record in enumerate(data):
        length, first = len(record), min(int(start[n]), len(record))
        y, hold = run[0][n, :length].copy(), run[1][n, :length].copy()
        y[:first] = record.y[:first, np.array(network.modelled)]
        hold[:first] = False
        who = acting[n, :length].copy()
        who[:first] = -1
        bad = np.asarray(has_diverged(hold[first:].T))
        edge, held = _report(networks, y, record.u, who)
        nothing = np.zeros(length, bool)
        parts = (edge, y, scored[n, :length], hold, held, nothing, bad, who)
        for column, part in zip(columns, parts, strict=True):
            column.append(part)
    outputs, computed, known, limited, held, outside, lost = map(tuple, columns[:7])
    names = tuple(data.names), tuple(network.output_names)
    parts = outputs, computed, known, limited, held, outside, lost
    value = Trajectories(*parts, *names)
    every = np.concatenate(columns[7])
    share = np.bincount(every[every >= 0], minlength=len(networks))
    stats = {"acting": columns[7], "share": share / max(share.sum(), 1)}
    if any(d.any() for d in value.diverged):
        n = int(np.argmax([d.any() for d in value.diverged]))
        detail = f"record {data.records[n].name!r} leaves the feedback bounds"
        return Solution(value, RESULTS.diverged, stats, detail)
    return Solution(value, RESULTS.ok, stats)


def _report(
    networks: Sequence[Network],
    y: Float[np.ndarray, "time outputs"],
    u: Float[np.ndarray, "time inputs"],
    who: Int[np.ndarray, " time"],
) -> tuple[Float[np.ndarray, "time outputs"], Bool[np.ndarray, "time outputs"]]:
    """Report each network's samples, and where they are held."""
    edge, held = y.copy(), np.zeros(y.shape, bool)
    for n, network in enumerate(networks):
        own, at_edge = report_outputs(network, y, u)
        edge[who == n], held[who == n] = own[who == n], at_edge[who == n]
    return edge, held
