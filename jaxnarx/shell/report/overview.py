"""The first lines of a page: how good, and where it can be trusted."""

from typing import Any

from jaxnarx.evaluation import GOOD, LIMITED, UNUSABLE, Report, Row, rows_beside

LEVEL_CLASSES = {GOOD: "good", LIMITED: "warn", UNUSABLE: "bad"}
"""The look of a verdict and of its reasons."""


def overview(report: Report) -> dict[str, Any]:
    """The verdict, one card per output, and a line of trust per part."""
    cards = [_card(report, channel.name) for channel in report.outputs]
    trust = [
        _evidence(report, report.pooled_row(channel.name, part=part))
        for part in report.parts
        for channel in report.outputs
    ]
    return {
        "judged": report.verdict,
        "kind": LEVEL_CLASSES[report.verdict.level],
        "kinds": LEVEL_CLASSES,
        "cards": cards,
        "trust": trust,
        "beside": rows_beside(report),
        "ranges": _ranges(report),
    }


def _card(report: Report, output: str) -> dict[str, Any]:
    free = report.pooled_row(output)
    one = None
    if "one step" in report.modes:
        one = report.pooled_row(output, mode="one step")
    return {"free": free, "one": one, "factor": _factor(free, one)}


def _factor(free: Row, one: Row | None) -> float | None:
    """The factor by which the free-run error is larger, where both are known."""
    if one is None or not free.rmse or not one.rmse:
        return None
    factor = free.rmse / one.rmse
    return factor if 0 < factor < float("inf") else None


def _evidence(report: Report, row: Row) -> dict[str, Any]:
    single = [
        r
        for r in report.rows
        if (r.part, r.output, r.mode) == (row.part, row.output, row.mode)
        and r.record != row.record
    ]
    samples = max(row.samples, 1)
    return {
        "row": row,
        "records": len(single),
        "diverged": sum(r.diverged for r in single),
        "limited": row.limited / samples,
        "held": row.held / samples,
        "extrapolated": row.share_outside,
    }


def _ranges(report: Report) -> list[tuple[str, float, float]]:
    """Each scheduling variable's range in training, once."""
    partition = report.partition or {}
    entries = [partition] if "scheduling" in partition else list(partition.values())
    seen = {}
    for entry in entries:
        for name, (low, high) in zip(entry["scheduling"], entry["ranges"], strict=True):
            seen[str(name)] = (str(name), float(low), float(high))
    return list(seen.values())
