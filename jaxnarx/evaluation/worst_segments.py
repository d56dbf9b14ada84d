"""The stretches of time in which the free run errs most, and what was unusual there."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.confidence import DomainIndex
from jaxnarx.data import Channel, Dataset
from jaxnarx.evaluation._region_errors import leading_models, region_text
from jaxnarx.evaluation.rows import ScoredSamples
from jaxnarx.formatting import page, span_text
from jaxnarx.models import Network
from jaxnarx.simulation import Prepared, stack_batch

SEGMENTS_PER_OUTPUT = 10
"""Stretches of every output."""
WINDOW_TIME_SHARE = 0.005
"""Length of time over which errors are averaged, in that of all records."""
SHORTEST_WINDOW_SAMPLES, LONGEST_WINDOW_SAMPLES = 5, 200
"""The same in samples."""
SEGMENT_EDGE_SHARE = 0.5
"""A stretch ends where the mean squared error falls below this share of its peak."""


@dataclasses.dataclass(frozen=True)
class ErrorStretch:
    """A stretch of time, in seconds from the record's begin, with a large error.

    `rmse` and `bias` (mean of measured minus simulated) are in the unit of the output,
    `times` is the RMSE in that of all samples. The stretch states the largest `index`
    of the domain with the `layer` and `channel` it is owed to, where the network knows
    its domain; the `region` of the local model that leads at its peak; the share of
    samples at which the feedback bound acted, at which the output was held at its
    range, and at which an input was outside of its range.
    """

    output: str
    unit: str
    record: str
    start: float
    end: float
    rmse: float
    bias: float
    times: float
    index: float | None
    layer: str
    channel: str
    region: str
    limited: float
    held: float
    extrapolated: float

    @property
    def unusual(self) -> str:
        """The unusual of the segment in words; empty where nothing was."""
        told = []
        if self.index is not None and self.index > 1:
            told.append(f"index {self.index:.3g} by {self.layer} of {self.channel}")
        shares = {
            "feedback limited": self.limited,
            "held at its range": self.held,
            "inputs beyond their range": self.extrapolated,
        }
        told += [f"{what} {share:.0%}" for what, share in shares.items() if share > 0]
        return ", ".join(told)

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit not in ("", "-", "1") else ""
        first, last = span_text(self.start, self.end)
        text = (
            f"{self.output}, {self.record}, {first} to {last} s: RMSE "
            f"{self.rmse:.3g}{unit}, {self.times:.2g} times the usual"
        )
        return "; ".join(part for part in (text, self.unusual, self.region) if part)

    _repr_html_ = page


def worst_stretches(
    network: Any,
    data: Dataset,
    outputs: Sequence[Channel],
    free: list[list[ScoredSamples]],
    known: DomainIndex | None = None,
) -> tuple[ErrorStretch, ...]:
    """Up to ten of every output, the largest error first; diverged records left out.

    Errors are averaged over .5 % of the samples (5 to 200). `known` is the index of the
    domain on `data`.
    """
    found: list[ErrorStretch] = []
    total = sum(int(one.scored.sum()) for one in free[0]) if free else 0
    window = int(
        np.clip(
            round(WINDOW_TIME_SHARE * total),
            SHORTEST_WINDOW_SAMPLES,
            LONGEST_WINDOW_SAMPLES,
        )
    )
    for o, (channel, samples) in enumerate(zip(outputs, free, strict=True)):
        calm = {n: one for n, one in enumerate(samples) if not one.diverged}
        errors = {
            n: np.where(one.scored, one.measured - one.predicted, 0.0)[:, 0]
            for n, one in calm.items()
        }
        count = sum(int(one.scored.sum()) for one in calm.values())
        largest = max(
            (float(np.abs(e).max(initial=0)) for e in errors.values()), default=0
        )
        if not count or not largest > 0:
            continue
        square = sum(float(np.sum((e / largest) ** 2)) for e in errors.values())
        usual = largest * np.sqrt(square / count)
        places = _places(calm, errors, largest, window)
        regions = _regions(network, data, o, [(n, at) for n, at, _ in places])
        found += [
            _describe(channel, n, calm[n], errors[n], part, usual, known, region, data)
            for (n, _, part), region in zip(places, regions, strict=True)
        ]
    return tuple(found)


def _places(calm, errors, largest, window) -> list[tuple[int, int, slice]]:
    """(record, peak, samples) of the stretches; none overlaps another."""
    means = {
        n: _mean_square(errors[n] / largest, one.scored[:, 0], window)
        for n, one in calm.items()
    }
    found = []
    for _ in range(SEGMENTS_PER_OUTPUT):
        n = max(means, key=lambda n: means[n].max(initial=0))
        at = int(np.argmax(means[n]))
        peak = means[n][at]
        if not peak > 0:
            break
        low = means[n] < SEGMENT_EDGE_SHARE * peak
        before, behind = np.flatnonzero(low[:at]), np.flatnonzero(low[at:])
        start = int(before[-1]) + 1 if len(before) else 0
        stop = at + int(behind[0]) if len(behind) else len(low)
        found.append((n, at, slice(start, stop)))
        # What is beside it, within the window, is the same event.
        means[n][max(start - window, 0) : stop + window] = 0.0
    return found


def _mean_square(
    error: Float[np.ndarray, " time"], scored: Bool[np.ndarray, " time"], window: int
) -> Float[np.ndarray, " time"]:
    """Over a window around each sample; zero where most of it is not scored."""
    ones = np.ones(min(window, len(error)))
    if not len(ones):
        return np.zeros(0)
    count = np.convolve(scored.astype(float), ones, mode="same")
    square = np.convolve(error**2, ones, mode="same")
    enough = scored & (count >= 0.5 * len(ones))
    return np.where(enough, square / np.maximum(count, 1), 0.0)


def _regions(
    network: Any, data: Dataset | Prepared, o: int, peaks: list[tuple[int, int]]
) -> list[str]:
    """The region of the local model that leads at each peak; empty with one alone."""
    nothing = [""] * len(peaks)
    if not isinstance(network, Network) or not peaks:
        return nothing
    _, batch = stack_batch(network, data)
    length = batch.valid.shape[1]
    lead = leading_models(
        network, batch, o, np.array([n * length + t for n, t in peaks])
    )
    if lead is None:
        return nothing
    regions = network.regions(o)
    return [region_text(regions[m]) for m in lead]


def _describe(
    channel, n, samples, error, part, usual, known, region, data
) -> ErrorStretch:
    scored = samples.scored[part, 0]
    own = error[part][scored]
    scale = float(np.abs(own).max()) or 1.0
    rmse = scale * float(np.sqrt(np.mean((own / scale) ** 2)))
    index, layer, blamed = None, "", ""
    if known is not None and len(known.index[n][part]):
        at = part.start + int(np.argmax(known.index[n][part]))
        index = float(known.index[n][at])
        layer = known.layer_names[known.layer[n][at]]
        blamed = known.channel_names[known.channel[n][at]]
    return ErrorStretch(
        *(channel.name, channel.unit, samples.record),
        *(part.start * data.sample_time, (part.stop - 1) * data.sample_time),
        *(
            rmse,
            scale * float(np.mean(own / scale)),
            rmse / usual,
            index,
            layer,
            blamed,
            region,
        ),
        *(
            float(np.mean(mask))
            for mask in (
                samples.limited[part, 0],
                samples.held[part, 0],
                samples.extrapolated[part],
            )
        ),
    )
