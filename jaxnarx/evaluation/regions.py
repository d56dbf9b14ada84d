"""A network's partition as plain values, in the units of its scheduling variables."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import expit

from jaxnarx.arrays import usable
from jaxnarx.data import Dataset, stack_records
from jaxnarx.models import Network, OutputModel, SigmoidTree, weights_at
from jaxnarx.regressors import Variables, row_columns, variable_names

SHOWN_DATA_POINTS = 2000
"""Data points kept to show where measurements lie."""

GRID_POINTS = {1: 401, 2: 161}
"""Points a side of the grid on which weights are shown, by number of variables."""


def describe_partition(
    network: Any, *, start: Any | None = None, data: Dataset | None = None
) -> dict[str, dict[str, Any]]:
    """Describe the partition of every output for drawing, whatever its class.

    - `validity`: the name of the class of validity function;
    - `scheduling`: names of the variables; `ranges`: (low, high) of each in training;
    - `after`, and `before` where `start`, the network before refinement, is given:
      `regions`, one per local model as `Network.regions` tells them; `weights` (models,
      *grid), the network's own validity over the ranges, where there are one or two
      variables; for a tree `gates` (the variable, or combination, of each and what its
      open side lies `above` or `below`, or `{"share": {"above": 0.3}}` where that is
      a part of a sum of networks) and `path`, a row of sides per local model;
    - `cloud`: up to 2000 points of `data`, evenly spaced (samples, dims).

    Outputs with a single local model are left out, and those whose models add up; of
    those divided by hidden channels there is no cloud. It is the form
    `Report.partition` takes; weights and cloud stay out of its JSON.
    """
    if not isinstance(network, Network):
        return {}
    out = {}
    for o, (name, model) in enumerate(
        zip(network.computed_names, network.models, strict=True)
    ):
        if int(np.asarray(model.active).sum()) < 2 or not len(model.scheduling):
            continue
        if not model.validity.sums_to_one:
            continue  # gates that add up: nowhere does one model take over
        ranges = scheduling_ranges(model)
        out[name] = {
            "validity": type(model.validity).__name__,
            "scheduling": variable_names(network.channels, model.scheduling),
            "ranges": ranges,
            "after": _side(network, o, ranges),
        }
        if isinstance(start, Network) and _has_partition(start, o, model):
            out[name]["before"] = _side(start, o, ranges)
        if data is not None and network.tells(model.scheduling):
            out[name]["cloud"] = scheduling_cloud(data, model.scheduling)
    return out


def _has_partition(start: Network, o: int, model: OutputModel) -> bool:
    """Whether the earlier network divides the same space."""
    earlier = start.models[o]
    several = int(np.asarray(earlier.active).sum()) > 1
    return several and earlier.scheduling == model.scheduling


def scheduling_ranges(model: OutputModel) -> list[tuple[float, float]]:
    """(low, high) of every scheduling variable in training, physical units."""
    low = np.asarray(model.offset, float)
    high = low + np.asarray(model.span, float)
    return list(zip(low.tolist(), high.tolist(), strict=True))


def scheduling_cloud(
    data: Dataset, scheduling: Variables, *, points: int = SHOWN_DATA_POINTS
) -> Float[np.ndarray, "samples dims"]:
    """Measured scheduling variables, evenly thinned; rows that lack one left out."""
    batch = stack_records(data)
    good = usable(batch.valid, scheduling.rows, scheduling.longest)
    lengths = np.array([len(r) for r in data])
    good &= np.arange(good.shape[1])[None] < lengths[:, None]
    at = np.flatnonzero(good)
    step = max(1, -(-len(at) // points))
    return row_columns(batch, at[::step], scheduling, data.sample_time).T.astype(float)


def _side(network: Network, o: int, ranges: list[tuple[float, float]]) -> dict:
    model = network.models[o]
    active = np.asarray(model.active)
    regions = [r for r, on in zip(network.regions(o), active, strict=True) if on]
    side: dict[str, Any] = {"regions": regions}
    points = GRID_POINTS.get(len(ranges))
    if points is not None:
        axes = [np.linspace(low, high, points) for low, high in ranges]
        x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        phi = weights_at(model, x.reshape(-1, len(ranges)))
        side["weights"] = phi.reshape(-1, *x.shape[:-1])
    if isinstance(model.validity, SigmoidTree):
        side |= _tree(network, model, model.validity)
    return side


def _tree(network: Network, model: OutputModel, validity: SigmoidTree) -> dict:
    """Gates as the regions of a tree in which every leaf lies behind one gate alone; of
    one that is open to the same share everywhere, that share."""
    path = np.asarray(validity.path)[np.asarray(model.active)]
    used = np.flatnonzero(np.any(path != 0, axis=0))
    alone = jnp.asarray(np.eye(path.shape[1], dtype=path.dtype)[used])
    names = variable_names(network.channels, model.scheduling)
    gates = dataclasses.replace(validity, path=alone).regions(
        names, np.asarray(model.offset), np.asarray(model.span)
    )
    shut = np.exp(np.asarray(validity.log_steepness)) * np.asarray(validity.border)
    share = expit(-shut[used])
    gates = [
        gate or {"share": {"above": float(part)}}
        for gate, part in zip(gates, share, strict=True)
    ]
    return {"gates": gates, "path": path[:, used].tolist()}
