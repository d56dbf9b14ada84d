"""Where in the operating range the free run errs: its error over two variables."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.data import Dataset
from jaxnarx.data.batch import stack
from jaxnarx.data.scaling import unit_of
from jaxnarx.evaluation.rows import ScoredSamples
from jaxnarx.models import Network
from jaxnarx.regressors import Variables, row_columns, variable_names
from jaxnarx.simulation import fitting

CELLS = 12
"""Cells along each variable."""


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorMap:
    """Free-run error of one output in cells over two variables, physical units.

    `rms` is the root mean square of measured minus simulated, NaN in empty cells;
    `edges` the borders of the cells along each of `variables`. Records that diverged
    are left out.
    """

    output: str
    unit: str
    variables: tuple[str, str]
    edges: tuple[Float[np.ndarray, " first"], Float[np.ndarray, " second"]]
    rms: Float[np.ndarray, "x y"]
    samples: Int[np.ndarray, "x y"]


def error_maps(
    network: Any, data: Dataset, free: list[list[ScoredSamples]]
) -> tuple[ErrorMap, ...]:
    """A map per output, over its first two scheduling variables.

    Where it has fewer, the inputs that say most about the output fill up: those whose
    bins explain most of its variance.
    """
    if not isinstance(network, Network):
        return ()
    data = fitting(network, data)
    batch = stack(data)
    length = batch.valid.shape[1]
    maps = []
    for o, samples in enumerate(free):
        at = [
            n * length + np.flatnonzero(one.scored[:, 0])
            for n, one in enumerate(samples)
            if not one.diverged
        ]
        at = np.concatenate(at) if at else np.zeros(0, int)
        calm = [one for one in samples if not one.diverged]
        if len(at) < 2 * CELLS:
            continue
        y = np.concatenate([one.measured[one.scored] for one in calm])
        error = y - np.concatenate([one.predicted[one.scored] for one in calm])
        table = _candidates(network, o)
        x = row_columns(batch, at, table, float(network.sample_time)).astype(float)
        given = network.models[o].scheduling
        given = len(given) if network.tells(given) else 0
        telling = [-np.inf if i < given else -_share(v, y) for i, v in enumerate(x)]
        order = np.argsort(telling, kind="stable")
        varied = [int(i) for i in order if np.ptp(x[i]) > 0][:2]
        if len(varied) == 2:
            names = variable_names(network.channels, table)
            channel = network.output_channels[o]
            pair = names[varied[0]], names[varied[1]]
            maps.append(
                _map(
                    channel.name, channel.unit, pair, x[varied[0]], x[varied[1]], error
                )
            )
    return tuple(maps)


def _candidates(network: Network, o: int) -> Variables:
    """Scheduling variables, then every input without delay."""
    scheduling = network.models[o].scheduling
    scheduling = scheduling.entries if network.tells(scheduling) else ()
    taken = {s for s, _, _ in scheduling}
    inputs = range(len(network.channels.inputs))
    return Variables.of(
        [*scheduling, *((s, 0, None) for s in inputs if s not in taken)]
    )


def _share(
    value: Float[np.ndarray, " samples"], y: Float[np.ndarray, " samples"]
) -> float:
    """Share of the variance of `y` that its means over bins of `value` explain."""
    edges = np.unique(np.quantile(value, np.linspace(0, 1, CELLS + 1)))
    if len(edges) < 2 or not np.ptp(y):
        return 0.0
    at = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)
    y = y / unit_of(y)
    count = np.bincount(at)
    mean = np.bincount(at, y - y.mean()) / np.maximum(count, 1)
    return float(np.sum(count * mean**2) / (len(y) * y.var()))


def _map(
    output: str,
    unit: str,
    variables: tuple[str, str],
    x: Float[np.ndarray, " samples"],
    z: Float[np.ndarray, " samples"],
    error: Float[np.ndarray, " samples"],
) -> ErrorMap:
    samples, *edges = np.histogram2d(x, z, CELLS)
    scale = float(np.max(np.abs(error))) or 1.0
    square, *_ = np.histogram2d(x, z, edges, weights=(error / scale) ** 2)
    seen = samples > 0
    mean = square / np.where(seen, samples, 1)
    rms = np.where(seen, scale * np.sqrt(mean), np.nan)
    return ErrorMap(
        output, unit, variables, (edges[0], edges[1]), rms, samples.astype(int)
    )
