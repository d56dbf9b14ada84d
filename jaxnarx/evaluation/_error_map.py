"""Error map of the free run: its error over two variables."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import usable
from jaxnarx.checks import require_known
from jaxnarx.data import Dataset, scaling_unit
from jaxnarx.errors import SpecError
from jaxnarx.evaluation.rows import ScoredSamples, collect
from jaxnarx.formatting import page
from jaxnarx.metrics import pooled_rms
from jaxnarx.models import Network
from jaxnarx.regressors import Variables, parse_variable, row_columns, variable_names
from jaxnarx.simulation import Prepared, ensure_prepared, simulate, stack_batch

MAP_CELLS = 12
"""Cells along each variable."""
THIN_CELL = 20
"""Samples of a cell below which its error says little."""


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorMap:
    """Free-run error of one output in cells over two variables, physical units.

    `rms` is the root mean square of measured minus simulated, `bias` its mean and
    `spread` its standard deviation, NaN in empty cells; `edges` the borders of the
    cells along each of `variables`. `places` are the record and the sample at which a
    cell's error is largest, -1 in empty cells. Records that diverged are left out.
    """

    output: str
    unit: str
    variables: tuple[str, str]
    edges: tuple[Float[np.ndarray, " first"], Float[np.ndarray, " second"]]
    bias: Float[np.ndarray, "x y"]
    spread: Float[np.ndarray, "x y"]
    samples: Int[np.ndarray, "x y"]
    places: Int[np.ndarray, "x y 2"]

    @property
    def rms(self) -> Float[np.ndarray, "x y"]:
        """Root mean square."""
        return np.hypot(self.bias, self.spread)

    @property
    def thin(self) -> Bool[np.ndarray, "x y"]:
        """Cells with fewer than 20 samples, or none."""
        return self.samples < THIN_CELL

    @property
    def worst(self) -> tuple[int, int] | None:
        """The cell with the largest error that enough samples tell; None without."""
        if self.thin.all():
            return None
        error = np.where(self.thin, -np.inf, np.nan_to_num(self.rms, nan=-np.inf))
        i, j = np.unravel_index(int(np.argmax(error)), error.shape)
        return int(i), int(j)

    @property
    def usual(self) -> float:
        """Root mean square over all cells."""
        seen = self.samples > 0
        return pooled_rms(self.rms[seen], self.samples[seen])

    def __str__(self) -> str:
        """Tell where the error is largest."""
        if self.worst is None:
            return ""
        i, j = self.worst
        (a, b), unit = (
            self.edges,
            "" if self.unit in ("", "-", "1") else f" {self.unit}",
        )
        times = f", {self.rms[i, j] / self.usual:.2g} times the usual"
        return (
            f"{self.output} errs most at {self.variables[0]} {a[i]:.4g} to "
            f"{a[i + 1]:.4g} and {self.variables[1]} {b[j]:.4g} to {b[j + 1]:.4g}: "
            f"RMSE {self.rms[i, j]:.3g}{unit}{times if self.usual > 0 else ''}"
        )

    _repr_html_ = page


@guard_arguments
def error_map(
    network: Network,
    data: Dataset | Prepared,
    *,
    over: Sequence[str] | None = None,
    output: str | None = None,
) -> ErrorMap:
    """Map the error of one output's free run over the operating range.

    Args:
        network: The model.
        data: Records with its channels, at its sample time.
        over: Two channels, or lagged variables; by default those that schedule, then
            the inputs that say most about the output.
        output: Its name (default: the first).

    Returns:
        Error, bias, spread and number of samples by cell.

    Example:
        found = jnx.evaluation.error_map(network, data, over=("a", "b"))
        print(found.rms.shape, int(found.samples.sum()))
    """
    runs, origin = ensure_prepared(network, data)
    name = network.output_names[0] if output is None else output
    require_known(name, network.output_names, "output", f"no model of output {name!r}")
    samples = collect(
        origin.matched,
        network.output_channels,
        simulate(network, runs).value,
    )
    found = error_maps(network, runs, samples, over)
    for one in found:
        if one.output == name:
            return one
    raise SpecError(
        f"too few samples of {name} are scored, or variables vary, for a map",
        field="data",
    )


def error_maps(
    network: Any,
    data: Dataset | Prepared,
    free: list[list[ScoredSamples]],
    over: Sequence[str] | None = None,
) -> tuple[ErrorMap, ...]:
    """A map per output, over its first two scheduling variables.

    Where it has fewer, the inputs that say most about the output fill up: those whose
    bins explain most of its variance. `over` names two channels, or lagged variables,
    instead.
    """
    if not isinstance(network, Network):
        return ()
    chosen = None if over is None else _parse_axes(network, over)
    _, batch = stack_batch(network, data)
    length = batch.valid.shape[1]
    maps = []
    for o, samples in enumerate(free):
        calm = [(n, one) for n, one in enumerate(samples) if not one.diverged]
        table = _candidates(network, o) if chosen is None else chosen
        known = usable(batch.valid, table.rows, table.longest).reshape(-1)
        at = [n * length + np.flatnonzero(one.scored[:, 0]) for n, one in calm]
        at = np.concatenate(at) if at else np.zeros(0, int)
        good = known[at]
        if good.sum() < 2 * MAP_CELLS:
            continue
        y = np.concatenate([one.measured[one.scored] for _, one in calm])[good]
        simulated = np.concatenate([one.predicted[one.scored] for _, one in calm])[good]
        x = row_columns(batch, at[good], table, float(network.sample_time))
        x = x.astype(float)
        names = variable_names(network.channels, table)
        order = range(2) if chosen else _most_telling(network, o, x, y)
        varied = [int(i) for i in order if np.ptp(x[i]) > 0][:2]
        if len(varied) == 2:
            channel = network.output_channels[o]
            first, second = varied
            maps.append(
                _map(
                    *(channel.name, channel.unit, (names[first], names[second])),
                    *(x[first], x[second], y - simulated),
                    np.stack(np.divmod(at[good], length), axis=1),
                )
            )
    return tuple(maps)


def _parse_axes(network: Network, over: Sequence[str]) -> Variables:
    """Two channels without delay, or lagged variables."""
    channels = network.channels
    if len(over) != 2 or over[0] == over[1]:
        raise SpecError(
            "over must name two channels, or lagged variables such as 'speed[t-1]', "
            f"got {', '.join(over) or 'none'}",
            field="over",
        )
    return Variables.of(
        [
            (channels.names.index(name), 0, None)
            if name in channels.names
            else parse_variable(channels, name if "[" in name else f"{name}[t]")
            for name in over
        ]
    )


def _most_telling(
    network: Network,
    o: int,
    x: Float[np.ndarray, "variables samples"],
    y: Float[np.ndarray, " samples"],
) -> Int[np.ndarray, " variables"]:
    """Scheduling variables in their order, then inputs by what they say of `y`."""
    given = network.models[o].scheduling
    given = len(given) if network.tells(given) else 0
    telling = [-np.inf if i < given else -_share(v, y) for i, v in enumerate(x)]
    return np.argsort(telling, kind="stable")


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
    edges = np.unique(np.quantile(value, np.linspace(0, 1, MAP_CELLS + 1)))
    if len(edges) < 2 or not np.ptp(y):
        return 0.0
    at = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)
    y = y / scaling_unit(y)
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
    place: Int[np.ndarray, "samples 2"],
) -> ErrorMap:
    samples, *edges = np.histogram2d(x, z, MAP_CELLS)
    scale = float(np.max(np.abs(error))) or 1.0
    seen = samples > 0
    count = np.where(seen, samples, np.nan)
    error = error / scale
    bias = np.histogram2d(x, z, edges, weights=error)[0] / count
    # Of deviations from the mean of the cell, not of squares: no digits are lost.
    at = [
        np.clip(np.searchsorted(e, v, side="right") - 1, 0, MAP_CELLS - 1)
        for e, v in zip(edges, (x, z), strict=True)
    ]
    apart = (error - bias[at[0], at[1]]) ** 2
    spread = np.sqrt(np.histogram2d(x, z, edges, weights=apart)[0] / count)
    places = np.full((MAP_CELLS, MAP_CELLS, 2), -1)
    order = np.argsort(np.abs(error), kind="stable")  # the largest is written last
    places[at[0][order], at[1][order]] = place[order]
    return ErrorMap(
        *(output, unit, variables, (edges[0], edges[1])),
        *(scale * bias, scale * spread, samples.astype(int), places),
    )
