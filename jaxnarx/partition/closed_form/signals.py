"""Columns' factors and targets, shared by all structures over the same variables."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.data import Dataset, gains, stack_records
from jaxnarx.models import assemble, global_model, ranges
from jaxnarx.regressors import Centring, Pool, Variables
from jaxnarx.simulation import make_drive, make_masks

ROOT_ROOM = 0.1
"""Room between the least output and the floor of its root, in standard deviations: a
root is infinitely steep at its floor."""


@dataclasses.dataclass(frozen=True, eq=False)
class Stretch:
    """One record from the first sample of a free run on; or operating points at rest,
    each sample one of them (`at_rest`)."""

    z: Float[np.ndarray, "vars time"]
    """A leading one and the centred variables of unit spread."""
    x: Float[np.ndarray, "dims time"]
    """Scheduling variables, 0 to 1 over the range of the records."""
    y: Float[np.ndarray, " time"]
    """Output, centred, in standard deviations."""
    before: Float[np.ndarray, " history"]
    """Outputs before the first sample, latest first."""
    counted: tuple[Int[np.ndarray, " _"], ...]
    """Samples that count, part by part: groups, gaps between them, operating points."""
    first: int
    """Place of the first sample among those of all records."""
    at_rest: bool = False

    def filter_columns(
        self, columns: Float[np.ndarray, "columns time"], a: Float[np.ndarray, " _"]
    ) -> Float[np.ndarray, "columns time"]:
        """Columns through 1/A from rest, or at rest."""
        if len(a) == 1:
            return columns
        if self.at_rest:
            return columns / a.sum()
        from scipy.signal import lfilter  # it loads half of scipy

        return np.asarray(lfilter([1.0], a, columns))

    def start_response(self, a: Float[np.ndarray, " _"]) -> Float[np.ndarray, " time"]:
        """Free run on nothing but the measured start."""
        rest = np.zeros(len(self.y))
        if len(a) == 1 or self.at_rest:
            return rest
        from scipy.signal import lfilter, lfiltic

        state = lfiltic([1.0], a, self.before[: len(a) - 1])
        return lfilter([1.0], a, rest, zi=state)[0]

    def lags(
        self, run: Float[np.ndarray, " time"], order: int
    ) -> Float[np.ndarray, "order time"]:
        """A run of the output one sample ago, two ago and so on."""
        if self.at_rest:
            return np.tile(run, (order, 1))
        past = np.concatenate([self.before[:order][::-1], run])
        rows = [past[order - i : order - i + len(run)] for i in range(1, order + 1)]
        return np.array(rows).reshape(order, len(run))


@dataclasses.dataclass(frozen=True)
class OutputRoot:
    """The signed root of an output above a floor is modelled in its place.

    y = floor + r |r|: what is far above all else weighs less in least squares of r.
    """

    floor: float
    """Scaled by the output's gain, as are ..."""
    middle: float
    """... the mean of the output itself ..."""
    spread: float
    """... and its standard deviation."""


@dataclasses.dataclass(frozen=True, eq=False)
class RunSignals:
    """All records of one output, with the scales of what they hold."""

    pool: Pool
    centring: Centring
    gain: Float[np.ndarray, " signals"]
    sample_time: float
    middle: float
    """Mean of the output, scaled by its gain ..."""
    spread: float
    """... and its standard deviation."""
    scheduling: Variables
    offset: Float[np.ndarray, " dims"]
    span: Float[np.ndarray, " dims"]
    stretches: tuple[Stretch, ...]
    apart: Bool[np.ndarray, "groups parts"]
    """Parts that are held out with a group: the group itself, and the gaps beside
    it."""
    root: OutputRoot | None = None
    """Where a root of the output is modelled, whose are y, `middle` and `spread`."""
    largest_pole: float = np.inf
    """Modulus that poles of the feedback have at most."""

    @property
    def has_rest(self) -> bool:
        """Whether the last parts, one for every group, are operating points at rest."""
        return bool(self.stretches) and self.stretches[-1].at_rest

    def rest_part(self, group: int) -> int | None:
        """The part of the operating points that are held out with a group."""
        groups, parts = self.apart.shape
        return parts - groups + group if self.has_rest else None

    def to_output(self, run: Float[np.ndarray, "*rows"]) -> Float[np.ndarray, "*rows"]:
        """Standard deviations of the output from values of what is modelled."""
        if self.root is None:
            return run
        value = self.middle + self.spread * run
        y = self.root.floor + value * np.abs(value)
        return (y - self.root.middle) / self.root.spread

    def from_output(self, y: Float[np.ndarray, "*rows"]) -> Float[np.ndarray, "*rows"]:
        """Values of what is modelled, in its standard deviations, from those of the
        output over its gain."""
        if self.root is not None:
            above = y - self.root.floor
            y = np.sign(above) * np.sqrt(np.abs(above))
        return (y - self.middle) / self.spread

    @property
    def output_spread(self) -> float:
        """Standard deviation of the output, in its unit."""
        spread = self.spread if self.root is None else self.root.spread
        return spread * self.output_gain

    @property
    def output_gain(self) -> float:
        """The gain of the output."""
        return float(self.gain[len(self.pool.channels.inputs) + self.pool.outputs[0]])

    @property
    def factor(self) -> Int[np.ndarray, "terms degree"]:
        """Terms without feedback."""
        return self.pool.factor


def make_signals(
    data: Dataset,
    pool: Pool,
    scheduling: Variables,
    labels: Sequence[Int[np.ndarray, " _"]],
    apart: Bool[np.ndarray, "groups parts"],
    *,
    history: int,
    every: int,
    begin: int = 0,
    root: bool = False,
    least: float = np.inf,
    largest_pole: float = np.inf,
) -> RunSignals:
    """Columns' factors and targets of every record, each computed once.

    `pool` has one output and terms of inputs alone. `labels` and `apart` are
    `Groups.parts`. Runs start behind `history` samples at least; of every so many
    samples of a record one counts, but none of the first `begin`. With `root` a root of
    the output is modelled, above its `least` value elsewhere too. `largest_pole` is the
    modulus that poles of the feedback have at most.
    """
    table = Variables.of(
        [
            *pool.variables.entries,
            (len(data.channels.inputs) + pool.outputs[0], history, None),
        ]
    )
    low, high = ranges(data)
    gain = gains(data)
    offset, span = low[scheduling.signal], (high - low)[scheduling.signal]
    span = np.where(span > 0, span, 1.0)
    empty = global_model(pool.factor[:1], np.zeros(1))
    empty = dataclasses.replace(empty, scheduling=scheduling)
    larger = Pool(table, pool.factor, pool.channels, pool.outputs)
    network = assemble(larger, data, gain, [empty])
    batch = stack_records(data)
    drive, masks = make_drive(network, batch), make_masks(network, batch)
    v, x = np.asarray(drive.v)[:, :-1], np.asarray(drive.x[0])
    y, scored = np.asarray(drive.measured)[..., 0], masks.scored[..., 0]
    rows = v.transpose(1, 0, 2)[:, scored]
    shift, size = rows.mean(axis=1), rows.std(axis=1)
    size = np.where(size > 1e-9 * np.maximum(np.abs(shift), 1e-300), size, 1.0)
    shift[0], size[0] = 0.0, 1.0
    middle, spread = float(y[scored].mean()), float(y[scored].std()) or 1.0
    original = None
    if root:
        low = float(y[scored].min())
        floor = min(low, least / float(gain[table.signal[-1]])) - ROOT_ROOM * spread
        original = OutputRoot(floor, middle, spread)
        y = np.sign(y - floor) * np.sqrt(np.abs(y - floor))
        middle, spread = float(y[scored].mean()), float(y[scored].std()) or 1.0
    centring = Centring(shift, size, np.array([middle]))
    stretches, before = [], np.cumsum([0, *map(len, data)]).tolist()
    for n, record in enumerate(data):
        s, e = int(masks.start[n]), int(masks.end[n])
        if s >= e:
            continue
        label = np.full(e, -1)
        label[: len(record)] = labels[n][:e]
        seen = scored[n, s:e]
        seen[np.arange(s, e) % every != 0] = False
        seen[np.arange(s, e) < begin] = False
        counted = [
            np.flatnonzero(seen & (label[s:] == g)) for g in range(apart.shape[1])
        ]
        stretches.append(
            Stretch(
                (v[n, :, s:e] - shift[:, None]) / size[:, None],
                (x[n, :, s:e] - offset[:, None]) / span[:, None],
                (y[n, s:e] - middle) / spread,
                (y[n, s - history : s][::-1] - middle) / spread,
                tuple(counted),
                before[n] + s,
            )
        )
    return RunSignals(
        pool,
        centring,
        gain,
        data.sample_time,
        middle,
        spread,
        scheduling,
        offset,
        span,
        tuple(stretches),
        apart,
        original,
        largest_pole,
    )
