"""Variables and rows of the closed form at rest: inputs held until all has settled.

A lag is then its input, a filter its static gain, and a free run has

    A(1) y(u) = sum_(b,k) theta[b, k] w_b(x(u)) p_k(z(u)) .

A measured operating point is one row more of the same least squares, with columns
divided by A(1): it tells of the statics what would otherwise take a record as long as
the memory.
"""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.data import Dataset
from jaxnarx.partition.closed_form.signals import RunSignals, Stretch
from jaxnarx.regressors import static_gains

MOST_WEIGHT = 0.25
"""Samples that all operating points count as, over those that count of the records, at
most; each counts as one at least."""


@dataclasses.dataclass(frozen=True, eq=False)
class RestPoints:
    """Operating points at rest, physical units."""

    inputs: Float[np.ndarray, "points inputs"]
    output: Float[np.ndarray, " points"]

    @property
    def least(self) -> float:
        """The least output."""
        return float(self.output.min())


def rest_points(data: Dataset, output: str) -> RestPoints | None:
    """Every sample is a point, where the output and all inputs are valid; None where
    none is."""
    inputs = len(data.channels.inputs)
    used = [*range(inputs), inputs + data.channels.output_names.index(output)]
    seen = [r.valid[:, used].all(axis=1) for r in data]
    u = [r.u[at].astype(float) for r, at in zip(data, seen, strict=True)]
    y = [r.y[at, used[-1] - inputs] for r, at in zip(data, seen, strict=True)]
    if not sum(map(len, y)):
        return None
    return RestPoints(np.concatenate(u), np.concatenate(y).astype(float))


def rest_variables(
    signals: RunSignals, inputs: Float[np.ndarray, "points inputs"]
) -> tuple[Float[np.ndarray, "vars points"], Float[np.ndarray, "dims points"]]:
    """Variables z and scheduling variables x of `Stretch`, under held inputs."""
    table, time = signals.pool.variables, signals.sample_time
    gain = static_gains([f for _, _, f in table.entries], time)
    v = (inputs[:, table.signal] / signals.gain[table.signal] * gain).T
    v = np.concatenate([np.ones((1, len(inputs))), v])
    z = (v - signals.centring.shift[:, None]) / signals.centring.spread[:, None]
    gain = static_gains([f for _, _, f in signals.scheduling.entries], time)
    x = inputs[:, signals.scheduling.signal] * gain
    return z, ((x - signals.offset) / signals.span).T


def add_rest(signals: RunSignals, points: RestPoints, memory: int) -> RunSignals:
    """The signals with operating points beside the records: a part for every group,
    which is held out with it (`RunSignals.rest_part`).

    Each counts as many samples as the memory has, as a settled record would, all of
    them `MOST_WEIGHT` of what counts in the records at most.
    """
    z, x = rest_variables(signals, points.inputs)
    y = signals.from_output(points.output / signals.output_gain)
    samples = sum(len(one.y) for one in signals.stretches)
    counted = sum(len(at) for one in signals.stretches for at in one.counted)
    most = MOST_WEIGHT * counted / len(y)
    times = max(1, int(min(memory * counted / max(samples, 1), most)))
    groups, nothing = len(signals.apart), np.zeros(0, int)
    turn = np.tile(_deal(points, groups), times)
    parts = [nothing] * signals.apart.shape[1]
    parts += [np.flatnonzero(turn == g) for g in range(groups)]
    z, x, y = (np.tile(a, times) for a in (z, x, y))
    rest = Stretch(z, x, y, np.zeros(0), tuple(parts), 0, True)
    moving = [
        dataclasses.replace(one, counted=(*one.counted, *(nothing,) * groups))
        for one in signals.stretches
    ]
    own = np.eye(groups, dtype=bool)
    return dataclasses.replace(
        signals,
        stretches=(*moving, rest),
        apart=np.concatenate([signals.apart, own], axis=1),
    )


def _deal(points: RestPoints, groups: int) -> Int[np.ndarray, " points"]:
    """The group of every point, by chance: in turns a group could hold a whole row of a
    map. Whatever the order of the points, each has the same group."""
    turn = np.empty(len(points.output), int)
    order = np.lexsort((points.output, *points.inputs.T))
    turn[order] = np.random.default_rng(0).permutation(len(turn)) % groups
    return turn
