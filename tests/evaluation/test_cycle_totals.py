"""Cycle totals: errors of sums over records, beside sums taken sample by sample."""

import dataclasses
import json
import math

import numpy as np
import pytest
from verdict_problems import made, row

from jaxnarx.data import Channel
from jaxnarx.evaluation.rows import CANCELLED_SUM_SHARE, FREE_RUN, ScoredSamples, score

NOX = Channel("NOx", "g/s")


def record(name, measured, simulated, counts=None, diverged=False) -> ScoredSamples:
    y, yhat = (np.array(x, float)[:, None] for x in (measured, simulated))
    scored = np.ones_like(y, bool)
    if counts is not None:
        scored = np.array(counts, bool)[:, None]
    none = np.zeros_like(scored)
    flags = dict(limited=none, held=none, extrapolated=none[:, 0])
    return ScoredSamples(name, y, yhat, scored, **flags, diverged=diverged, short=False)


def by_hand(*records: ScoredSamples) -> float:
    """In percent of the measured sum, one sample after the other."""
    measured = simulated = 0.0
    for one in records:
        for t in range(len(one.measured)):
            if one.scored[t, 0]:
                measured += one.measured[t, 0]
                simulated += one.predicted[t, 0]
    return 100 * (simulated - measured) / abs(measured)


def totals(*records: ScoredSamples) -> list[float | None]:
    """Of all records together, then of each."""
    return [r.total_error for r in score("test", FREE_RUN, NOX, list(records))]


SOME = record("a", [1, 2, 3, 4], [9, 2, 3, 6], [0, 1, 1, 1])
OTHER = record("b", [10, 20, 30], [8, 20, 29])


def test_they_are_the_sums_taken_by_hand():
    """9 measured and 11 simulated in one record, 60 and 57 in the other."""
    assert totals(SOME, OTHER) == pytest.approx([-100 / 69, 200 / 9, -5.0], rel=1e-12)
    want = [by_hand(SOME, OTHER), by_hand(SOME), by_hand(OTHER)]
    assert totals(SOME, OTHER) == pytest.approx(want, rel=1e-12)


def test_what_does_not_count_has_no_influence():
    """Gaps in what is measured, and samples without history."""
    gap = record("a", [np.nan, 2, 3, 4], [np.inf, 2, 3, 6], [0, 1, 1, 1])
    assert totals(gap) == totals(SOME)


def test_the_sign_is_that_of_simulated_minus_measured():
    """Of negative sums as well: less drag than measured is less, not more."""
    drag = record("a", [-2, -4], [-1, -4])
    assert totals(drag)[1] == pytest.approx(100 / 6)
    double = record("a", 2 * OTHER.measured[:, 0], 2 * OTHER.predicted[:, 0])
    assert totals(double) == pytest.approx(totals(OTHER))


def test_sums_that_cancel_have_no_relative_error():
    ripple = [1.0, -1.0, 2.0, -2.0]
    zero = record("b", [0.0] * 4, [1.0] * 4)
    for one in (record("a", ripple, [1.0] * 4), zero):
        (pooled, single) = score("test", FREE_RUN, NOX, [one])
        assert pooled.total_error is None and single.total_error is None
        assert single.offset is not None
    edge = (
        1 + CANCELLED_SUM_SHARE
    )  # over 1 - CANCELLED, the sum is that share of magnitudes
    assert (
        totals(record("a", [edge * 1.01, CANCELLED_SUM_SHARE - 1], [1, 1]))[0]
        is not None
    )
    assert (
        totals(record("a", [edge * 0.99, CANCELLED_SUM_SHARE - 1], [1, 1]))[0] is None
    )


def test_a_record_without_samples_or_that_diverged_has_none():
    empty = record("a", [1, 2], [1, 2], [0, 0])
    assert totals(empty) == [None, None]
    assert totals(OTHER, empty) == [totals(OTHER)[0], totals(OTHER)[1], None]
    lost = record("c", [1, 2], [1, np.nan], diverged=True)
    assert totals(OTHER, lost) == [None, totals(OTHER)[0], None]


def test_table_and_json_show_them():
    lost = record("c", [1, 2], [1e300, np.inf], diverged=True)
    rows = score("test", FREE_RUN, NOX, [SOME, OTHER, lost])
    report = dataclasses.replace(made(*rows), outputs=(NOX,))
    lines = [line.split() for line in report.table.splitlines()]
    (told,) = [words for words in lines if words[:1] == ["b"]]
    (header,) = [words for words in lines if words[:1] == ["record"]]
    assert told[-2] == "-5.00" and header[-4:-2] == ["total", "%"]
    assert "nan" not in report.table
    found = json.loads(json.dumps(report.to_dict(), allow_nan=False))["rows"]
    shown = {r["record"]: r["total_error"] for r in found}
    assert shown["pooled"] is None and shown["c"] is None
    assert shown["b"] == pytest.approx(-5.0) and not math.isnan(shown["a"])


# the remark -----------------------------------------------------------------------


def remarks(*errors, main="test", unit="g/s", **more):
    more["unit"] = unit
    rows = [row(main, f"r{n}", total_error=e, **more) for n, e in enumerate(errors)]
    return made(row(main, total_error=1.0), *rows, main=main).verdict.remarks


def test_the_remark_tells_mean_and_range_and_what_they_are():
    (remark,) = remarks(-3.0, 2.0, 4.0)
    assert (
        "test data, simulated minus measured: T +1 % in the mean, -3 to +4 %" in remark
    )
    assert "over 3 records" in remark and "no prediction interval" in remark
    assert "T -3 % in 1 of 2 records" in remarks(-3.0, None)[0]
    assert "T -3 % in 1 record (" in remarks(-3.0)[0]


@pytest.mark.parametrize("unit", ["K", "degC", "kPa", "rpm"])
def test_a_level_has_no_cycle_total(unit):
    assert remarks(-3.0, 2.0, unit=unit) == ()


def test_no_remark_without_totals_or_on_records_of_the_training():
    assert remarks(None, None) == () and remarks(1.0, 2.0, main="train") == ()


def test_the_remark_names_the_outputs_that_are_furthest_off():
    rows = [
        row("test", "r", output=f"y{n}", unit="g/s", total_error=float(n) * (-1) ** n)
        for n in range(7)
    ]
    (remark,) = made(row("test"), *rows).verdict.remarks
    assert remark.index("y6") < remark.index("y5") < remark.index("y3")
    assert "y2" not in remark and "; 3 more outputs" in remark


def test_totals_change_no_verdict():
    far = made(row("test"), row("test", "r0", total_error=80.0)).verdict
    assert far.level == "good" and not far.findings
