"""A network's partition as plain values, in the units of its scheduling variables."""

from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.arrays.windows import usable
from jaxnarx.data import Dataset
from jaxnarx.data.batch import stack
from jaxnarx.regressors import Variables, row_columns

POINTS = 2000
"""Data points kept to show where measurements lie."""


def describe_partition(
    network: Any, *, start: Any | None = None, data: Dataset | None = None
) -> dict[str, dict[str, Any]]:
    """By output: scheduling names, their training ranges, centres and widths.

    `start` is the network before refinement, shown as `before`; up to 2000 points of
    `data`, evenly spaced, become the `cloud` that shows where measurements lie. Outputs
    with a single local model, or whose validity has no centres and widths, are left
    out. The form is the one `Report.partition` takes.
    """
    after, before = _regions(network), _regions(start) if start is not None else {}
    out = {}
    for name, model in zip(network.output_names, network.models, strict=True):
        regions = after.get(name, [])
        if len(regions) < 2 or not all(regions):
            continue
        low = np.asarray(model.offset, float)
        high = low + np.asarray(model.span, float)
        out[name] = {
            "scheduling": list(regions[0]),
            "ranges": [(float(a), float(b)) for a, b in zip(low, high, strict=True)],
            "before": [_model(r) for r in before.get(name, []) if r],
            "after": [_model(r) for r in regions],
        }
        if data is not None:
            out[name]["cloud"] = _cloud(data, model.scheduling)
    return out


def _cloud(data: Dataset, scheduling: Variables) -> Float[np.ndarray, "samples dims"]:
    """Measured scheduling variables, evenly thinned; rows that lack one left out."""
    batch = stack(data)
    good = usable(batch.valid, scheduling.rows, scheduling.longest)
    lengths = np.array([len(r) for r in data])
    good &= np.arange(good.shape[1])[None] < lengths[:, None]
    at = np.flatnonzero(good)
    step = max(1, -(-len(at) // POINTS))
    return row_columns(batch, at[::step], scheduling, data.sample_time).T.astype(float)


def _regions(network: Any) -> dict[str, list[dict[str, Any]]]:
    out: dict[str, list[dict[str, Any]]] = {}
    for entry in network.equations(style="text"):
        out.setdefault(entry["output"], []).append(entry["region"])
    return out


def _model(region: dict[str, Any]) -> dict[str, list[float]]:
    return {key: [v[key] for v in region.values()] for key in ("centre", "width")}
