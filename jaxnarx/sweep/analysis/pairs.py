"""Paired comparison: the effect of one setting on a score, all else equal."""

import dataclasses
from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.errors import SpecError
from jaxnarx.formatting import page
from jaxnarx.sweep.analysis.groups import labels
from jaxnarx.sweep.analysis.table import SweepTable

BOOTSTRAP_RESAMPLES = 2000
INTERVAL_COVERAGE = 0.95
RESAMPLE_BATCHES = 20
"""Resamples are evaluated in so many batches, for the memory's sake."""


@dataclasses.dataclass(frozen=True)
class Interval:
    """A figure and the percentile interval of its bootstrap, which covers 95 %."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}]"

    _repr_html_ = page


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A score at two levels of a factor, in pairs that agree in everything else.

    `before` and `after` hold the scores of the pairs in which both levels ended well,
    `labels` what these pairs have in common. `difference` is the median of after -
    before, `ratio` the median of after / before (NaN unless all scores are positive),
    `improved` the share of pairs in which after is smaller. `failed_before`,
    `failed_after` and `failed_both` count pairs in which one level, the other or both
    failed or have no finite score; `unpaired` counts rows without a partner.
    """

    score: str
    factor: str
    levels: tuple[Any, Any]
    labels: tuple[dict[str, Any], ...]
    before: Float[np.ndarray, " pairs"]
    after: Float[np.ndarray, " pairs"]
    difference: Interval
    ratio: Interval
    improved: Interval
    failed_before: int
    failed_after: int
    failed_both: int
    unpaired: int

    @property
    def worst(self) -> dict[str, Any]:
        """Labels, `before` and `after` of the pair that lost most by ratio, or by
        difference where there are no ratios.
        """
        positive = np.all(self.before > 0)
        loss = self.after / self.before if positive else self.after - self.before
        i = int(np.argmax(loss))
        scores = {"before": float(self.before[i]), "after": float(self.after[i])}
        return {**self.labels[i], **scores}

    def __str__(self) -> str:
        """The comparison in words."""
        first, second = self.levels
        worst = ", ".join(f"{k} {_number(v)}" for k, v in self.worst.items())
        return (
            f"{self.score}, {self.factor} {second} against {first}, "
            f"{len(self.before)} pairs: ratio {self.ratio}, difference "
            f"{self.difference}, improved in {100 * self.improved.value:.0f} % of "
            f"pairs; worst: {worst}. Failed: {self.failed_before} with {first} only, "
            f"{self.failed_after} with {second} only, {self.failed_both} with both; "
            f"{self.unpaired} without partner."
        )

    _repr_html_ = page


@guard_arguments
def paired_comparison(
    table: SweepTable,
    *,
    pair: Sequence[str],
    factor: str,
    by: str,
    levels: tuple[Any, Any] | None = None,
    block: str | Sequence[str] | None = None,
    seed: int = 0,
) -> Comparison:
    """Compare a score at two levels of a factor over pairs of rows.

    Rows with equal labels `pair` and different `factor` are a pair; `by` is a score to
    be small. `levels` are (before, after), needed where the factor has more than two;
    else they come in the order of the table. Medians and the share of improved pairs
    have 95 % percentile intervals from 2,000 bootstrap resamples (Efron and Tibshirani
    1993, section 13.3) of pairs, or of whole blocks of pairs that agree in `block`: the
    starts of one engine are no independent witnesses, its block is. `seed` fixes the
    resamples.

    Pairs of which a row failed are counted apart and take no part in the figures.
    SpecError where labels do not tell rows apart, or no pair is left.
    """
    before, after, unpaired = _match_rows(table, pair, factor, levels)
    score = np.where(table.okay, table.numbers(by), np.nan)
    x, y = score[before], score[after]
    known = np.isfinite(x), np.isfinite(y)
    both = known[0] & known[1]
    if not both.any():
        raise SpecError(
            f"no pair of {factor} {_levels(table, factor, levels)} ended well at both",
            field="pair",
        )
    kept = table.take(before[both])
    names = labels(kept, pair)
    blocks = labels(kept, pair if block is None else block)
    return Comparison(
        score=by,
        factor=factor,
        levels=_levels(table, factor, levels),
        labels=tuple(dict(zip(pair, name, strict=True)) for name in names),
        before=x[both],
        after=y[both],
        **_figures(x[both], y[both], blocks, seed),
        failed_before=int(np.sum(~known[0] & known[1])),
        failed_after=int(np.sum(known[0] & ~known[1])),
        failed_both=int(np.sum(~known[0] & ~known[1])),
        unpaired=unpaired,
    )


def _levels(
    table: SweepTable, factor: str, levels: tuple[Any, Any] | None
) -> tuple[Any, Any]:
    found = list(dict.fromkeys(label for (label,) in labels(table, factor)))
    if levels is None and len(found) == 2:
        return found[0], found[1]
    if levels is not None and all(level in found for level in levels):
        return levels
    raise SpecError(
        f"levels must be two of what {factor} holds: {', '.join(map(repr, found))}",
        field="levels",
    )


def _match_rows(
    table: SweepTable, pair: Sequence[str], factor: str, levels
) -> tuple[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"], int]:
    """Rows of both levels with equal labels, and how many are alone."""
    sides: list[dict[tuple[Any, ...], int]] = []
    names, found = labels(table, pair), labels(table, factor)
    for level in _levels(table, factor, levels):
        side: dict[tuple[Any, ...], int] = {}
        for i, name in enumerate(names):
            if found[i] == (level,) and side.setdefault(name, i) != i:
                told = ", ".join(f"{k} {v}" for k, v in zip(pair, name, strict=True))
                raise SpecError(
                    f"rows {side[name]} and {i} have equal labels ({told}, {factor} "
                    f"{level}); name more labels in pair, or choose rows with where",
                    field="pair",
                )
        sides.append(side)
    first, second = sides
    common = [name for name in first if name in second]
    matched = [np.array([side[n] for n in common], np.int64) for side in sides]
    return matched[0], matched[1], len(first) + len(second) - 2 * len(common)


def _figures(
    x: Float[np.ndarray, " pairs"],
    y: Float[np.ndarray, " pairs"],
    blocks: Sequence[Hashable],
    seed: int,
) -> dict[str, Interval]:
    positive = np.all(x > 0) and np.all(y > 0)
    ratio = y / x if positive else np.full_like(x, np.nan)
    samples = _resamples(blocks, seed)
    return {
        "difference": _interval(y - x, np.median, samples),
        "ratio": _interval(ratio, np.median, samples),
        "improved": _interval((y < x).astype(float), np.mean, samples),
    }


def _resamples(blocks: Sequence[Hashable], seed: int) -> list[Int[np.ndarray, " _"]]:
    """Positions of pairs in every resample of as many blocks as there are."""
    members: dict[Hashable, list[int]] = {}
    for i, block in enumerate(blocks):
        members.setdefault(block, []).append(i)
    groups = [np.array(group) for group in members.values()]
    random = np.random.default_rng(seed)
    draws = random.integers(0, len(groups), (BOOTSTRAP_RESAMPLES, len(groups)))
    if len(groups) == len(blocks):
        order = np.concatenate(groups)
        return list(order[draws])
    return [np.concatenate([groups[g] for g in draw]) for draw in draws]


def _interval(values: Float[np.ndarray, " pairs"], statistic, samples) -> Interval:
    if len({len(sample) for sample in samples}) == 1:
        batches = np.array_split(np.stack(samples), RESAMPLE_BATCHES)
        figures = np.concatenate([statistic(values[b], axis=1) for b in batches])
    else:
        figures = [statistic(values[sample]) for sample in samples]
    low, high = np.quantile(
        figures, [(1 - INTERVAL_COVERAGE) / 2, (1 + INTERVAL_COVERAGE) / 2]
    )
    return Interval(float(statistic(values)), float(low), float(high))


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
