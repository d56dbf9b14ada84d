"""The first lines of a page: how good, how stable, and where it can be trusted."""

from typing import Any

from jaxnarx.evaluation import Report, Row

NOTICEABLE = 0.01
"""Share of samples from which leaving the range or the bound is flagged."""


def verdict(report: Report) -> dict[str, Any]:
    """Badges (kind, text), one card per output, and a line of trust per part."""
    cards = [_card(report, channel.name) for channel in report.outputs]
    trust = [
        _trust(report, report.pooled(channel.name, part=part))
        for part in report.parts
        for channel in report.outputs
    ]
    return {
        "badges": _badges(report, cards, trust),
        "cards": cards,
        "trust": trust,
        "ranges": _ranges(report),
    }


def _card(report: Report, output: str) -> dict[str, Any]:
    free = report.pooled(output)
    one = None
    if "one step" in report.modes:
        one = report.pooled(output, mode="one step")
    return {"free": free, "one": one, "factor": _factor(free, one)}


def _factor(free: Row, one: Row | None) -> float | None:
    """How many times larger the free-run error is, where both are known."""
    if one is None or not free.rmse or not one.rmse:
        return None
    factor = free.rmse / one.rmse
    return factor if 0 < factor < float("inf") else None


def _trust(report: Report, row: Row) -> dict[str, Any]:
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
        "extrapolated": row.extrapolated / samples,
    }


def _badges(
    report: Report, cards: list[dict[str, Any]], trust: list[dict[str, Any]]
) -> list[tuple[str, str]]:
    main = [t for t in trust if t["row"].part == report.main]
    lost = max((t["diverged"] for t in main), default=0)
    records = max((t["records"] for t in main), default=0)
    badges = [
        ("bad", f"free run diverged in {lost} of {records} records")
        if lost
        else ("good", "free run stayed bounded")
    ]
    loud = any("EQUALS ESTIMATION" in n for n in report.notes)
    if loud:
        badges.append(("bad", "validated on its own training data"))
    elif report.main == "test" and "train" in report.parts:
        badges.append(("good", "test records apart from training"))
    elif report.main != "test":
        badges.append(("warn", "no separate test data"))
    outside = max((t["extrapolated"] for t in main), default=0.0)
    if outside >= NOTICEABLE:
        badges.append(("warn", f"{outside:.0%} of samples outside the trained range"))
    limited = max((t["limited"] for t in main), default=0.0)
    if limited >= NOTICEABLE and not lost:
        badges.append(("warn", f"feedback limited at {limited:.0%} of samples"))
    if any(c["free"].status == "constant output" for c in cards):
        badges.append(("warn", "constant output"))
    return badges


def _ranges(report: Report) -> list[tuple[str, float, float]]:
    """Each scheduling variable's range in training, once."""
    partition = report.partition or {}
    entries = [partition] if "scheduling" in partition else list(partition.values())
    seen = {}
    for entry in entries:
        for name, (low, high) in zip(entry["scheduling"], entry["ranges"], strict=True):
            seen[str(name)] = (str(name), float(low), float(high))
    return list(seen.values())
