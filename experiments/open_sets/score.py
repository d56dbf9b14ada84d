"""Errors of free runs on the scored samples, output by output.

`errors` needs nothing but numpy, so that peers are scored by the same lines;
`free_runs` runs a network through `jaxnarx.simulate`.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from sets import OpenSet, Part

FAR = 10.0
"""A run that leaves the training range by more than so many widths has diverged."""

LATE = 0.1
"""A run that lacks more than this share of the samples due has no figure."""

Row = dict[str, Any]


def errors(targets: Any, runs: Any, counted: Any, scale: float = 1.0) -> Row:
    """RMSE (times `scale`) and NRMSE of one output, pooled over the counted samples.

    Arguments are lists of (time,) arrays, one for each record; NRMSE is the root of the
    squared error over that of the mean of the targets. None where a counted sample of
    a run is not finite, or none is counted; no NRMSE of a constant.
    """
    import numpy as np

    y, run = (
        np.concatenate([a[m] for a, m in zip(arrays, counted, strict=True)])
        for arrays in (targets, runs)
    )
    row: Row = {"rmse": None, "nrmse": None, "samples": len(y)}
    if len(y) == 0 or not np.all(np.isfinite(run)):
        return row
    with np.errstate(over="ignore"):
        rmse = float(np.sqrt(np.mean((run - y) ** 2)))
    if math.isfinite(rmse):
        row["rmse"] = digits(scale * rmse)
        if (spread := float(y.std())) > 0:
            row["nrmse"] = digits(rmse / spread)
    return row


def digits(value: float) -> float:
    """Five significant digits, as the table keeps them."""
    return float(f"{value:.5g}")


def far(run: Any, train: Any, first: int) -> bool:
    """Whether a run of (time,) has diverged: not finite, or `FAR` beyond `train`."""
    import numpy as np

    low, high = min(map(np.min, train)), max(map(np.max, train))
    reach = FAR * (high - low)
    within = (run[first:] >= low - reach) & (run[first:] <= high + reach)
    return not bool(within.all())


def free_runs(network: Any, open_set: OpenSet) -> dict[str, Any]:
    """Free runs of a network on the test records, by part."""
    from jaxnarx import simulate

    found = {}
    for name, part in open_set.parts.items():
        begun = started(network, part)
        found[name] = simulate(begun, held_back(begun, part)).value
    return found


def started(network: Any, part: Part) -> Any:
    """The network with hidden states that start from the official window of measured
    samples, of which one may go to the history; any other as it is."""
    if not network.hidden:
        return network
    window = max(part.window - network.history, 1)
    return dataclasses.replace(network, window=window)


def scores(
    models: Sequence[dict[str, Any]], open_set: OpenSet, output: str
) -> list[dict[str, Row]]:
    """Errors of one output by part, for the `free_runs` of every model.

    Within a part all are scored over the same samples.
    """
    found = {
        name: part_scores([runs[name] for runs in models], part, output, open_set.scale)
        for name, part in open_set.parts.items()
    }
    return [{part: rows[n] for part, rows in found.items()} for n in range(len(models))]


def part_scores(
    runs: Sequence[Any], part: Part, output: str, scale: float = 1.0
) -> list[Row]:
    """Errors of one output of a part for every run, all over the same samples.

    These are the samples due that every run predicts. `late` counts those due that a
    run does not predict, for want of history; more than `LATE` of them, and the run has
    no figure and takes no sample from the others. `diverged` counts records.
    """
    import numpy as np

    at = part.data.channels.output_names.index(output)
    due = np.concatenate([_due(r, at, part.first) for r in part.data])
    y = np.concatenate([target[:, at] for target in part.targets])
    places = [run.output_names.index(output) for run in runs]
    masks = [
        due & np.concatenate([scored[:, o] for scored in run.scored])
        for run, o in zip(runs, places, strict=True)
    ]
    late = [int(due.sum() - mask.sum()) for mask in masks]
    in_time = [count <= LATE * due.sum() for count in late]
    shared = due & np.all([m for m, ok in zip(masks, in_time, strict=True) if ok], 0)
    rows = []
    for run, o, count, ok in zip(runs, places, late, in_time, strict=True):
        values = np.concatenate([outputs[:, o] for outputs in run.outputs])
        row = errors([y], [values], [shared & ok], scale)
        row["diverged"] = sum(bool(diverged[o]) for diverged in run.diverged)
        row["limited"] = sum(int(limited[:, o].sum()) for limited in run.limited)
        rows.append(row | {"late": count})
    return rows


def _due(record: Any, output: int, first: int) -> Any:
    """Samples of a record that are to be scored."""
    due = record.valid[:, record.u.shape[1] + output].copy()
    due[:first] = False
    return due


def held_back(network: Any, part: Part) -> Any:
    """The test records with measured outputs only where a run may begin with them.

    `simulate` begins as soon as it can. Here it is to begin with the last measurements
    before the first scored sample: earlier ones are marked as missing.
    """
    from jaxnarx.models import depth

    keep = part.first - max(depth(network), network.hidden and network.before)
    if keep <= 0:
        return part.data
    records = []
    for record in part.data:
        valid = record.valid.copy()
        valid[:keep, record.u.shape[1] :] = False
        records.append(dataclasses.replace(record, valid=valid))
    return dataclasses.replace(part.data, records=tuple(records))
