"""What a leaderboard says, in words and as plain tables."""

import dataclasses
import json

import pytest
from search_fakes import board, row

from jaxnarx.identification import (
    Leaderboard,
    candidate_in_use,
    describe,
    figure,
    sentences,
)
from jaxnarx.identification.explain import _price, pareto, safest
from jaxnarx.identification.leaderboard import Candidate


def test_the_choice_and_what_others_cost():
    told = sentences(board("y"), "y")
    assert told[0].startswith("y: 3 (polynomial: degree 2), free run 0.200 ± 0.020")
    assert "within one standard error" in told[0]
    assert told[1] == (
        "The best itself, 4 (shared feedback: 2 regions), takes 2.2 times the "
        "operations and has 2.5% less error (by 0.0059 ± 0.025, group by group)."
    )
    assert "2 (ARX: order 1), has 1.50 times the error (0.300 ± 0.020)" in told[2]
    assert told[3] == "1 of 5 candidates diverges on records left out: vetoed."
    assert told[4] == "No group stands out (0.18 to 0.22)."


def test_a_group_with_most_of_the_loss_is_named_and_explains_the_choice():
    names = ("day 1", "day 2", "day 3")
    uneven = dataclasses.replace(row(1), groups=(0.1, 0.1, 0.9))
    told = sentences(Leaderboard((uneven,), names), "y")
    assert "geometric mean over groups is within 5 % of the least" in told[0]
    assert told[-1].startswith("The group day 3 has 98% of the loss. Look at its rec")
    even = dataclasses.replace(uneven, groups=(0.5, 0.5, 0.6))
    assert "has most of" not in " ".join(sentences(Leaderboard((even,), names), "y"))


def test_nearly_as_many_operations_are_as_many():
    def dearer(operations: int) -> str:
        best = dataclasses.replace(row(1), operations=operations)
        return _price(best, dataclasses.replace(row(0), operations=100))

    assert "takes as many operations" in dearer(101)
    assert "takes 1.1 times the operations" in dearer(110)


def test_the_rules_have_words_of_their_own():
    best = sentences(board("y", rule="best"), "y")
    assert best[0].startswith("y: 4") and "the smallest error" in best[0]
    assert "within 5 % of the best" in sentences(board("y", rule="share"), "y")[0]


def test_the_best_that_is_also_the_cheapest_is_called_that():
    found = Leaderboard((row(0), row(1)), ("day 1", "day 2"))
    told = sentences(found, "y")
    assert (
        "the best, and none within its standard error is as safe and cheaper" in told[0]
    )
    assert len(told) == 2  # no other family, and no better model that is not linear


def test_one_taken_by_hand_stands_beside_the_chosen():
    told = sentences(board("y"), "y", 2)
    assert "chosen by hand in place of 3 (polynomial: degree 2), 0.200" in told[0]
    assert describe(board("y"), "y", 2)["used"] == 2
    assert candidate_in_use(board("y"), "y", 2).family == "ARX"


def test_a_group_that_is_served_badly_is_named():
    bad = dataclasses.replace(row(2), groups=(0.1, 0.4), free_run=0.25)
    told = sentences(Leaderboard((bad,), ("day 1", "day 2")), "y")
    assert "group day 2: 0.4, 1.6 times" in told[-1]
    assert "Look at its records first" in told[-1]


def test_where_all_are_vetoed_the_mean_is_the_safest():
    lost = dict(free_run=None, status="diverged", diverged=1)
    rows = [dataclasses.replace(row(k), **lost) for k in (1, 0, 2)]
    found = Leaderboard(tuple(rows), ("day 1", "day 2"))
    assert safest(found, "y").family == "constant"
    assert safest(Leaderboard((rows[0],)), "y").family == "ARX"
    assert "Every candidate is vetoed" in sentences(found, "y")[0]
    assert describe(found, "y")["chosen"] is None


def test_the_front_falls_with_the_cost():
    front = pareto(board("y"), "y")
    assert [r.number for r in front] == [1, 2, 3, 4]
    dear = dataclasses.replace(row(2, number=9), operations=15)
    found = dataclasses.replace(board("y"), rows=(*board("y").rows, dear))
    assert 9 not in [r.number for r in pareto(found, "y")]


def test_plain_tables_are_json():
    text = json.dumps(describe(board("y", "w"), "w"), allow_nan=False)
    rows = json.loads(text)["rows"]
    assert [r["rank"] for r in rows] == [1, 2, 3, 4, 5]
    assert [r["used"] for r in rows] == [False, True, False, False, False]
    assert rows[2]["linear"] and rows[-1]["status"] == "diverged"
    assert rows[1]["worst_group"] == "day 2" and rows[-1]["worst_group"] == "day 1"


@pytest.mark.parametrize(
    ("error", "spread", "text"),
    [
        (0.123456, 0.0123, "0.123 ± 0.012"),
        (1.5, 0.4, "1.50 ± 0.40"),
        (12.0, 30.0, "12 ± 30"),
        (9.4e-17, 3e-18, "9.4e-17 ± 3e-18"),
        (0.5, None, "0.5"),
        (0.0, 0.0, "0"),
        (None, None, "skipped"),
    ],
)
def test_figures_have_the_digits_that_their_error_leaves(error, spread, text):
    one = Candidate("y", 1, "OE", "order 1", free_run=error, standard_error=spread)
    assert figure(dataclasses.replace(one, status="skipped")) == text
