"""Errors of free runs on the scored samples, output by output.

`errors` needs nothing but numpy, so that peers are scored by the same lines; `scores`
runs a network through `jaxnarx.simulate`.
"""

import dataclasses
import math
from typing import Any

from sets import OpenSet, Part

FAR = 10.0
"""A run that leaves the training range by more than so many widths has diverged."""

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


def scores(network: Any, open_set: OpenSet) -> dict[str, dict[str, Row]]:
    """Errors by part and output of a network's free runs on the test records."""
    return {
        name: part_scores(network, part, open_set.scale)
        for name, part in open_set.parts.items()
    }


def part_scores(network: Any, part: Part, scale: float = 1.0) -> dict[str, Row]:
    """Errors of one part by output.

    `diverged` counts records. `late` counts samples that should be scored and that the
    network, for want of history, does not predict. Without them the error would
    flatter: only where there are none are figures given.
    """
    from jaxnarx import simulate

    run = simulate(network, held_back(network, part)).value
    names = part.data.channels.output_names
    found = {}
    for o, name in enumerate(run.output_names):
        at = names.index(name)
        due = [_due(r, at, part.first) for r in part.data]
        there = [s[:, o] for s in run.scored]
        late = sum(int((d & ~s).sum()) for d, s in zip(due, there, strict=True))
        row = errors(
            [y[:, at] for y in part.targets], [y[:, o] for y in run.outputs], due, scale
        )
        if late:
            row |= {"rmse": None, "nrmse": None}
        diverged = sum(bool(d[o]) for d in run.diverged)
        limited = sum(int(held[:, o].sum()) for held in run.limited)
        found[name] = row | {"diverged": diverged, "limited": limited, "late": late}
    return found


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

    keep = part.first - depth(network)
    if keep <= 0:
        return part.data
    records = []
    for record in part.data:
        valid = record.valid.copy()
        valid[:keep, record.u.shape[1] :] = False
        records.append(dataclasses.replace(record, valid=valid))
    return dataclasses.replace(part.data, records=tuple(records))
