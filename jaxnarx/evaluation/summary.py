"""The summary of a report: may the model be used, where, why, and what comes next."""

import dataclasses
import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxnarx.evaluation._error_map import ErrorMap
from jaxnarx.evaluation.rows import FREE_RUN, POOLED_NAME, Row
from jaxnarx.evaluation.table import number
from jaxnarx.evaluation.verdict import GOOD, LIMITED, UNUSABLE, Verdict
from jaxnarx.formatting import span_text
from jaxnarx.models import OUTSIDE_WORDS, Network

VERDICT_USES = {
    GOOD: "it can stand in for the engine wherever its inputs stay within the range it "
    "was trained for.",
    LIMITED: "it can be used within the range it was trained for if the reasons below "
    "do not matter there.",
    UNUSABLE: "do not rely on its free run.",
}
"""Meaning of a verdict for use."""
LISTED_INPUTS = 8
"""Inputs whose ranges are told."""
LISTED_CAUSES = 4
"""Reasons that are told at once."""


@dataclasses.dataclass(frozen=True)
class Summary:
    """The first lines of a report, all of them sentences or names."""

    level: str
    use: str
    where: tuple[str, ...]
    why: tuple[str, ...]
    more: int
    """Reasons that are not told."""
    also: tuple[str, ...]
    """Points to look at, whatever the verdict."""
    helps: str
    worst_record: str
    worst_place: tuple[str, ...]

    def lines(self, width: int = 88) -> list[str]:
        """The summary as text: the verdict, then a hanging paragraph for each of the
        answers."""
        more = f"and {self.more} more" if self.more else ""
        told = {
            "why": [*self.why, *([more] if more else [])],
            "also": self.also,
            "where": self.where,
            "helps": [self.helps] if self.helps else [],
            "worst": [w for w in (self.worst_record, *self.worst_place) if w],
        }
        lines = textwrap.wrap(f"{self.level.capitalize()}: {self.use}", width)
        for name, sentences in told.items():
            for n, sentence in enumerate(sentences):
                lead = f"  {name if n == 0 else '':7s}"
                lines += textwrap.wrap(
                    _printable(sentence),
                    width,
                    initial_indent=lead,
                    subsequent_indent=" " * len(lead),
                )
        return lines


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)


def summary(report: Any) -> Summary:
    """Summarise a `Report`."""
    found: Verdict = report.verdict
    causes = tuple(reason.text for reason in found.findings)
    return Summary(
        found.level,
        VERDICT_USES[found.level],
        tuple(_describe_range(report)),
        causes[:LISTED_CAUSES] or (found.praise,),
        max(len(causes) - LISTED_CAUSES, 0),
        found.remarks,
        found.helps,
        _worst_record(report),
        tuple(_worst_places(report)),
    )


def _describe_range(report: Any) -> Iterator[str]:
    """The range it was trained for, and how far the main part is inside."""
    network = report.network
    if isinstance(network, Network):
        inputs = list(enumerate(network.channels.inputs))
        low, high = np.asarray(network.low), np.asarray(network.high)
        ranges = [
            f"{c.name} {float(low[s]):.4g} to {float(high[s]):.4g}" + _unit(c.unit)
            for s, c in inputs[:LISTED_INPUTS]
        ]
        more = len(inputs) - len(ranges)
        ranges += [f"{more} more"] if more > 0 else []
        beyond = OUTSIDE_WORDS[network.outside].behind_ranges
        yield f"trained for {', '.join(ranges)}. {beyond}."
    share = report.domain.outside.get(report.main) if report.domain else None
    if share is None:
        rows = [r for r in _rows(report) if r.record == POOLED_NAME]
        share = max((r.share_outside for r in rows), default=0.0)
    inside = 100 * (1 - share)
    yield f"{inside:.3g} % of the {report.main} samples lie within what it knows"


def _worst_record(report: Any) -> str:
    """The record with the largest error, in shares of the output's usual error."""
    told = []
    for channel in report.outputs:
        rows = [
            r
            for r in _rows(report)
            if r.output == channel.name and r.record != POOLED_NAME and r.samples
        ]
        lost = [r for r in rows if r.diverged]
        if lost:
            told.append(f"{channel.name} diverges in {lost[0].record}")
        known = [(r.rmse, r.record) for r in rows if r.rmse is not None]
        if lost or len(known) < 2:
            continue
        error, record = max(known)
        pooled = report.pooled_row(channel.name).rmse
        times = error / pooled if pooled else None
        text = f"{channel.name} in {record}: RMSE {number(error, '.3g')}"
        text += _unit(channel.unit)
        told.append(
            text + (f", {times:.2g} times that of all records" if times else "")
        )
    return f"record: {'; '.join(told[:3])}" if told else ""


def _worst_places(report: Any) -> Iterator[str]:
    """Cells of the operating range, and stretches of time."""
    maps: tuple[ErrorMap, ...] = report.maps
    cells = [text for text in map(str, maps) if text]
    if cells:
        yield f"place: {'; '.join(cells[:2])}"
    if report.worst:
        first = max(report.worst, key=lambda one: one.times)
        ends = span_text(first.start, first.end)
        told = f"{first.output}, {first.record}, {ends[0]} to {ends[1]} s"
        more = f"; {first.unusual}" if first.unusual else ""
        yield f"stretch: {told}: {first.times:.2g} times the usual{more}"


def _rows(report: Any) -> list[Row]:
    """Free-run rows of the main part."""
    return [r for r in report.rows if (r.part, r.mode) == (report.main, FREE_RUN)]


def _unit(unit: str) -> str:
    return f" {unit}" if unit not in ("", "-", "1") else ""
