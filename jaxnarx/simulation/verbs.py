"""Run a network: k steps ahead from measured history, or freely on its own outputs."""

import dataclasses

import equinox as eqx
import jax
import numpy as np

from jaxnarx.checks import choice
from jaxnarx.data import Dataset, match_channels
from jaxnarx.data.batch import Batch, stack
from jaxnarx.errors import DataError, SpecError
from jaxnarx.guard import guarded
from jaxnarx.models import HOLD, Gaps, Network, hold_missing
from jaxnarx.simulation.masks import Masks, first_anchor, make_masks
from jaxnarx.simulation.observer import begun, observed
from jaxnarx.simulation.runs import RunInputs, make_drive, run, run_parallel, run_steps
from jaxnarx.simulation.trajectories import Trajectories, make_trajectories
from jaxnarx.solution import NAMES, RESULTS, Solution


def _prepare(
    network: Network, data: Dataset, missing: str | None = None
) -> tuple[Dataset, Batch, Masks, RunInputs, Gaps | None]:
    matched = fitting(network, data)
    batch, gaps = stacked(network, matched, missing)
    masks = make_masks(network, batch, network.window)
    if np.all(masks.start == masks.anchors.shape[1]):
        shortest = min(data, key=len)
        raise DataError(
            f"no record can be run: the model needs {network.before} valid "
            f"measured samples to start from (record {shortest.name!r} has "
            f"{len(shortest)} rows)"
        )
    return matched, batch, masks, make_drive(network, batch), gaps


def stacked(
    network: Network, data: Dataset, missing: str | None
) -> tuple[Batch, Gaps | None]:
    """The records side by side; with `missing="hold"` inputs held where they are
    missing, and where that is."""
    if missing is None:
        return stack(data), None
    choice(missing, (HOLD,), "missing")
    return hold_missing(network, stack(data), [len(record) for record in data])


def fitting(network: Network, data: Dataset) -> Dataset:
    """`data` with the network's channels, in its order.

    `SpecError` where the sample time is another, or where the network's parameters are
    not finite: it could not be told from one that runs away.
    """
    data, _ = match_channels(data, network.channels)
    _same_sample_time(network, data)
    for name, model in zip(network.computed_names, network.models, strict=True):
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
    if value.missing:
        stats["missing"] = np.array([m.sum() for m in value.missing])
        stats["invalid"] = np.array([m.sum() for m in value.invalid])
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
            f"record {record.name!r} has no {network.before} valid samples in a row "
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
    network: Network,
    data: Dataset,
    *,
    time_parallel: bool | None = None,
    missing: str | None = None,
) -> Solution[Trajectories]:
    """Free run of every record on the network's own outputs (physical units).

    Starts from the first `network.history` valid samples of a record; hidden channels
    from what fits best the measured outputs of `network.window` samples behind them,
    which are not predicted then (`network.before` are the two together). Channels are
    matched by name; extra ones are ignored. Outputs are held within the model's
    feedback bound; status `diverged` when that bound acts on more than 5 % or on 50
    successive samples of a record, `too_short` when a record has no valid start. Never
    NaN, unless the model says nothing of a sample (its `outside` or `nan`). A model
    with limits (`jnx.models.hold_to_range`) sees inputs no farther than at the edge of
    their trained ranges, and reports no output far beyond its own; neither what is fed
    back nor the status depends on that margin.

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
        missing: `"hold"`: run over gaps of the inputs as exported models do
            (`jaxnarx.models.missing`): the last value that was not missing stands in
            their place, before the first the middle of the trained range, outputs are
            as the network's `nan` says, and samples are marked in `missing` and
            `invalid`. Default: samples whose inputs have gaps in their window are not
            scored.

    Returns:
        `value` holds the outputs record by record, `value[0]` (time, outputs), with
        masks `scored`, `limited`, `held` and `extrapolated`; `stats["record_status"]` a
        code for every record, `stats["limited"]` and `stats["held"]` how many samples
        of each record and output, `stats["ignored"]` the names of channels not used.

    Example:
        run = jnx.simulate(network, data)
        print(run.status_name, run.value[0].shape)
    """
    matched, batch, masks, drive, gaps = _prepare(network, data, missing)
    drive = begun(network, drive, jax.device_put(masks.start))
    anchor = jax.device_put(first_anchor(masks))
    stats = {}
    if time_parallel:
        scaled, converged = run_parallel(network, drive, anchor)
        stats["time_parallel"] = np.asarray(converged)
    else:
        scaled = run(network, drive, anchor)
    value = make_trajectories(
        network, matched, batch, scaled, masks.scored, masks.first, gaps=gaps
    )
    solution = _solution(network, matched, value, masks.first, _ignored(network, data))
    return dataclasses.replace(solution, stats=solution.stats | stats)


@guarded
def predict(network: Network, data: Dataset, k: int = 1) -> Solution[Trajectories]:
    """k-step-ahead prediction of every sample from measured history k samples before.

    Hidden channels are estimated at every sample from the `network.window` before it.
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
    matched, batch, masks, drive, _ = _prepare(network, data)
    drive = observed(network, drive)
    scaled, held = run_steps(network, drive, jax.device_put(np.asarray(k)))
    ready = np.zeros_like(masks.anchors)
    ready[:, k - 1 :] = masks.anchors[:, : max(ready.shape[1] - k + 1, 0)]
    scored = masks.scored & ready[:, :, None]
    start = masks.first + k - 1
    value = make_trajectories(network, matched, batch, scaled, scored, start, (k, held))
    return _solution(network, matched, value, start, _ignored(network, data), k)
