"""The domain of a network, learnt from its training records and those left out."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import bucket, program
from jaxnarx.checks import whole
from jaxnarx.data import Dataset, Groups, stack_records, thin_records
from jaxnarx.data import groups as make_groups
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import LAYERS, Domain, Network
from jaxnarx.regressors import LowPass, Variables, row_columns
from jaxnarx.simulation import match_records, simulate

STORED_POINTS = 40
"""Stored points of the training. On two outputs of virtual engines 10 to 200 of them
had the same rank correlation with the error to .03."""
BEYOND_SHARE = 0.05
"""Share of the samples left out that are beyond the border."""
RUN_SAMPLES = 20_000
"""Samples on which the free run is asked what it follows."""
POOL_SAMPLES = 20_000
"""Samples that points are chosen from."""
MEMORY_CUTS = (0.25, 0.5, 0.75)
"""Places in a record where inputs change back, to see how long a run remembers."""
LEAST_SPREAD_SHARE = 1e-9
"""Spread of a feature, as a share of its size, below which it has not moved."""


@dataclasses.dataclass(frozen=True, eq=False)
class InputRows:
    """Features and input steps of samples, all that a domain looks at; physical units.

    `group` is what each is left out with, -1 where it is in no group; `at_sample` its
    place among all samples, record after record.
    """

    x: Float[np.ndarray, "features time"]
    step: Float[np.ndarray, "used time"]
    group: Int[np.ndarray, " time"]
    at_sample: Int[np.ndarray, " time"]

    def select(self, some: Bool[np.ndarray, " time"]) -> "InputRows":
        """These samples alone."""
        parts = self.x[:, some], self.step[:, some], self.group[some]
        return InputRows(*parts, self.at_sample[some])


@guard_arguments
def fit_domain(
    network: Network,
    data: Dataset,
    *,
    groups: Groups | None = None,
    points: int = STORED_POINTS,
) -> Network:
    """The network with its domain: where these records, its training, have been.

    Args:
        network: The model.
        data: The records that it was trained on.
        groups: Groups of records that are held out together when the borders are set
            (`jaxnarx.data.groups`); by default those that the records state, else
            detected ones.
        points: Most stored points.

    Returns:
        The network with a `domain`, a free run unchanged. `SpecError` where the
        network looks at no input.

    Example:
        network = jnx.confidence.fit_domain(network, data)
        print(jnx.confidence.domain(network, data).value.index[0].max())
    """
    points = whole(points, "points", 1)
    data = match_records(network, data)
    used = used_inputs(network)
    if not used:
        raise SpecError("a network without inputs has no domain", field="network")
    weight, memory = measure_influence(network, thin_records(data, RUN_SAMPLES), used)
    features = Variables.of(
        [(s, 0, None) for s in used]
        + [(s, 0, LowPass(memory * data.sample_time)) for s in used]
    )
    if groups is None:
        try:
            groups = make_groups(data, gap=round(memory))
        except DataError:
            groups = None
    rows = feature_rows(features, data, groups)
    weight = np.tile(weight, 2)
    found = _make_domain(features, rows, weight, points)
    border = jax.device_put(_border(found, rows))
    domain = dataclasses.replace(found, border=border)
    kind = network.gain.dtype  # a model file holds numbers of one type
    domain = jax.tree.map(lambda x: jax.device_put(np.asarray(x, kind)), domain)
    return dataclasses.replace(network, domain=domain)


def used_inputs(network: Network) -> tuple[int, ...]:
    """The inputs that local models in use look at, or their scheduling."""
    used: set[int] = set()
    for model in network.models:
        active = np.asarray(model.active)
        if active.sum() > 1:
            used |= {s for s, _ in model.scheduling}
        index, taken = np.asarray(model.local.index), np.asarray(model.local.used)
        terms = np.unique(index[active][taken[active]])
        rows = np.unique(np.asarray(model.local.factor)[terms])
        used |= {network.variables.rows[row - 1][0] for row in rows if row}
    return tuple(s for s in range(len(network.channels.inputs)) if s in used)


def feature_rows(
    features: Variables, data: Dataset, groups: Groups | None
) -> InputRows:
    """Features of all valid samples; filters begin at rest at the first sample."""
    batch, used = stack_records(data), tuple(dict.fromkeys(s for s, _ in features))
    length = batch.valid.shape[1]
    own = np.array(used)
    valid = np.asarray(batch.valid)[:, :, own].all(axis=2)
    at = np.flatnonzero(valid.reshape(-1))
    x = row_columns(batch, at, features, float(data.sample_time)).astype(float)
    u = np.asarray(batch.signals, float)[:, :, own]
    step = np.diff(u, axis=1, prepend=u[:, :1]).reshape(-1, len(own))[at].T
    group = np.full((len(data), length), -1)
    if groups is not None:
        for n, label in enumerate(groups.labels):
            group[n, : len(label)] = label
    there = np.arange(length)[None] < np.array([len(r) for r in data])[:, None]
    place = np.cumsum(there.reshape(-1)) - 1
    return InputRows(x, step, group.reshape(-1)[at], place[at])


def measure_influence(
    network: Network, data: Dataset, used: tuple[int, ...]
) -> tuple[Float[np.ndarray, " used"], float]:
    """The influence of each input on the free run, a share of the largest, and how long
    the run remembers inputs [samples].

    An input counts by the change of the run when it alone is moved in time by half of
    its record; what a run remembers is what is left of such a change of all inputs
    after they are again as they were.
    """
    moved = [np.roll(r.u, len(r) // 2, axis=0) for r in data]
    alone = [
        [
            np.concatenate([r.u[:, :s], m[:, s : s + 1], r.u[:, s + 1 :]], axis=1)
            for r, m in zip(data, moved, strict=True)
        ]
        for s in used
    ]
    back = [
        [
            np.where((np.arange(len(r)) < cut * len(r))[:, None], m, r.u)
            for r, m in zip(data, moved, strict=True)
        ]
        for cut in MEMORY_CUTS
    ]
    changes = _changes(network, data, [*alone, *back])
    weight = [np.sqrt(np.mean(np.concatenate(c))) for c in changes[: len(used)]]
    left = np.zeros(max(len(r) for r in data))
    for cut, change in zip(MEMORY_CUTS, changes[len(used) :], strict=True):
        for r, square in zip(data, change, strict=True):
            tail = square[int(np.ceil(cut * len(r))) :].mean(axis=1)
            left[: len(tail)] += tail
    weight = np.array(weight, float)
    return _shares(weight), _memory(left, min(len(r) for r in data))


def _changes(
    network: Network, data: Dataset, inputs: list[list[np.ndarray]]
) -> list[list[np.ndarray]]:
    """Squared change of the free run of every record, in spreads of the outputs, where
    its inputs are others: a list of records for each of `inputs`, all run at once."""
    spread = _spread(data, network)[None]
    records = [
        dataclasses.replace(record, name=f"{record.name} {n}", u=u)
        for n, own in enumerate([[r.u for r in data], *inputs])
        for record, u in zip(data, own, strict=True)
    ]
    many = dataclasses.replace(data, records=tuple(records))
    runs = simulate(network, many).value.outputs
    base, *others = (runs[n : n + len(data)] for n in range(0, len(runs), len(data)))
    return [
        [((a - b) / spread) ** 2 for a, b in zip(one, base, strict=True)]
        for one in others
    ]


def _shares(weight: Float[np.ndarray, " used"]) -> Float[np.ndarray, " used"]:
    """Shares of the largest one; all alike where the run follows none."""
    most = weight.max()
    return weight / most if most > 0 else np.ones_like(weight)


def _memory(left: Float[np.ndarray, " time"], shortest: int) -> float:
    """Samples in which a change of that course of its square fades."""
    rest = np.sqrt(left)
    if not rest[0] > 0:
        return 1.0
    return float(np.clip(rest.sum() / rest.max(), 1.0, max(shortest / 5, 1.0)))


def _spread(data: Dataset, network: Network) -> Float[np.ndarray, " outputs"]:
    """Standard deviation of the measured outputs, one where they are constant."""
    y = np.concatenate([r.y for r in data])[:, list(network.modelled)]
    spread = y.std(axis=0)
    return np.where(spread > 0, spread, 1.0)


def _make_domain(
    features: Variables,
    rows: InputRows,
    weight: Float[np.ndarray, " features"],
    points: int,
) -> Domain:
    """The domain of these samples, before its borders are known."""
    used = len(rows.step)
    middle, spread = rows.x.mean(axis=1), rows.x.std(axis=1)
    size = np.maximum(np.abs(middle), np.abs(rows.x).max(axis=1))
    spread = np.where(
        spread > LEAST_SPREAD_SHARE * size, spread, np.where(size > 0, size, 1.0)
    )
    unit = (rows.x - middle[:, None]) / spread[:, None]
    at = np.unique(np.linspace(0, unit.shape[1] - 1, POOL_SAMPLES).astype(int))
    stored = _spread_out(unit[:, at].T * weight[None], points)
    value = rows.x[:used]
    leaves = (
        middle,
        spread,
        weight,
        stored,
        _whitening_matrix(unit),
        value.min(axis=1),
        value.max(axis=1),
        np.abs(rows.step).max(axis=1),
        np.ones(len(LAYERS)),
    )
    return Domain(features, *jax.device_put(leaves))


@program
def _layers(domain: Domain, x, step):
    return domain.layers(x, step)


def compute_layers(
    domain: Domain, rows: InputRows
) -> tuple[Float[np.ndarray, "time layers"], Int[np.ndarray, "time layers"]]:
    """`Domain.layers` of these samples, on the host, in the domain's precision."""
    kind, count = domain.middle.dtype, rows.x.shape[1]
    room = (0, 0), (0, bucket(count) - count)
    samples = [np.pad(a.astype(kind), room, mode="edge") for a in (rows.x, rows.step)]
    values, blamed = _layers(domain, *jax.device_put(samples))
    return np.asarray(values)[:count], np.asarray(blamed)[:count]


def _whitening_matrix(
    unit: Float[np.ndarray, "features time"],
) -> Float[np.ndarray, "features features"]:
    """W with W S W' = 1 for the covariance S of features of unit size.

    Directions that hardly move are as wide as a hundredth of the widest: what training
    has not moved at all must not decide everything.
    """
    covariance = np.cov(unit, bias=True).reshape(len(unit), len(unit))
    value, vector = np.linalg.eigh(covariance)
    value = np.maximum(value, 1e-4 * max(value[-1], 1e-300))
    return vector.T / np.sqrt(value)[:, None]


def _spread_out(
    rows: Float[np.ndarray, "rows features"], points: int
) -> Float[np.ndarray, "points features"]:
    """Points that leave no row far from the nearest of them.

    The first is the one nearest the mean, each other the row that is farthest from
    those before it: T. Gonzalez, Clustering to minimize the maximum intercluster
    distance, Theoretical Computer Science 38 (1985) 293-306.
    """
    first = int(np.argmin(((rows - rows.mean(axis=0)[None]) ** 2).sum(axis=1)))
    chosen = [first]
    apart = ((rows - rows[first][None]) ** 2).sum(axis=1)
    for _ in range(min(points, len(rows)) - 1):
        at = int(np.argmax(apart))
        if not apart[at] > 0:
            break
        chosen.append(at)
        apart = np.minimum(apart, ((rows - rows[at][None]) ** 2).sum(axis=1))
    return rows[chosen]


def fold_layers(domain: Domain, rows: InputRows) -> Float[np.ndarray, "time layers"]:
    """Layers of all samples, of every group by a domain of the others, with the borders
    of this one; of samples that are in no group, by this one."""
    weight, points = np.asarray(domain.weight, float), len(domain.points)
    values = compute_layers(domain, rows)[0].copy()
    for g in range(rows.group.max(initial=-1) + 1):
        out = rows.group == g
        train = rows.select(~out & (rows.group >= 0))
        if out.any() and len(train.group):
            fold = _make_domain(domain.features, train, weight, points)
            border = domain.border.astype(fold.border.dtype)
            fold = dataclasses.replace(fold, border=border)
            values[out] = compute_layers(fold, rows.select(out))[0]
    return values


def _border(domain: Domain, rows: InputRows) -> Float[np.ndarray, " layers"]:
    """The border of every layer, so that 95 % of the samples left out are inside of
    all. Without groups, where the training itself reaches."""
    values = fold_layers(domain, rows)
    if rows.group.max(initial=-1) < 1:
        reach = values.max(axis=0)
        return np.where(reach > 0, reach, 1.0)
    values = values[rows.group >= 0]
    each = np.quantile(values, 1 - BEYOND_SHARE, axis=0)
    # Ranges and steps of the training itself are known, however seldom they are met.
    own = np.isin(LAYERS, ("range", "rate"))
    each = np.where(own, np.maximum(each, 1.0), each)
    each = np.where(each > 0, each, 1.0)
    return each * np.quantile((values / each[None]).max(axis=1), 1 - BEYOND_SHARE)
