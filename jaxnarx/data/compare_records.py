"""Records compared with each other: levels far apart, and channels in another unit.

A record may visit another operating range than its fellows; then its channels move
less, or more, together. Where one channel alone is another size than the other channels
of its record say, its unit is another. The expected values come from a linear
regression on all other channels, fitted without the record to averages over blocks of
time.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.findings import Finding, Severity
from jaxnarx.data.record import Record
from jaxnarx.data.scaling import scaling_unit
from jaxnarx.data.units import conversion

LEAST_RECORDS = 4
"""Fewer have no usual range."""
BLOCKS_PER_RECORD = 50
"""Averages that represent a record in the regression."""
RANGE_SAMPLES = 5_000
"""Samples of a record that its range is taken from, evenly spaced."""
OUTLYING_DEVIATIONS = 5.0
"""Scaled median absolute deviations, of logarithms, from which a record stands out."""
LEAST_SCATTER = 0.08
"""Least scaled deviation of logarithms: records are never more alike than so."""
LEAST_FACTOR = 1.5
"""Least factor between what a channel is and what the others say."""
MAX_DISAGREEMENT = 2.5
"""Most factor between what the level and what the movement of a channel say."""
LEVEL_DEVIATIONS = 5.0
"""Level, in standard deviations of the regression's error, from which it counts."""
LEAST_CORRELATION = 0.6
"""Correlation with what the others say from which their word counts."""
MAX_REST_SHARE = 0.5
"""Share of the difference from what the others say that a mend leaves at most."""
RANGE_FACTOR = 5.0
"""Factor between ranges that is noted although the other channels do not tell."""
REGRESSION_RIDGE = 1e-6
"""Ridge of the regressions, as a share of the variance of each channel."""
ZERO_CELSIUS_IN_KELVIN = 273.15
UNIT_TOLERANCE = 0.15
"""Relative distance from which a factor is told to be that of two units."""
UNIT_FACTORS = {
    60.0: "per minute and per second",
    1000.0: "a prefix such as k or m",
    100.0: "a share and percent",
    30 / np.pi: "rpm and rad/s",
    10.0: "a power of ten",
    6.894757: "psi and kPa",
    3.6: "m/s and km/h",
    1.8: "degC and degF",
}


LEVEL_RATIO = 5.0
"""Deviation over all records, in deviations within them, from which it is told."""


def far_levels(data: Dataset) -> Iterator[Finding]:
    """Outputs that differ between records by far more than they move within one.

    Errors divided by the deviation over all records look small then, whatever the model
    makes of the movement.
    """
    inputs = len(data.channels.inputs)
    for j, name in enumerate(data.channels.names[inputs:], inputs):
        known = [r.signal(j)[r.valid[:, j]] for r in data]
        known = [x for x in known if x.size]
        if len(known) < 2:
            continue
        unit = scaling_unit(*known)
        size = np.array([len(x) for x in known])
        level = np.array([(x / unit).mean() for x in known])
        within = np.average([(x / unit).var() for x in known], weights=size)
        apart = np.average((level - np.average(level, weights=size)) ** 2, weights=size)
        if not within > 0 or apart + within <= LEVEL_RATIO**2 * within:
            continue
        apart, within = np.sqrt(apart) * unit, np.sqrt(within) * unit
        yield Finding(
            "warning",
            "levels",
            f"{name} differs between records by {apart:.3g} and moves within them by "
            f"{within:.3g} (standard deviations). An NRMSE over all records counts "
            f"errors in the former: a model that knows only the level of each record "
            f"scores {within / apart:.2g}. Judge by the NRMSE within records, which "
            "reports note, or take the offsets off (jaxnarx prepare).",
            channel=name,
        )


def other_units(data: Dataset) -> Iterator[Finding]:
    """Records of which a channel seems to be in another unit, scale, offset or sign.

    One finding for a record: the channel that is furthest off. Each record that is
    found is left out before the others are compared again.
    """
    left = list(range(len(data)))
    blocks = Blocks.of(data) if len(data) >= LEAST_RECORDS else None
    while blocks is not None and len(left) >= LEAST_RECORDS:
        found = _worst(blocks[left], [c.unit for c in data.channels.all])
        if found is None:
            return
        record = data.records[left.pop(found.record)]
        name = data.channels.names[found.channel]
        yield Finding(
            found.severity,
            "another unit",
            f"{name} in {record.name} {found.text}.",
            channel=name,
            record=record.name,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Blocks:
    """Records in few figures, channels in units of `unit`; NaN where a record is short.

    `low` and `high` are the 0.5 and 99.5 percentiles of valid samples, `mean` and
    `gram` the mean and the covariance of block averages.
    """

    unit: Float[np.ndarray, " channels"]
    low: Float[np.ndarray, "records channels"]
    high: Float[np.ndarray, "records channels"]
    mean: Float[np.ndarray, "records channels"]
    gram: Float[np.ndarray, "records channels channels"]

    @classmethod
    def of(cls, data: Dataset) -> "Blocks":
        """The values of every record."""
        unit = scaling_unit(*(r.signals.T for r in data)).astype(np.float64)
        low, high = np.stack([_limits(r, unit) for r in data], axis=1)
        blocks = [_averages(r, unit) for r in data]
        channels = len(unit)
        gram = [np.cov(b.T, bias=True).reshape(channels, channels) for b in blocks]
        mean = np.stack([b.mean(axis=0) for b in blocks])
        return cls(unit, low, high, mean, np.stack(gram))

    def __len__(self) -> int:
        return len(self.mean)

    def __getitem__(self, records: list[int]) -> "Blocks":
        own = (self.low, self.high, self.mean, self.gram)
        return Blocks(self.unit, *(x[records] for x in own))


def _limits(record: Record, unit) -> Float[np.ndarray, "2 channels"]:
    rows = slice(None, None, max(1, len(record) // RANGE_SAMPLES))
    x = np.concatenate([record.u[rows], record.y[rows]], axis=1) / unit
    out = np.full((2, x.shape[1]), np.nan)
    for j, valid in enumerate(record.valid[rows].T):
        if valid.any():
            out[:, j] = np.percentile(x[valid, j], [0.5, 99.5])
    return out


def _averages(record: Record, unit) -> Float[np.ndarray, "blocks channels"]:
    """Averages over blocks of the rows that are valid in all channels; one of NaN where
    there are too few rows."""
    x = record.signals[record.valid.all(axis=1)] / unit
    count = min(BLOCKS_PER_RECORD, len(x))
    if count < max(10, 2 * x.shape[1]):
        return np.full((1, x.shape[1]), np.nan)
    edges = np.linspace(0, len(x), count, endpoint=False).astype(int)
    return np.add.reduceat(x, edges, axis=0) / np.diff(edges, append=len(x))[:, None]


@dataclasses.dataclass(frozen=True)
class Suspicion:
    """A change that would mend one channel of one record; `gain` is by how much it
    lowers the record's squared Mahalanobis distance from the others."""

    record: int
    channel: int
    gain: float
    text: str
    severity: Severity = "warning"


def _worst(blocks: Blocks, units: list[str]) -> Suspicion | None:
    known = np.isfinite(blocks.mean).all(axis=1)
    found = []
    for r in np.flatnonzero(known) if known.sum() >= LEAST_RECORDS else ():
        others = np.flatnonzero(known & (np.arange(len(blocks)) != r))
        beside = _Beside(blocks, int(r), others)
        found += [beside.suspicion(j, unit) for j, unit in enumerate(units)]
    told = [s for s in found if s is not None]
    return max(told, key=lambda s: s.gain, default=None)


class _Beside:
    """One record beside what regressions on the others say of each channel.

    Arrays by channel: `says` is the level that they say, `spread` and `said` the
    standard deviations of the channel and of what they say, `both` their covariance,
    `rest` the standard deviation that the regression leaves in the others, `follows`
    its correlation there.
    """

    def __init__(self, blocks: Blocks, r: int, others):
        self.blocks, self.r = blocks, r
        gram, grams = blocks.gram[r], blocks.gram[others]
        pooled = grams.mean(axis=0)
        weights, self.rest = _regressions(pooled)
        centre = blocks.mean[others].mean(axis=0)
        self.level = blocks.mean[r]
        self.says = centre + weights @ (self.level - centre)
        self.levels = blocks.mean[others]
        self.they_say = centre + (self.levels - centre) @ weights.T
        self.spread = np.sqrt(np.diag(gram))
        self.said, self.usually_said = (
            np.sqrt(np.maximum(np.einsum("ja,ab,jb->j", weights, g, weights), 0.0))
            for g in (gram, pooled)
        )
        self.both = np.einsum("ja,ja->j", weights, gram)
        spreads = np.maximum(np.einsum("sjj->sj", grams), 1e-300)
        self.slopes = np.einsum("ja,sja->sj", weights, grams) / spreads
        variance = np.maximum(np.diag(pooled), 1e-300)
        self.follows = np.sqrt(np.maximum(1 - self.rest**2 / variance, 0.0))

    def suspicion(self, j: int, unit: str) -> Suspicion | None:
        """A sign, scale or offset that mends channel `j`, as the others say."""
        size = self.spread[j] * self.said[j]
        slopes = self.slopes[self.slopes[:, j] > 0, j]
        if self.follows[j] < LEAST_CORRELATION:
            return _suspect_ranges(self.blocks, self.r, j)
        if not size > 0 or len(slopes) < 3:
            return None
        if abs(self.both[j]) < LEAST_CORRELATION * size:
            return None
        moves = float(self.both[j] / self.spread[j] ** 2 / np.median(slopes))
        if abs(np.log(abs(moves))) < np.log(LEAST_FACTOR):
            return self._suspect_offset(j, unit) if moves > 0 else self._suspect_sign(j)
        return self._suspect_factor(j, moves, slopes) if moves > 0 else None

    def _suspect_factor(self, j: int, moves: float, slopes) -> Suspicion | None:
        """The suspicion of a factor: that of the movement, or of the level where both
        say the same and it is known the better."""
        says, level = self.says[j], self.level[j]
        stands_out = abs(np.log(moves)) > _least(np.log(slopes))
        ordinary = abs(np.log(self.said[j] / self.usually_said[j]))
        factor = moves
        if abs(says) > LEVEL_DEVIATIONS * self.rest[j] and says * level > 0:
            factor = float(says / level)
            if abs(np.log(factor / moves)) > np.log(MAX_DISAGREEMENT):
                return None
            there = self.they_say[:, j] * self.levels[:, j] > 0
            ratios = self.they_say[there, j] / self.levels[there, j]
            stands_out = len(ratios) and abs(np.log(factor)) > _least(np.log(ratios))
            ordinary = abs(np.log(abs(says / np.median(self.they_say[:, j]))))
        if not stands_out or abs(np.log(factor)) < 1.5 * ordinary:
            return None
        return self._suspect(j, factor, 0.0, f"its unit ({_describe_factor(factor)})")

    def _suspect_sign(self, j: int) -> Suspicion | None:
        return self._suspect(j, -1.0, 0.0, "its sign (factor -1)")

    def _suspect_offset(self, j: int, unit: str) -> Suspicion | None:
        """Kelvin among degrees Celsius, or the reverse."""
        size = self.blocks.unit[j]
        is_temperature = not unit or conversion(unit, "K") is not None
        if (
            not is_temperature
            or OUTLYING_DEVIATIONS * self.rest[j] * size > ZERO_CELSIUS_IN_KELVIN
        ):
            return None
        offset = float(
            np.copysign(ZERO_CELSIUS_IN_KELVIN, self.says[j] - self.level[j])
        )
        text = f"its unit (offset {offset:+.2f}, degC and K)"
        return self._suspect(j, 1.0, offset / size, text)

    def _suspect(
        self, j: int, factor: float, offset: float, text: str
    ) -> Suspicion | None:
        """The suspicion where the mend brings the channel clearly nearer."""
        before, after = self._square(j, 1.0, 0.0), self._square(j, factor, offset)
        if after > MAX_REST_SHARE**2 * before:
            return None
        told = f"{_ranges(self.blocks, self.r, j)}, while the other channels move as "
        gain = (before - after) / max(self.rest[j], 1e-300) ** 2
        return Suspicion(self.r, j, gain, f"{told}usual. Look at {text}")

    def _square(self, j: int, factor: float, offset: float) -> float:
        """Mean square difference from what the others say, of the channel times
        `factor` plus `offset`."""
        level = self.says[j] - factor * self.level[j] - offset
        moved = self.said[j] ** 2 - 2 * factor * self.both[j]
        return float(max(level**2 + moved + factor**2 * self.spread[j] ** 2, 0.0))


def _regressions(gram: Float[np.ndarray, "channels channels"]):
    """Weights of every channel's regression on all others, minus a row of the inverse
    covariance over its diagonal, and the standard deviation that it leaves."""
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0, size, 1.0)
    inverse = np.linalg.inv(
        gram / size / size[:, None] + REGRESSION_RIDGE * np.eye(len(gram))
    )
    precise = np.diag(inverse)
    weights = -inverse / precise[:, None]
    np.fill_diagonal(weights, 0.0)
    return weights * size[:, None] / size, size / np.sqrt(precise)


def _least(logs: Float[np.ndarray, " records"]) -> float:
    """Logarithm from which a record stands out among others."""
    scatter = 1.4826 * float(np.median(np.abs(logs - np.median(logs))))
    return max(
        OUTLYING_DEVIATIONS * max(scatter, LEAST_SCATTER), float(np.log(LEAST_FACTOR))
    )


def _suspect_ranges(blocks: Blocks, r: int, j: int) -> Suspicion | None:
    """A range beyond all others of a channel that the other channels do not tell of:
    a note, for the record may have been run so."""
    reach = np.maximum(np.abs(blocks.low[:, j]), np.abs(blocks.high[:, j]))
    if not (reach > 0).all():
        return None
    logs = np.log(np.delete(reach, r)) - np.log(reach[r])
    log = float(np.median(logs))
    if (
        abs(log) < max(np.log(RANGE_FACTOR), _least(logs))
        or min(logs * np.sign(log)) < 1
    ):
        return None
    factor = _describe_factor(float(np.exp(log)))
    told = f"{_ranges(blocks, r, j)}. Look at its unit ({factor}), "
    return Suspicion(r, j, 0.0, told + "unless it was run so", "note")


def _ranges(blocks: Blocks, r: int, j: int) -> str:
    """`goes from 0 to 100, elsewhere from 0 to 594 ... 900`."""
    low, high = blocks.low[:, j] * blocks.unit[j], blocks.high[:, j] * blocks.unit[j]
    others = np.arange(len(low)) != r
    return (
        f"goes from {low[r]:.4g} to {high[r]:.4g}, elsewhere from "
        f"{np.nanmin(low[others]):.4g} up to {np.nanmin(high[others]):.4g} ... "
        f"{np.nanmax(high[others]):.4g}"
    )


def _describe_factor(factor: float) -> str:
    """`factor 9.2, near the 9.549 of rpm and rad/s`; of reciprocals likewise."""
    size = max(factor, 1 / factor)
    text = f"factor {factor:.2g}"
    near = min(UNIT_FACTORS, key=lambda known: abs(np.log(size / known)))
    if abs(np.log(size / near)) > UNIT_TOLERANCE:
        return text
    return f"{text}, near the {near:.4g} of {UNIT_FACTORS[near]}"
