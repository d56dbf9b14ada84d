"""How the error of a free run grows with the distance from what the network knows."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.confidence import DomainIndex, Excursion, domain
from jaxnarx.data import Channel, Dataset
from jaxnarx.evaluation.extrapolation import NOTICEABLE_OUTSIDE_SHARE
from jaxnarx.evaluation.rows import ScoredSamples
from jaxnarx.evaluation.table import number
from jaxnarx.metrics import pooled_rms
from jaxnarx.models import Network
from jaxnarx.simulation import Prepared

INDEX_EDGES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, np.inf)
"""Borders of the bins of the index."""
BORDER_EDGE = INDEX_EDGES.index(1.0)
FEWEST_BIN_SAMPLES = 20
"""Samples of the smallest bin that has an error."""
SHOWN_STRETCHES = 10
"""Stretches of time that are told."""


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorByIndex:
    """Free-run error of one output by bins of the index, in its unit; NaN where a bin
    has fewer than 20 samples."""

    output: str
    unit: str
    rms: Float[np.ndarray, " bins"]
    samples: Int[np.ndarray, " bins"]

    def pool_bins(self, first: int, stop: int) -> float | None:
        """Over several bins together; None where they have too few samples."""
        count, rms = self.samples[first:stop], self.rms[first:stop]
        if count.sum() < FEWEST_BIN_SAMPLES:
            return None
        # Of a bin with few samples nothing is told, and little would be changed by it.
        known = ~np.isnan(rms)
        return pooled_rms(rms[known], count[known])

    @property
    def inside(self) -> float | None:
        """Up to the border."""
        return self.pool_bins(0, BORDER_EDGE)

    @property
    def outside(self) -> float | None:
        """Beyond it."""
        return self.pool_bins(BORDER_EDGE, len(self.rms))


@dataclasses.dataclass(frozen=True, eq=False)
class DomainErrors:
    """The errors of a report's parts outside of the network's domain, beside those
    inside.

    `outside` is the share of the samples of every part; `excursions` are the farthest
    stretches of the main part, and `errors` its free-run error by the index.
    """

    outside: Mapping[str, float]
    excursions: tuple[Excursion, ...]
    errors: tuple[ErrorByIndex, ...]


def domain_indices(
    network: Any, parts: Mapping[str, Dataset | Prepared]
) -> dict[str, DomainIndex]:
    """Domain indices by part; empty of a network without a domain."""
    if not isinstance(network, Network) or network.domain is None:
        return {}
    return {part: domain(network, data).value for part, data in parts.items()}


def domain_errors(
    found: Mapping[str, DomainIndex],
    main: str,
    outputs: tuple[Channel, ...],
    free: list[list[ScoredSamples]],
) -> DomainErrors | None:
    """None where nothing was found; `free` is the free run of the main part."""
    if not found:
        return None
    index = found[main].index
    errors = []
    for channel, samples in zip(outputs, free, strict=True):
        pairs = [
            (one.measured - one.predicted, one.scored, value)
            for one, value in zip(samples, index, strict=True)
            if not one.diverged
        ]
        if not pairs:
            continue
        error = np.concatenate([e[s] for e, s, _ in pairs])
        value = np.concatenate([i[s[:, 0]] for _, s, i in pairs])
        errors.append(_bin_errors(channel, error, value))
    share = {part: value.outside for part, value in found.items()}
    return DomainErrors(share, found[main].excursions[:SHOWN_STRETCHES], tuple(errors))


def _bin_errors(
    channel: Channel,
    error: Float[np.ndarray, " samples"],
    index: Float[np.ndarray, " samples"],
) -> ErrorByIndex:
    at = np.clip(
        np.searchsorted(INDEX_EDGES, index, side="left") - 1, 0, len(INDEX_EDGES) - 2
    )
    count = np.bincount(at, minlength=len(INDEX_EDGES) - 1)
    scale = float(np.max(np.abs(error), initial=0.0)) or 1.0
    square = np.bincount(at, (error / scale) ** 2, minlength=len(count))
    enough = count >= FEWEST_BIN_SAMPLES
    mean = square / np.where(enough, count, 1)
    rms = np.where(enough, scale * np.sqrt(mean), np.nan)
    return ErrorByIndex(channel.name, channel.unit, rms, count)


def domain_notes(found: DomainErrors | None, main: str) -> list[str]:
    """Parts with at least 1 % of their samples outside of the domain, what the error of
    the main one is there, and where it is farthest."""
    notes = []
    for part, share in () if found is None else found.outside.items():
        if share < NOTICEABLE_OUTSIDE_SHARE:
            continue
        text = f"{100 * share:.3g} % of the {part} samples are outside of the domain "
        text += "that the model knows (index above 1)"
        if part == main and found is not None:
            told = [
                f"{e.output} {number(e.outside)} there and {number(e.inside)} inside"
                for e in found.errors
                if e.outside is not None and e.inside is not None
            ]
            if told:
                text += f"; free-run error: {', '.join(told[:4])}"
            if found.excursions:
                text += f"; farthest: {found.excursions[0]}"
        notes.append(f"{text}.")
    return notes
