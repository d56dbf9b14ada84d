"""Steady states of the outputs under constant inputs: along one input, and over two."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require_known
from jaxnarx.confidence import bands, domain, intervals
from jaxnarx.data import Channel, Dataset, Record
from jaxnarx.errors import SpecError
from jaxnarx.formatting import page
from jaxnarx.models import Network
from jaxnarx.simulation import Trajectories, match_records, simulate

SHORTEST_REST_SAMPLES, LONGEST_REST_SAMPLES, REST_SAMPLES_FACTOR = 512, 8192, 4
"""Samples of a run to rest: so many at first, and longer while something moves."""
CALM_RANGE_SHARE, STILL_RANGE_SHARE = 1e-3, 1e-9
"""Share of the output's range that may be left to go, and what counts as no motion."""
CURVE_POINTS, SURFACE_CELLS = 33, 21
"""Values of an input along an intersection, and along each side of a surface."""


@dataclasses.dataclass(frozen=True, eq=False)
class SteadyStates:
    """Outputs at rest, in physical units; NaN where a run diverges or does not settle.

    `lower` and `upper` are their band, None where the network knows none; `index` is
    that of the domain, one at its border, None for a network without one.
    """

    outputs: tuple[Channel, ...]
    inputs: Float[np.ndarray, "points inputs"]
    value: Float[np.ndarray, "points outputs"]
    settled: Bool[np.ndarray, "points outputs"]
    lower: Float[np.ndarray, "points outputs"] | None
    upper: Float[np.ndarray, "points outputs"] | None
    index: Float[np.ndarray, " points"] | None


@dataclasses.dataclass(frozen=True, eq=False)
class Intersection:
    """One output at rest over one input, the others held at the point `at`.

    `x` runs over the trained range of `over`; `here` is the place of the operating
    point on it. Bands and index as in `SteadyStates`.
    """

    output: Channel
    over: Channel
    at: Mapping[str, float]
    here: tuple[float, float]
    x: Float[np.ndarray, " points"]
    y: Float[np.ndarray, " points"]
    lower: Float[np.ndarray, " points"] | None
    upper: Float[np.ndarray, " points"] | None
    index: Float[np.ndarray, " points"] | None

    def __str__(self) -> str:
        x, y = self.here
        held = [f"{n} = {v:.4g}" for n, v in self.at.items() if n != self.over.name]
        known = self.y[np.isfinite(self.y)]
        ends = (known.min(), known.max()) if len(known) else (np.nan, np.nan)
        return (
            f"{self.output.label} over {self.over.label}: {y:.4g} at {x:.4g}, from "
            f"{ends[0]:.4g} to {ends[1]:.4g}; held {', '.join(held) or 'nothing'}"
        )

    _repr_html_ = page


@dataclasses.dataclass(frozen=True, eq=False)
class ResponseSurface:
    """One output at rest over two inputs, the others held at the point `at`."""

    output: Channel
    over: tuple[Channel, Channel]
    at: Mapping[str, float]
    x: Float[np.ndarray, " first"]
    y: Float[np.ndarray, " second"]
    value: Float[np.ndarray, "first second"]
    index: Float[np.ndarray, "first second"] | None


@guard_arguments
def steady_states(
    network: Network,
    inputs: Float[np.ndarray, "points inputs"],
    start: Float[np.ndarray, " outputs"],
    *,
    level: float | int = 0.9,
    uncertainty: Any = None,
    longest: int = LONGEST_REST_SAMPLES,
) -> SteadyStates:
    """Find where the free run comes to rest when the inputs are constant.

    Every point is a run of its own that begins at the outputs `start` and goes on until
    the output has settled: less than 1/1000 of its trained range is left to go. The
    result is the model's behaviour, not the engine's; of several possible states of
    rest it is the one reached from `start`.

    Args:
        network: The model.
        inputs: Rows in the order of its input channels, physical units.
        start: All output channels where a run begins.
        level: Probability of the band.
        uncertainty: Uncertainty of the network's parameters; the band then says how
            sure the model is of its own rest (`jnx.bands`). Without, a network that
            knows its errors says where measurements will lie (`jnx.intervals`).
        longest: Samples of the longest run; an output that moves at its end has not
            settled.

    Returns:
        Outputs by point, with bands and the index of the domain where there are such.
    """
    inputs = np.atleast_2d(np.asarray(inputs, float))
    if inputs.shape[1] != len(network.channels.inputs):
        raise SpecError(
            f"inputs has {inputs.shape[1]} columns, the network "
            f"{len(network.channels.inputs)} inputs",
            field="inputs",
        )
    points, outputs = len(inputs), len(network.modelled)
    value = np.full((points, outputs), np.nan)
    settled = np.zeros((points, outputs), bool)
    lower, upper, index = None, None, None
    samples, pending = max(SHORTEST_REST_SAMPLES, 2 * network.before), np.arange(points)
    while len(pending):
        data = _constant(network, inputs[pending], start, samples)
        run = simulate(network, data).value
        value[pending], settled[pending] = _rest(network, run)
        band = _band(network, data, run, level, uncertainty)
        pairs = zip((lower, upper), band, strict=True)
        lower, upper = (_update_points(a, pending, b) for a, b in pairs)
        index = _update_points(index, pending, _index(network, data))
        if samples * REST_SAMPLES_FACTOR > longest:
            break
        lost = np.stack(run.diverged).any(axis=1)
        pending = pending[~settled[pending].all(axis=1) & ~lost]
        samples *= REST_SAMPLES_FACTOR
    value = np.where(settled, value, np.nan)
    channels = network.output_channels
    return SteadyStates(channels, inputs, value, settled, lower, upper, index)


def _update_points(
    old: np.ndarray | None, at: np.ndarray, new: np.ndarray | None
) -> np.ndarray | None:
    """`old` with `new` at some points; the first round has all of them."""
    if old is None or new is None:
        return new
    old[at] = new
    return old


def _index(network: Network, data: Dataset) -> Float[np.ndarray, " points"] | None:
    """The domain index at the last sample of every run."""
    if network.domain is None:
        return None
    return np.array([one[-1] for one in domain(network, data).value.index])


@guard_arguments
def intersections(
    network: Network,
    data: Dataset,
    *,
    at: Mapping[str, float] | None = None,
    over: Sequence[str] | None = None,
    points: int = CURVE_POINTS,
    level: float | int = 0.9,
    uncertainty: Any = None,
) -> tuple[Intersection, ...]:
    """Steady states of every output over one input at a time, through an operating
    point.

    Args:
        network: The model.
        data: Records; the operating point is their sample nearest to the median of all
            inputs, where a run begins too.
        at: Inputs of the operating point that are to be others, by name.
        over: Names of the inputs (default: all).
        points: Values along each input, over its trained range.
        level: Probability of the band.
        uncertainty: Uncertainty as in `steady_states`.

    Returns:
        One intersection for every output and input, output by output.

    Example:
        for cut in jnx.evaluation.intersections(network, data, points=5):
            print(cut)
    """
    point, start = operating_point(network, data, at)
    names = network.channels.input_names
    chosen = [_input(network, name) for name in (names if over is None else over)]
    if points < 2:
        raise SpecError(f"points must be at least 2, got {points}", field="points")
    rows, grids = [point[None]], []
    for i in chosen:
        grids.append(_grid(network, i, points))
        row = np.tile(point, (points, 1))
        row[:, i] = grids[-1]
        rows.append(row)
    found = steady_states(
        network, np.concatenate(rows), start, level=level, uncertainty=uncertainty
    )
    told = dict(zip(names, point.tolist(), strict=True))

    def part(array: np.ndarray | None, k: int, o: int) -> np.ndarray | None:
        own = slice(1 + k * points, 1 + (k + 1) * points)
        if array is None:
            return None
        return array[own] if array.ndim == 1 else array[own, o]

    cuts = []
    for o, output in enumerate(network.output_channels):
        for k, i in enumerate(chosen):
            cuts.append(
                Intersection(
                    output,
                    network.channels.inputs[i],
                    told,
                    (float(point[i]), float(found.value[0, o])),
                    grids[k],
                    found.value[1 + k * points : 1 + (k + 1) * points, o],
                    *(part(a, k, o) for a in (found.lower, found.upper, found.index)),
                )
            )
    return tuple(cuts)


@guard_arguments
def response_surface(
    network: Network,
    data: Dataset,
    over: Sequence[str],
    *,
    output: str | None = None,
    at: Mapping[str, float] | None = None,
    cells: int = SURFACE_CELLS,
) -> ResponseSurface:
    """One output at rest over two inputs, the others at an operating point.

    Args:
        network: The model.
        data: Records, as for `intersections`.
        over: Names of two inputs.
        output: Its name (default: the first).
        at: Inputs of the operating point that are to be others, by name.
        cells: Values along each of the two.

    Returns:
        `value` by the values `x` and `y` of the two inputs.

    Example:
        found = jnx.evaluation.response_surface(network, data, ("a", "b"), cells=3)
        print(found.value.shape)
    """
    if len(over) != 2 or over[0] == over[1]:
        raise SpecError(f"over must name two inputs, got {list(over)}", field="over")
    names = network.output_names
    name = names[0] if output is None else output
    require_known(name, names, "output", f"no model of output {name!r}")
    i, j = (_input(network, one) for one in over)
    point, start = operating_point(network, data, at)
    x, y = _grid(network, i, cells), _grid(network, j, cells)
    rows = np.tile(point, (cells * cells, 1))
    rows[:, i], rows[:, j] = np.repeat(x, cells), np.tile(y, cells)
    found = steady_states(network, rows, start)
    inputs, shape = network.channels.inputs, (cells, cells)
    return ResponseSurface(
        network.output_channels[names.index(name)],
        (inputs[i], inputs[j]),
        dict(zip(network.channels.input_names, point.tolist(), strict=True)),
        x,
        y,
        found.value[:, names.index(name)].reshape(shape),
        None if found.index is None else found.index.reshape(shape),
    )


def operating_point(
    network: Network, data: Dataset, at: Mapping[str, float] | None = None
) -> tuple[Float[np.ndarray, " inputs"], Float[np.ndarray, " outputs"]]:
    """Inputs and outputs of the measured sample nearest to the median of the inputs.

    Inputs that `at` names are those instead, and the nearest sample is sought there.
    Distances are in shares of the trained ranges.
    """
    data = match_records(network, data)
    rows = np.concatenate([r.signals[r.valid.all(axis=1)] for r in data])
    if not len(rows):
        raise SpecError("no sample of the data is complete", field="data")
    inputs = len(network.channels.inputs)
    wanted = np.median(rows[:, :inputs], axis=0)
    for name, value in (at or {}).items():
        wanted[_input(network, name, "at")] = float(value)
    wide = (np.asarray(network.high) - np.asarray(network.low)).astype(float)[:inputs]
    wide = np.where(wide > 0, wide, 1.0)
    apart = (rows[:, :inputs] - wanted[None]) / wide[None]
    near = rows[np.argmin(np.sum(apart**2, axis=1))]
    point = near[:inputs].copy()
    for name in at or {}:
        place = _input(network, name, "at")
        point[place] = wanted[place]
    return point, near[inputs:]


def _input(network: Network, name: str, field: str = "over") -> int:
    names = network.channels.input_names
    require_known(name, names, field, f"{name!r} is no input of the network")
    return names.index(name)


def _grid(network: Network, i: int, points: int) -> Float[np.ndarray, " points"]:
    return np.linspace(float(network.low[i]), float(network.high[i]), points)


def _constant(
    network: Network,
    inputs: Float[np.ndarray, "points inputs"],
    start: Float[np.ndarray, " outputs"],
    samples: int,
) -> Dataset:
    """A record of every point, in the network's precision."""
    kind = network.gain.dtype
    inputs = np.asarray(inputs, kind)
    y = np.tile(np.asarray(start, kind), (samples, 1))
    valid = np.ones((samples, inputs.shape[1] + y.shape[1]), bool)
    records = tuple(
        Record(np.tile(row, (samples, 1)), y, valid, f"point {n + 1}")
        for n, row in enumerate(inputs)
    )
    return Dataset(records, network.channels.measured, float(network.sample_time))


def _rest(
    network: Network, run: Trajectories
) -> tuple[Float[np.ndarray, "points outputs"], Bool[np.ndarray, "points outputs"]]:
    """The last value of every run, and whether it has settled there.

    The remaining distance follows from the last two tenths of the run, as for a
    geometric series: a slow approach moves little and has far to go.
    """
    span = np.asarray(network.high - network.low, float)[np.array(network.signals)]
    span = span[: len(network.modelled)]
    y = np.stack(run.outputs)
    tenth = y.shape[1] // 10
    before, moved = np.ptp(y[:, -2 * tenth : -tenth], 1), np.ptp(y[:, -tenth:], 1)
    size = np.where(span > 0, span, 1.0)[None]
    ratio = moved / np.where(before > 0, before, np.inf)
    left = moved * ratio / np.where(ratio < 1, 1 - ratio, np.nan)
    calm = (left <= CALM_RANGE_SHARE * size) | (moved <= STILL_RANGE_SHARE * size)
    return y[:, -1], calm & ~np.stack(run.diverged) & np.isfinite(moved)


def _band(
    network: Network,
    data: Dataset,
    run: Trajectories,
    level: float | int,
    uncertainty: Any,
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Lower and upper end at the last sample of every run."""
    if uncertainty is not None:
        found = bands(network, uncertainty, data, level=level).value
    elif network.errors is not None and network.domain is not None:
        found = intervals(network, data, level=level, run=run).value
    else:
        return None, None
    lower = np.array([one[-1] for one in found.lower])
    return lower, np.array([one[-1] for one in found.upper])
