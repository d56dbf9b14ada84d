"""The records of a report as its page shows them: every signal and every run."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.confidence import DomainIndex, Intervals
from jaxnarx.data import Channel, Dataset
from jaxnarx.evaluation.rows import ScoredSamples
from jaxnarx.models import Network
from jaxnarx.simulation import Prepared, ensure_prepared, get_dataset


@dataclasses.dataclass(frozen=True, eq=False)
class ShownRecord:
    """A record of a part, all of its signals in physical units.

    `signals` are the measured channels by name, `simulated` the free run of every
    output, `scored` where it counts and `limited` where the feedback bound acted.
    `lower` and `upper` are prediction intervals and `index` that of the domain, where
    the network knows them; `others` are free runs of other models by their name.

    The run begins at sample `start` (the length of the record where it never does).
    `begin` are measured outputs, and estimates of hidden channels, up to that sample,
    the network's own channels in order.
    """

    part: str
    name: str
    signals: Mapping[str, Float[np.ndarray, " time"]]
    simulated: Float[np.ndarray, "time outputs"]
    scored: Bool[np.ndarray, "time outputs"]
    limited: Bool[np.ndarray, "time outputs"]
    start: int = 0
    begin: Float[np.ndarray, "begin computed"] | None = None
    lower: Float[np.ndarray, "time outputs"] | None = None
    upper: Float[np.ndarray, "time outputs"] | None = None
    index: Float[np.ndarray, " time"] | None = None
    others: Mapping[str, Float[np.ndarray, "time outputs"]] = dataclasses.field(
        default_factory=dict
    )

    def __len__(self) -> int:
        return len(self.simulated)

    def measurement(self, output: int) -> Float[np.ndarray, " time"]:
        """The measurement of an output: outputs are the last of the signals."""
        place = len(self.signals) - self.simulated.shape[1] + output
        return list(self.signals.values())[place]

    def residual(self, output: int) -> Float[np.ndarray, " time"]:
        """Measured minus simulated, NaN where it does not count."""
        with np.errstate(over="ignore", invalid="ignore"):
            off = self.measurement(output) - self.simulated[:, output]
        return np.where(self.scored[:, output], off, np.nan)

    def error(self, output: int) -> float | None:
        """Root mean square of the residual; None where nothing counts, infinite where
        it overflows."""
        off = self.residual(output)[self.scored[:, output]]
        scale = float(np.max(np.abs(off), initial=0.0)) or 1.0
        if not np.isfinite(scale):
            return float("inf")
        return scale * float(np.sqrt(np.mean((off / scale) ** 2))) if off.size else None


def shown_records(
    network: Any,
    part: str,
    data: Dataset | Prepared,
    outputs: tuple[Channel, ...],
    run: Any,
    free: list[list[ScoredSamples]],
    bounds: Intervals | None,
    index: DomainIndex | None,
    others: Mapping[str, Mapping[str, list[ScoredSamples]]],
) -> tuple[ShownRecord, ...]:
    """The records of a part in their order.

    `run` is their free run and `free` its samples by output and record; `others` are
    those of other models, by model and output.
    """
    starts, begins = _begins(network, data, run)
    data = get_dataset(data)
    names = [channel.name for channel in outputs]
    columns = data.channels.names
    order = [n for n in columns if n not in names] + names
    found = []
    for n, record in enumerate(data):
        table = np.concatenate([record.u, record.y], axis=1)
        table = np.where(record.valid, table, np.nan)
        own = {name: table[:, columns.index(name)] for name in order}
        found.append(
            ShownRecord(
                part=part,
                name=record.name,
                signals=own,
                simulated=_side(free, n, "predicted"),
                scored=_side(free, n, "scored"),
                limited=_side(free, n, "limited"),
                start=starts[n],
                begin=begins[n],
                lower=None if bounds is None else bounds.lower[n],
                upper=None if bounds is None else bounds.upper[n],
                index=None if index is None else index.index[n],
                others={
                    model: np.stack(
                        [
                            runs[name][n].predicted[:, 0]
                            if name in runs
                            else np.full(len(record), np.nan)
                            for name in names
                        ],
                        axis=1,
                    )
                    for model, runs in others.items()
                },
            )
        )
    return tuple(found)


def _side(free: list[list[ScoredSamples]], n: int, what: str) -> np.ndarray:
    return np.concatenate([getattr(samples[n], what) for samples in free], axis=1)


def _begins(
    network: Any, data: Dataset | Prepared, run: Any
) -> tuple[list[int], list[Float[np.ndarray, "begin computed"] | None]]:
    """The samples at which free runs begin, and what they begin from."""
    if not isinstance(network, Network):
        known = get_dataset(data)
        return [0] * len(known), [None] * len(known)
    _, origin = ensure_prepared(network, data)
    own, starts = origin.matched, origin.masks.start.tolist()
    starts = [min(s, len(record)) for s, record in zip(starts, own, strict=True)]
    begins = []
    for n, (record, start) in enumerate(zip(own, starts, strict=True)):
        rows = slice(0, start + 1)
        measured = record.y[rows][:, list(network.modelled)].astype(float)
        hidden = np.asarray(run.hidden[n], float)[rows] if network.hidden else None
        begins.append(
            measured if hidden is None else np.concatenate([measured, hidden], axis=1)
        )
    return starts, begins
