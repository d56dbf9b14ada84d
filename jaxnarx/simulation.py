"""Run a network: k steps ahead from measured history, or freely on its own outputs."""

import dataclasses
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.blocks import map_blocks
from jaxnarx.arrays.programs import program
from jaxnarx.arrays.recurrence import free_run, history_of
from jaxnarx.arrays.time_parallel import parallel_run
from jaxnarx.arrays.windows import usable
from jaxnarx.data import Dataset, match_channels
from jaxnarx.data.batch import Batch, stack
from jaxnarx.errors import DataError, SpecError
from jaxnarx.guard import guarded
from jaxnarx.models import (
    Network,
    advance,
    collapse,
    collapsed_step,
    collapses,
    depth,
    general_step,
    reported,
    widened,
)
from jaxnarx.solution import NAMES, RESULTS, Solution

BLOCK = 512
"""Samples of a record collapsed at a time: at 100,000 that took a third of the time."""
SHARE = 0.05
"""A record whose limited samples exceed this share has diverged ..."""
IN_A_ROW = 50
"""... and so has one with this many limited samples in a row."""


class RunInputs(eqx.Module):
    """What a run needs of the measurements, computed once per dataset.

    `v`: a leading one and the scaled lagged variables; `x`: scheduling variables of
    every output in physical units; `measured`: scaled outputs.
    """

    v: Float[Array, "records vars time"]
    x: tuple[Float[Array, "records _ time"], ...]
    measured: Float[Array, "records time outputs"]


@dataclasses.dataclass(frozen=True, eq=False)
class Masks:
    """Where a dataset can be used, host arrays.

    `start` is the first sample of each record with a complete measured history (the
    longest record's length where there is none), `end` the one behind the last sample
    with any valid signal; `anchors` all samples with such a history; `scored` where the
    output is measured and counts, and the inputs of its window are valid.
    """

    start: Int[np.ndarray, " records"]
    end: Int[np.ndarray, " records"]
    anchors: Bool[np.ndarray, "records time"]
    scored: Bool[np.ndarray, "records time outputs"]


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectories:
    """Outputs of a run, one array per record, in physical units.

    Samples before the first prediction repeat the measurement. `scored` marks predicted
    samples whose measurement is valid, `limited` those held by the feedback bound (of a
    k-step prediction: those that the bound held on the way, for k = 1 none; or that are
    beyond all numbers), `held` those of a network with limits whose output is at the
    edge of its trained range in place of what was `computed`, `extrapolated` those with
    an input outside its training range, or in a prediction a measured or computed
    output; `diverged` tells per output whether the record counts as diverged.
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

    def __len__(self) -> int:
        return len(self.outputs)

    def __getitem__(self, record: int) -> Float[np.ndarray, "time outputs"]:
        return self.outputs[record]


def tables(network: Network) -> tuple[tuple[int, int], ...]:
    """All (signal, lag) a network looks at, terms and scheduling together."""
    rows = [*network.variables, *(r for m in network.models for r in m.scheduling)]
    return tuple(dict.fromkeys(rows))


@program
def make_drive(network: Network, batch: Batch) -> RunInputs:
    """Lagged and scheduling variables of every record."""
    return drive_of(network, batch.signals, jnp.asarray(batch.valid))


def drive_of(
    network: Network,
    signals: Float[Array, "records time signals"],
    valid: Bool[Array, "records time signals"],
) -> RunInputs:
    """The same inside a program, from the arrays of a batch."""

    def one(record):
        signals, valid = record
        v, x = network.columns(signals, valid)
        scaled = signals / network.gain[None]
        return v, x, scaled[:, np.array(network.signals)]

    return RunInputs(*jax.lax.map(one, (signals, valid)))


def make_masks(network: Network, batch: Batch) -> Masks:
    """Starts, possible anchors and scored samples, see `Masks`."""
    rows = tables(network)
    inputs = tuple(r for r in rows if r[0] not in network.signals)
    present = np.any(batch.valid, axis=2)
    time: int = present.shape[1]
    end = time - np.argmax(present[:, ::-1], axis=1)
    there = np.arange(time)[None] < end[:, None]
    anchors = usable(batch.valid, rows, network.history) & there
    good = usable(batch.valid, inputs, network.history)
    start = np.where(np.any(anchors, axis=1), np.argmax(anchors, axis=1), time)
    after = np.arange(time)[None] >= start[:, None]
    if batch.scored is not None:
        good &= batch.scored
    scored = (good & after)[:, :, None] & batch.valid[:, :, np.array(network.signals)]
    return Masks(start, end, anchors, scored)


def recursion(network: Network, v: Float[Array, "vars time"], x: tuple):
    """Step, parameters and drive of `free_run` for one record."""
    if collapses(network):
        g = map_blocks(
            lambda block: jnp.moveaxis(collapse(network, *block), -1, 0), (v, x), BLOCK
        )
        return collapsed_step(network), None, g
    drive = (v.T, tuple(x_o.T for x_o in x))
    return general_step(network), eqx.filter(network, eqx.is_array), drive


def run_record(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    measured: Float[Array, "time outputs"],
    anchor: Bool[Array, " time"],
) -> Float[Array, "time outputs"]:
    """Scaled outputs of one record, restarted from the measurement at anchors.

    The one simulation semantics: a free run has one anchor. Pure and differentiable.
    """
    return run_states(network, v, x, measured, anchor)[:, : len(network.models)]


def run_states(
    network: Network,
    v: Float[Array, "vars time"],
    x: tuple[Float[Array, "_ time"], ...],
    measured: Float[Array, "time outputs"],
    anchor: Bool[Array, " time"],
) -> Float[Array, "time states"]:
    """What the loop of a run carries: the outputs, and those of local models that have
    feedback of their own (`jaxnarx.models.feedback`)."""
    bounds = widened(network, network.lower), widened(network, network.upper)
    inputs, start = recursion(network, v, x), widened(network, measured)
    return free_run(*inputs, start, anchor, *bounds, depth=depth(network))


@program
def run(
    network: Network, drive: RunInputs, anchor: Bool[Array, "records time"]
) -> Float[Array, "records time outputs"]:
    """Scaled outputs of all records."""
    one = partial(run_record, network)
    return jax.vmap(one)(drive.v, drive.x, drive.measured, anchor)


@program
def states(
    network: Network, drive: RunInputs, anchor: Bool[Array, "records time"]
) -> Float[Array, "records time states"]:
    """All that the loop of a run carries, for all records; see `run_states`."""
    one = partial(run_states, network)
    return jax.vmap(one)(drive.v, drive.x, drive.measured, anchor)


@program
def run_parallel(
    network: Network, drive: RunInputs, anchor: Bool[Array, "records time"]
) -> tuple[Float[Array, "records time outputs"], Bool[Array, " records"]]:
    """Scaled outputs of all records, parallel in time, and where that has succeeded.

    See `jaxnarx.arrays.time_parallel.parallel_run`; records go one after the other.
    """

    def one(record):
        v, x, measured, anchor = record
        bounds = widened(network, network.lower), widened(network, network.upper)
        inputs, start = recursion(network, v, x), widened(network, measured)
        lags = depth(network)
        y, converged = parallel_run(*inputs, start, anchor, *bounds, depth=lags)
        return y[:, : len(network.models)], converged

    return jax.lax.map(one, (drive.v, drive.x, drive.measured, anchor))


@program
def run_steps(
    network: Network, drive: RunInputs, k: Int[Array, ""]
) -> tuple[Float[Array, "records time outputs"], Bool[Array, "records time outputs"]]:
    """Scaled k-step-ahead prediction of every sample; `k` may be traced.

    All starting points advance together: the history of sample t holds measurements up
    to t - k and predictions after that. The bound is one of the feedback: it holds the
    predictions on the way, and says where it did, but not the last one, which nothing
    is computed from.
    """
    lower, upper = (widened(network, b) for b in (network.lower, network.upper))

    def one(v, x, measured):
        measured = widened(network, measured)
        past = jnp.moveaxis(history_of(measured, depth(network)), 0, -1)
        past = jnp.roll(past, k - 1, axis=-1)

        def one_on(j, carry):
            past, _, held = carry
            shift = k - 1 - j
            inputs = jax.tree.map(lambda a: jnp.roll(a, shift, axis=-1), (v, x))
            y = advance(network, inputs[0], inputs[1], past)
            fed = jnp.clip(y, lower[:, None], upper[:, None])
            held |= (shift > 0) & ((fed <= lower[:, None]) | (fed >= upper[:, None]))
            return jnp.concatenate([fed[:, None], past[:, :-1]], axis=1), y, held

        start = past, past[:, 0], jnp.zeros(past[:, 0].shape, bool)
        _, y, held = jax.lax.fori_loop(0, k, one_on, start)
        outputs = len(network.models)
        return y[:outputs].T, held[:outputs].T

    return jax.lax.map(lambda a: one(*a), (drive.v, drive.x, drive.measured))


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
    """Those, and a restart every `horizon` samples where the history is valid."""
    at = np.arange(masks.anchors.shape[1])[None]
    every = (at - masks.start[:, None]) % horizon == 0
    return first_anchor(masks) | (every & masks.anchors)


def _prepare(network: Network, data: Dataset):
    matched = fitting(network, data)
    batch = stack(matched)
    masks = make_masks(network, batch)
    if np.all(masks.start == masks.anchors.shape[1]):
        shortest = min(data, key=len)
        raise DataError(
            f"no record can be run: the model needs {network.history} valid "
            f"measured samples to start from (record {shortest.name!r} has "
            f"{len(shortest)} rows)"
        )
    return matched, batch, masks, make_drive(network, batch)


def fitting(network: Network, data: Dataset) -> Dataset:
    """`data` with the network's channels, in its order.

    `SpecError` where the sample time is another, or where the network's parameters are
    not finite: it could not be told from one that runs away.
    """
    data, _ = match_channels(data, network.channels)
    _same_sample_time(network, data)
    for name, model in zip(network.output_names, network.models, strict=True):
        parts = {"coefficient": model.local.coefficient, "partition": model.validity}
        for part, tree in parts.items():
            leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_inexact_array))
            if not all(np.all(np.isfinite(leaf)) for leaf in leaves):
                raise SpecError(
                    f"the model of {name} has a {part} that is not finite; "
                    "load or grow it anew",
                    field=part,
                )
    return data


def _same_sample_time(network: Network, data: Dataset) -> None:
    expected = float(network.sample_time)
    if abs(data.sample_time - expected) > 1e-6 * expected:
        raise SpecError(
            f"the model was identified at a sample time of {expected:g} s, the data "
            f"have {data.sample_time:g} s; resample the data",
            field="sample_time",
        )


def limited(
    network: Network, y: Float[Array, "records time outputs"]
) -> Bool[Array, "records time outputs"]:
    """Where the feedback bound holds the scaled outputs of a run."""
    return (y <= network.lower[None, None]) | (y >= network.upper[None, None])


def has_diverged(
    held: Bool[Array | np.ndarray, "*rows time"],
    counted: Bool[Array | np.ndarray, "*rows time"] | None = None,
) -> Any:
    """More than 5 % of the samples, or 50 in a row, held by the feedback bound.

    Of the samples that are `counted`, by default all; a flag for every row. NumPy in,
    NumPy out; inside programs too.
    """
    xp = np if isinstance(held, np.ndarray) else jnp
    counted = xp.ones_like(held) if counted is None else counted
    held = held & counted
    count, total = held.sum(axis=-1), counted.sum(axis=-1)
    bad = count.astype(float) > SHARE * total.astype(float)
    if held.shape[-1] < IN_A_ROW:
        return bad
    so_far = xp.cumsum(held, axis=-1)
    before = xp.concatenate([xp.zeros_like(so_far[..., :1]), so_far], axis=-1)
    in_a_row = before[..., IN_A_ROW:] - before[..., :-IN_A_ROW]
    return bad | (in_a_row == IN_A_ROW).any(axis=-1)


def _extrapolated(
    network: Network, batch: Batch, k: int | None
) -> Bool[np.ndarray, "records time"]:
    """Where an input leaves its range; with `k` a measured output too, which the
    prediction starts from that many steps before."""
    signals = np.asarray(batch.signals)
    slack = 1e-9 * (np.asarray(network.high) - np.asarray(network.low))
    outside = (signals < np.asarray(network.low) - slack) | (
        signals > np.asarray(network.high) + slack
    )
    records, time, _ = signals.shape
    mask = np.zeros((records, time), bool)
    for s, d in tables(network):
        if s in network.signals:
            if k is None:
                continue
            d += k - 1
        mask[:, d:] |= outside[:, : max(time - d, 0), s]
    return mask


def _trajectories(
    network, data, batch, scaled, scored, start, ahead=None
) -> Trajectories:
    """Of a free run, or of a prediction so many steps `ahead` = (k, limited)."""
    own = np.array(network.signals)
    ranges = network.gain, network.low, network.high
    gain, low, high = (np.asarray(a)[own] for a in ranges)
    lower, upper = np.asarray(network.lower), np.asarray(network.upper)
    with np.errstate(over="ignore", invalid="ignore"):
        outputs = np.asarray(scaled) * gain
    lost = ~np.isfinite(outputs)
    outputs = np.where(lost, lower * gain, outputs)
    extrapolated = _extrapolated(network, batch, ahead and ahead[0])
    if ahead is None:
        limited = lost | (np.asarray(scaled) <= lower) | (np.asarray(scaled) >= upper)
    else:
        limited = lost | np.asarray(ahead[1])
        extrapolated |= np.any((outputs < low) | (outputs > high), axis=2)
    edge, at_edge = reported(network, outputs)
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
    return Trajectories(
        *map(tuple, columns),
        names=tuple(data.names),
        output_names=tuple(network.output_names),
    )


def _ignored(network: Network, data: Dataset) -> list[str]:
    """Channels of the data that the model does not know."""
    return [n for n in data.channels.names if n not in network.channels.names]


def _solution(
    network: Network,
    data: Dataset,
    value: Trajectories,
    start,
    ignored: list[str],
    k: int = 1,
) -> Solution:
    too_short = np.array([s >= len(r) for s, r in zip(start, data, strict=True)])
    bad = np.array([d.any() for d in value.diverged])
    codes = np.where(too_short, NAMES.index("too_short"), 0)
    codes = np.where(bad, NAMES.index("diverged"), codes)
    stats: dict = {
        "record_status": codes,
        "limited": np.array([h.sum(axis=0) for h in value.limited]),
        "held": np.array([h.sum(axis=0) for h in value.held]),
        "extrapolated": np.array([e.mean() for e in value.extrapolated]),
    }
    status, detail = RESULTS.ok, ""
    if bad.any():
        n = int(np.argmax(bad))
        o = int(np.argmax(value.diverged[n]))
        step = int(np.argmax(value.limited[n][:, o]))
        record, time = data.records[n], step * data.sample_time
        stats |= {
            "record": n,
            "row": step + record.start_row,
            "time": time,
            "first_bad_step": step,
            "channel": network.output_names[o],
        }
        status = RESULTS.diverged
        detail = (
            f"{network.output_names[o]} leaves its bounds in record {record.name!r} "
            f"first at sample {step} (t = {time:g} s); {int(bad.sum())} of "
            f"{len(bad)} records"
        )
    elif too_short.any():
        n = int(np.argmax(too_short))
        status = RESULTS.too_short
        record = data.records[n]
        detail = (
            f"record {record.name!r} has no {network.history} valid samples in a row "
            "to start from"
        )
        if k > 1:
            detail += f" {k} steps before the end of its {len(record)}"
    if ignored:
        stats["ignored"] = tuple(ignored)
        said = "channels that the model does not know are ignored: " + ", ".join(
            ignored
        )
        detail = f"{detail}; {said}" if detail else said
    return Solution(value, status, stats, detail)


@guarded
def simulate(
    network: Network, data: Dataset, *, time_parallel: bool | None = None
) -> Solution[Trajectories]:
    """Free run of every record on the network's own outputs (physical units).

    Starts from the first `network.history` valid samples of a record. Channels are
    matched by name; extra ones are ignored. Outputs are held within the model's
    feedback bound; status `diverged` when that bound acts on more than 5 % or on 50
    successive samples of a record, `too_short` when a record has no valid start. Never
    NaN. A model with limits (`jnx.models.hold_to_range`) sees inputs no farther than at
    the edge of their trained ranges, and reports no output far beyond its own; neither
    what is fed back nor the status depends on that margin.

    `time_parallel` solves for the whole trajectory at once (Newton's method, see
    `jaxnarx.arrays.time_parallel`) with the same outputs to 1e-9; the records for which
    that has not converged are run step by step, and `stats["time_parallel"]` says for
    which it has. None uses it where it is measured to win, which is nowhere so far: on
    a CPU of two cores it takes 5 to 7 times as long as the loop at 1,800 samples of one
    output with three lags, about 30 times at 100,000; accelerators are not measured.

    Args:
        network: The model.
        data: Records with its channels, at its sample time.
        time_parallel: Solve for the whole trajectory at once; see above.

    Returns:
        `value` holds the outputs record by record, `value[0]` (time, outputs), with
        masks `scored`, `limited`, `held` and `extrapolated`; `stats["record_status"]` a
        code for every record, `stats["limited"]` and `stats["held"]` how many samples
        of each record and output, `stats["ignored"]` the names of channels not used.

    Example:
        run = jnx.simulate(network, data)
        print(run.status_name, run.value[0].shape)
    """
    matched, batch, masks, drive = _prepare(network, data)
    anchor = jax.device_put(first_anchor(masks))
    stats = {}
    if time_parallel:
        scaled, converged = run_parallel(network, drive, anchor)
        stats["time_parallel"] = np.asarray(converged)
    else:
        scaled = run(network, drive, anchor)
    value = _trajectories(network, matched, batch, scaled, masks.scored, masks.start)
    solution = _solution(network, matched, value, masks.start, _ignored(network, data))
    return dataclasses.replace(solution, stats=solution.stats | stats)


@guarded
def predict(network: Network, data: Dataset, k: int = 1) -> Solution[Trajectories]:
    """k-step-ahead prediction of every sample from measured history k samples before.

    Samples whose start has no complete valid history are not scored, and a record
    without any other is `too_short`. Same bounds, channels and statuses as `simulate`,
    but the bound acts on what is fed back alone: the k - 1 predictions on the way. One
    step ahead nothing is limited and nothing diverges; `extrapolated` tells where
    outputs leave the range of the training.

    Args:
        network: The model.
        data: Records with its channels, at its sample time.
        k: Samples from the newest measurement used to the one predicted.

    Returns:
        As `simulate`.

    Example:
        ahead = jnx.predict(network, data, k=10)
        print(ahead.value.scored[0].sum(), "samples predicted")
    """
    if k < 1:
        raise SpecError(f"k must be at least 1, got {k}", field="k")
    matched, batch, masks, drive = _prepare(network, data)
    scaled, held = run_steps(network, drive, jax.device_put(np.asarray(k)))
    ready = np.zeros_like(masks.anchors)
    ready[:, k - 1 :] = masks.anchors[:, : max(ready.shape[1] - k + 1, 0)]
    scored = masks.scored & ready[:, :, None]
    start = masks.start + k - 1
    value = _trajectories(network, matched, batch, scaled, scored, start, (k, held))
    return _solution(network, matched, value, start, _ignored(network, data), k)
