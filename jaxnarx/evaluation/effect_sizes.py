"""How much a model's free run is worth: what it explains, and beside what else."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxnarx import metrics
from jaxnarx.data import Channel
from jaxnarx.evaluation.domain_errors import DomainErrors
from jaxnarx.evaluation.rows import FREE_RUN, POOLED_NAME, Row, ScoredSamples
from jaxnarx.formatting import page


@dataclasses.dataclass(frozen=True)
class ErrorBeside:
    """The error as a multiple of another model's; smaller in `better` of `records`."""

    name: str
    factor: float
    better: int
    records: int

    def __str__(self) -> str:
        text = f"{self.factor:.2g} times the error of {self.name}"
        if self.records > 1:
            text += f" (smaller in {self.better} of {self.records} records)"
        return text

    _repr_html_ = page


@dataclasses.dataclass(frozen=True)
class Effect:
    """The size of an effect on one output's free run over the main part.

    `explained` is the share of its variance (R2), `beside` what other models leave,
    `trained` the NRMSE as a multiple of that on training data, `outside` the error
    outside of the domain as a multiple of that inside; None where it is not known.
    """

    output: str
    explained: float | None
    beside: tuple[ErrorBeside, ...]
    trained: float | None
    outside: float | None

    def __str__(self) -> str:
        told = []
        if self.explained is not None:
            told.append(f"{100 * self.explained:.3g} % of the variance explained")
        told += map(str, self.beside)
        if self.trained is not None:
            told.append(f"{self.trained:.2g} times the error on training data")
        if self.outside is not None:
            told.append(f"outside of its domain {self.outside:.2g} times that inside")
        return f"{self.output}: {'; '.join(told) or 'no figure'}"

    _repr_html_ = page


def effects(
    main: str,
    rows: Sequence[Row],
    free: list[list[ScoredSamples]],
    others: Mapping[str, list[tuple[Channel, list[ScoredSamples]]]],
    known: DomainErrors | None,
) -> tuple[Effect, ...]:
    """One for every output; `free` are its samples on the main part, and `others` those
    of other models by their name."""
    pooled = {
        (r.part, r.output): r
        for r in rows
        if (r.mode, r.record) == (FREE_RUN, POOLED_NAME)
    }
    names = list(dict.fromkeys(r.output for r in rows))
    found = []
    for name, own in zip(names, free, strict=True):
        row = pooled[main, name]
        trained = pooled.get(("train", name)) if main != "train" else None
        found.append(
            Effect(
                name,
                row.r2,
                tuple(_comparisons(name, own, others)),
                _ratio(row.nrmse, trained.nrmse if trained else None),
                _outside_ratio(name, known),
            )
        )
    return tuple(found)


def _comparisons(
    output: str,
    own: list[ScoredSamples],
    others: Mapping[str, list[tuple[Channel, list[ScoredSamples]]]],
) -> Iterable[ErrorBeside]:
    """Comparisons with every other model that has this output and stays bounded."""
    for name, run in others.items():
        samples = next((s for c, s in run if c.name == output), None)
        if samples is None:
            continue
        pairs = [
            (_error(a), _error(b), int(a.scored.sum()))
            for a, b in zip(own, samples, strict=True)
            if a.scored.any()
        ]
        if not pairs or any(s.diverged for s in (*own, *samples)):
            continue
        ours, theirs, count = map(np.array, zip(*pairs, strict=True))
        factor = _ratio(*(metrics.pooled_rms(e, count) for e in (ours, theirs)))
        if factor is not None:
            yield ErrorBeside(name, factor, int(np.sum(ours < theirs)), len(pairs))


def _error(samples: ScoredSamples) -> float:
    """Root mean square."""
    error = metrics.rmse(samples.measured, samples.predicted, samples.scored)
    return float(error[0])


def _outside_ratio(output: str, known: DomainErrors | None) -> float | None:
    errors: Any = () if known is None else known.errors
    one = next((e for e in errors if e.output == output), None)
    return None if one is None else _ratio(one.outside, one.inside)


def _ratio(value: float | None, other: float | None) -> float | None:
    """A quotient of figures that are known and finite."""
    if value is None or other is None or not other > 0:
        return None
    found = value / other
    return found if np.isfinite(found) else None
