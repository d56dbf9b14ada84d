"""Tables of sweeps: columns, best of groups, fronts, paired comparisons."""

import numpy as np
import pytest

from jaxnarx.errors import SpecError
from jaxnarx.sweep import (
    SweepTable,
    best_per_group,
    paired_comparison,
    pareto_front,
    summary,
)


def rows():
    """Six engines, identified without and with refinement; two fits diverge."""
    before = [1.0, 2.0, 4.0, 8.0, 1.0, 3.0]
    after = [0.5, 1.0, 6.0, 2.0, None, 3.0]
    for i, (x, y) in enumerate(zip(before, after, strict=True)):
        for train, error in (("none", x), ("joint", y)):
            yield {
                "engine": f"e{i // 2}",
                "start": i % 2,
                "train": train,
                "status": "diverged" if error is None else "budget_spent",
                "error": error,
                "terms": ["u", "y"][: 1 + i % 2],
                "count": 4 + i,
            }


@pytest.fixture(scope="module")
def table():
    return SweepTable.from_rows(list(rows()))


def compare(table, **options):
    options = {"pair": ["engine", "start"], "factor": "train", "by": "error", **options}
    return paired_comparison(table, **options)


def test_columns_keep_their_kind_and_nulls_are_nan(table):
    assert table.column("count").dtype == np.int64
    assert table.column("error").dtype == np.float64
    assert np.flatnonzero(np.isnan(table.column("error"))).tolist() == [9]
    assert table.column("terms")[2:4].tolist() == [["u", "y"], ["u", "y"]]
    assert table.column("engine")[0] == "e0"
    assert list(table.rows())[0]["status"] == "budget_spent"
    assert table.numbers("count").dtype == np.float64
    assert np.flatnonzero(~table.okay).tolist() == [9]
    with pytest.raises(SpecError, match="no column 'eror'. Did you mean 'error'"):
        table.column("eror")
    with pytest.raises(SpecError, match="does not hold numbers"):
        table.numbers("engine")


def test_rows_are_chosen_by_label_and_by_mask(table):
    assert len(table.where(engine="e1", train="joint")) == 2
    assert len(table.where(engine=["e0", "e2"], start=0)) == 4
    assert len(table.where(engine="nobody")) == 0
    assert table.take(table.column("count") > 8).column("start").tolist() == [1, 1]
    assert table.take(np.array([5, 0])).column("train").tolist() == ["joint", "none"]
    with pytest.raises(SpecError, match="a mask of 3 for 12 rows"):
        table.take(np.ones(3, bool))


def test_a_table_becomes_a_pandas_frame(table):
    pytest.importorskip("pandas")
    assert table.to_pandas().shape == (12, 7)


def test_counts_of_statuses_come_in_the_order_of_the_table(table):
    assert list(summary(table).items()) == [("budget_spent", 11), ("diverged", 1)]


def test_the_best_of_each_group(table):
    best = best_per_group(table, "engine", "error")
    assert best.column("engine").tolist() == ["e0", "e1", "e2"]
    assert best.column("error").tolist() == [0.5, 2.0, 1.0]
    worst = best_per_group(table, ["engine", "train"], "error", smallest=False)
    assert worst.column("error").tolist() == [2.0, 1.0, 8.0, 6.0, 3.0, 3.0]


def test_infinite_rows_are_never_the_best_and_a_status_is_no_score():
    """A status may tell of test records, which a choice by validation must not know."""
    table = SweepTable.from_rows(
        [
            {"engine": "a", "status": "ok", "error": 2.5},
            {"engine": "a", "status": "ok", "error": float("inf")},
            {"engine": "a", "status": "diverged", "error": 2.0},
            {"engine": "b", "status": "crashed", "error": None},
        ]
    )
    assert best_per_group(table, "engine", "error").column("error").tolist() == [2.0]
    assert pareto_front(table, ["error"]).column("error").tolist() == [2.0]


def test_the_front_of_two_scores(table):
    front = pareto_front(table, ["count", "error"])
    assert front.column("count").tolist() == [4]
    assert front.column("error").tolist() == [0.5]
    front = pareto_front(table.where(train="none"), ["error", "start"])
    assert front.column("error").tolist() == [1.0, 1.0]


def test_pairs_are_compared_by_hand(table):
    found = compare(table)
    assert found.levels == ("none", "joint")
    assert found.before.tolist() == [1, 2, 4, 8, 3]
    assert found.after.tolist() == [0.5, 1, 6, 2, 3]
    assert found.difference.value == -0.5  # of -0.5, -1, 2, -6, 0
    assert found.ratio.value == 0.5  # of 0.5, 0.5, 1.5, 0.25, 1
    assert found.improved.value == 3 / 5
    failures = (found.failed_before, found.failed_after, found.failed_both)
    assert failures == (0, 1, 0) and found.unpaired == 0
    assert found.worst == {"engine": "e1", "start": 0, "before": 4.0, "after": 6.0}
    assert "worst: engine e1, start 0" in str(found)


def test_levels_turn_the_comparison_round(table):
    found = compare(table, levels=("joint", "none"))
    assert found.ratio.value == 2.0
    assert (found.failed_before, found.failed_after) == (1, 0)


def test_rows_without_a_partner_are_counted(table):
    kept = table.take(np.arange(12) != 3)
    assert compare(kept).unpaired == 1
    assert len(compare(kept).before) == 4


def test_the_interval_covers_as_often_as_it_says():
    # Binomial: of 200 intervals that cover 95 %, 178 to 199 do with probability
    # 1 - 1e-3; the percentile interval of a share of 40 is a little too short.
    random, hits = np.random.default_rng(3), 0
    for seed in range(200):
        better = random.random(40) < 0.7
        data = [
            {"n": n, "f": f, "status": "ok", "e": 1.0 if f else 1.5 - b}
            for n, b in enumerate(better)
            for f in (1, 0)
        ]
        found = paired_comparison(
            SweepTable.from_rows(data), pair=["n"], factor="f", by="e", seed=seed
        )
        hits += found.improved.low <= 0.7 <= found.improved.high
    assert 176 <= hits <= 199


def test_whole_blocks_are_resampled():
    # Ten copies of three engines know no more than three engines.
    data = [
        {"engine": n, "start": s, "f": f, "status": "ok", "e": 1.0 + f * (n - 0.5)}
        for n in range(3)
        for s in range(10)
        for f in (0, 1)
    ]
    table = SweepTable.from_rows(data)
    options = {"pair": ["engine", "start"], "factor": "f", "by": "e"}
    free = paired_comparison(table, **options).improved
    tied = paired_comparison(table, **options, block="engine").improved
    assert free.value == tied.value == pytest.approx(1 / 3)
    assert (tied.low, tied.high) == (0.0, 1.0)
    assert 0.1 < free.low and free.high < 0.6


def test_scores_that_are_not_positive_have_no_ratio():
    data = [
        {"n": n, "f": f, "status": "ok", "e": float(n - f)}
        for n in (0, 1)
        for f in (0, 1)
    ]
    found = paired_comparison(
        SweepTable.from_rows(data), pair=["n"], factor="f", by="e"
    )
    assert np.isnan(found.ratio.value) and found.difference.value == -1.0
    assert found.worst["n"] == 0


def test_the_seed_fixes_the_interval(table):
    assert compare(table, seed=1).difference == compare(table, seed=1).difference


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"pair": ["engine"]}, "rows 0 and 2 have equal labels"),
        ({"factor": "count"}, "levels must be two of what count holds: 4, 5"),
        ({"levels": ("none", "all")}, "levels must be two of what train holds"),
        ({"pair": ["name"]}, "no column 'name'"),
    ],
)
def test_wrong_pairs_are_refused(table, options, words):
    with pytest.raises(SpecError, match=words):
        compare(table, **options)


def test_no_pair_left_is_refused(table):
    with pytest.raises(SpecError, match="no pair of train"):
        compare(table.where(engine="e2", start=0))
