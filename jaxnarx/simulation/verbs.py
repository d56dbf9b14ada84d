"""Run a network: k steps ahead from measured history, or freely on its own outputs."""

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.models import Network
from jaxnarx.simulation._prepared import (
    Prepared,
    ensure_prepared,
    get_dataset,
    match_records,
    prepare_stacked,
    stack_fitting,
)
from jaxnarx.simulation.outputs import predict_parts, run_parts
from jaxnarx.simulation.trajectories import Trajectories, make_trajectories
from jaxnarx.solution import RESULTS, STATUS_NAMES, Solution


def _ignored_channels(network: Network, data: Dataset) -> list[str]:
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
    codes = np.where(too_short, STATUS_NAMES.index("too_short"), 0)
    codes = np.where(bad, STATUS_NAMES.index("diverged"), codes)
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


@guard_arguments
def simulate(
    network: Network,
    data: Dataset | Prepared,
    *,
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

    Args:
        network: The model.
        data: Records with its channels, at its sample time, or prepared for it.
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
    if missing is None:
        (runs, origin), gaps = ensure_prepared(network, data), None
    else:
        records = get_dataset(data)
        matched = match_records(network, records)
        batch, gaps = stack_fitting(network, matched, missing)
        runs, origin = ensure_prepared(
            network, prepare_stacked(network, records, matched, batch)
        )
    scaled, masks = run_parts(network, runs), origin.masks
    matched = origin.matched
    value = make_trajectories(
        network, matched, origin.batch, scaled, masks.scored, masks.first, gaps=gaps
    )
    ignored = _ignored_channels(network, origin.data)
    return _solution(network, matched, value, masks.first, ignored)


@guard_arguments
def predict(
    network: Network, data: Dataset | Prepared, k: int = 1
) -> Solution[Trajectories]:
    """k-step-ahead prediction of every sample from measured history k samples before.

    Hidden channels are estimated at every sample from the `network.window` before it.
    Samples whose start has no complete valid history are not scored, and a record
    without any other is `too_short`. Same bounds, channels and statuses as `simulate`,
    but the bound acts on what is fed back alone: the k - 1 predictions on the way. One
    step ahead nothing is limited and nothing diverges; `extrapolated` tells where
    outputs leave the range of the training.

    Args:
        network: The model.
        data: Records with its channels, at its sample time, or prepared for it.
        k: Samples from the newest measurement used to the one predicted.

    Returns:
        As `simulate`.

    Example:
        ahead = jnx.predict(network, data, k=10)
        print(ahead.value.scored[0].sum(), "samples predicted")
    """
    if k < 1:
        raise SpecError(f"k must be at least 1, got {k}", field="k")
    runs, origin = ensure_prepared(network, data)
    matched, masks = origin.matched, origin.masks
    scaled, held = predict_parts(network, runs, k)
    ready = np.zeros_like(masks.anchors)
    ready[:, k - 1 :] = masks.anchors[:, : max(ready.shape[1] - k + 1, 0)]
    scored = masks.scored & ready[:, :, None]
    start = masks.first + k - 1
    value = make_trajectories(
        network, matched, origin.batch, scaled, scored, start, (k, held)
    )
    return _solution(
        network, matched, value, start, _ignored_channels(network, origin.data), k
    )
