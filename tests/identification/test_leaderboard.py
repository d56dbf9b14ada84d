"""The choice among candidates: by paired differences of groups, by share, the best."""

import csv
import dataclasses
import io

import numpy as np
import pytest

from jaxnarx.identification import Candidate, Leaderboard

GROUPS = ("day 1", "day 2", "day 3", "day 4")


def row(number: int, errors, operations: int | None = 10, **more) -> Candidate:
    """A candidate with these errors of the groups, all of one size."""
    squares = np.square(errors or (1.0,))
    made = Candidate(
        "y",
        number,
        "OE",
        f"order {number}",
        free_run=float(np.sqrt(squares.mean())),
        standard_error=0.05,
        groups=tuple(errors),
        operations=operations,
    )
    return dataclasses.replace(made, **more)


def board(*rows: Candidate, rule: str = "near") -> Leaderboard:
    return Leaderboard(rows, GROUPS, rule)


BEST = row(1, (0.60, 0.50, 0.70, 0.90), 100)


def test_worse_by_chance_is_near():
    """Better in two groups and worse in two: the cheaper one is taken."""
    other = row(2, (0.63, 0.48, 0.72, 0.89), 10)
    assert other.free_run is not None and BEST.free_run is not None
    assert other.free_run > BEST.free_run
    assert board(BEST, other).best("y") == BEST
    assert board(BEST, other).choose("y") == other


def test_of_equals_one_that_forgets_its_past_is_chosen():
    slow = row(2, (0.63, 0.48, 0.72, 0.89), 10, pole=1.019)
    assert board(BEST, slow).choose("y") == BEST
    faster = dataclasses.replace(slow, pole=0.98)
    assert board(BEST, faster).choose("y") == faster
    alone = dataclasses.replace(BEST, pole=1.2)
    assert board(alone, slow).choose("y") == slow


def test_of_equals_one_that_is_proven_bounded_is_chosen():
    cheap = row(2, (0.63, 0.48, 0.72, 0.89), 10, bounded=False)
    proven = dataclasses.replace(BEST, bounded=True)
    assert board(proven, cheap).choose("y") == proven
    assert board(BEST, cheap).choose("y") == cheap
    both = dataclasses.replace(cheap, bounded=True)
    assert board(proven, both).choose("y") == both


def test_worse_everywhere_is_not_near_though_groups_differ_more():
    """By a little in every group: less than groups differ, but it is no chance."""
    other = row(2, (0.61, 0.51, 0.72, 0.91), 10, standard_error=0.5)
    assert board(BEST, other).choose("y") == BEST


def paired(mine: Candidate, best: Candidate) -> bool:
    """Mean difference of squares within its standard error, as in a paired test, and
    not more than 5 % worse."""
    a, b = (np.array(one.groups, float) ** 2 for one in (mine, best))
    by_chance = (a - b).mean() <= (a - b).std(ddof=1) / np.sqrt(len(a))
    return bool(by_chance and a.mean() <= 1.05**2 * b.mean())


def test_near_is_a_paired_difference_within_its_standard_error():
    rng = np.random.default_rng(0)
    told = []
    for n in range(200):
        errors = np.abs(np.array(BEST.groups) + rng.normal(0.01, 0.03, 4))
        other = row(2, errors.tolist(), 10)
        if other.free_run is None or other.free_run < (BEST.free_run or 0.0):
            continue
        told.append(paired(other, BEST))
        expected = other if told[-1] else BEST
        assert board(BEST, other).choose("y") == expected, n
    assert 5 < sum(told) < len(told) - 5


def test_more_than_five_per_cent_are_no_chance():
    """Two groups alone: the standard error is large."""
    best = row(1, (0.1, 0.4), 100)
    other = row(2, (0.05, 0.44), 10)
    assert other.free_run and best.free_run and other.free_run > 1.05 * best.free_run
    assert board(best, other).choose("y") == best


def test_of_those_near_the_cheapest_and_of_equal_ones_the_better():
    near = [row(n, (0.63, 0.48, 0.72, 0.895), cost) for n, cost in ((2, 50), (3, 20))]
    worse = row(4, (0.63, 0.48, 0.721, 0.895), 20)
    assert board(BEST, *near, worse).choose("y") == near[1]
    # What has no number of operations is no bargain.
    unknown = dataclasses.replace(near[1], operations=None)
    assert board(BEST, unknown).choose("y") == BEST


def test_groups_that_one_of_them_lacks_are_left_out():
    short = row(1, (0.10, 0.40), 100, groups=(0.10, None, 0.40, None))
    other = row(2, (0.11, 0.41), 10, groups=(0.11, 0.0, 0.41, 0.0))
    assert board(short, other).choose("y") == short
    # One pair has no spread: the standard error that the best tells of itself counts.
    alone = row(1, (0.4,), 100, groups=(0.4, None), standard_error=0.01)
    far = row(2, (0.411,), groups=(None, 0.1))
    close = row(2, (0.409,), groups=(None, 0.1))
    assert board(alone, far).choose("y") == alone
    assert board(alone, close).choose("y") == close


def test_share_is_within_five_per_cent():
    exact = row(1, (0.2,) * 4, 100)
    within, beyond = row(2, (0.2099,) * 4, 20), row(3, (0.2101,) * 4, 5)
    assert board(exact, within, beyond, rule="share").choose("y") == within
    assert board(exact, beyond, rule="share").choose("y") == exact
    # By pairs neither would be near.
    assert board(exact, within, beyond).choose("y") == exact


def test_best_is_the_smallest_error_whatever_it_costs():
    other = row(2, (0.63, 0.48, 0.72, 0.91), 1)
    assert board(other, BEST, rule="best").choose("y") == BEST


@pytest.mark.parametrize("rule", ["near", "share", "best"])
def test_vetoed_ones_are_never_chosen_and_come_last(rule):
    wild = row(2, (0.01,) * 4, 1, free_run=None, status="diverged", diverged=1)
    failed = row(3, (), 1, free_run=None, status="failed")
    skipped = row(4, (0.01,) * 4, 1, status="skipped")
    found = board(wild, failed, skipped, BEST, rule=rule)
    assert found.choose("y") == found.best("y") == BEST
    assert found.of("y")[0] == BEST and len(found.of("y")) == 4
    nothing = board(wild, failed, skipped, rule=rule)
    assert nothing.choose("y") is None and nothing.best("y") is None
    assert board(rule=rule).choose("y") is None


def test_order_of_rows_does_not_matter():
    rows = [
        row(n, [e + 0.01 * n * (-1) ** n for e in BEST.groups], 9 - n) for n in range(4)
    ]
    rows.append(BEST)
    expected = board(*rows).of("y")
    for turn in range(1, 5):
        turned = board(*rows[turn:], *rows[:turn])
        assert turned.of("y") == expected
        assert turned.choose("y") == board(*rows).choose("y")


def test_outputs_are_ranked_apart():
    other = dataclasses.replace(row(101, (0.01,) * 4), output="w")
    found = board(BEST, other)
    assert (
        found.outputs == ["y", "w"] and len(found) == 2 and list(found) == [BEST, other]
    )
    assert found.choose("y") == BEST and found.choose("w") == other
    assert found.choose("z") is None and found.of("z") == []


UNEVEN = row(1, (0.20, 0.20, 0.20, 2.0), 100)
"""One group has all but three per cent of the loss."""


def test_where_one_group_has_most_of_the_loss_all_groups_count():
    """By pairs the other is a little worse in the group that decides, by chance."""
    name, share = board(UNEVEN).dominant_group("y") or ("", 0.0)
    assert name == "day 4" and share == pytest.approx(4.0 / 4.12)
    better = row(2, (0.12, 0.13, 0.12, 2.04), 500)
    assert better.free_run and UNEVEN.free_run and better.free_run > UNEVEN.free_run
    assert board(UNEVEN, better).best("y") == UNEVEN
    assert board(UNEVEN, better).choose("y") == better
    cheap = row(3, (0.125, 0.135, 0.125, 2.04), 50)
    assert board(UNEVEN, better, cheap).choose("y") == cheap
    assert board(UNEVEN, better, rule="best").choose("y") == UNEVEN
    assert board(UNEVEN, better, rule="share").choose("y") == UNEVEN


def test_beyond_a_standard_error_no_mean_over_groups_helps():
    worse = row(2, (0.22, 0.22, 0.22, 2.2), 10)
    assert board(UNEVEN, worse).choose("y") == UNEVEN
    # Not even where its geometric mean is the smallest: it is surely worse here.
    surely = row(3, (1.0, 1.0, 1.0, 2.3), 10)
    assert board(UNEVEN, surely).choose("y") == UNEVEN


def test_two_groups_or_even_ones_do_not_disagree():
    assert board(BEST).dominant_group("y") is None
    assert board(row(1, (0.1, 2.0))).dominant_group("y") is None
    assert board(row(1, (0.0,) * 4)).dominant_group("y") is None
    assert board().dominant_group("y") is None


def test_a_candidate_that_breaks_its_promise_comes_last():
    """Of three nested errors, where more than four times the promise is too much."""
    first, second = row(1, (0.1,) * 4, 100), row(2, (0.12,) * 4, 200)
    broken = dataclasses.replace(first, nested=0.41)
    assert dataclasses.replace(first, nested=0.4).keeps_promise
    assert not broken.keeps_promise
    for rule in ("near", "share", "best"):
        assert board(first, second, rule=rule).choose("y") == first
        assert board(broken, second, rule=rule).choose("y") == second
    assert [one.number for one in board(broken, second).of("y")] == [2, 1]
    # If the other one is worse still, the smallest nested error decides.
    for nested, chosen in ((0.3, 2), (0.47, 1), (0.9, 1)):
        judged = dataclasses.replace(second, nested=nested)
        found = board(broken, judged).choose("y")
        assert found is not None and found.number == chosen
    assert board(broken).choose("y") == broken


def test_of_the_choice_and_cheaper_ones_the_smallest_nested_error_decides():
    best = row(0, (0.10, 0.20, 0.30), 50)
    plain = row(1, (0.15, 0.15, 0.33), 10)
    assert board(best, plain).choose("y") == best
    assert board(best, plain).simplest("y") == plain
    judged = [
        dataclasses.replace(one, nested=nested, nested_groups=(nested,) * 3)
        for one, nested in ((best, 0.4), (plain, 0.3))
    ]
    assert board(*judged).choose("y") == judged[1]
    assert board(judged[0], plain).choose("y") == judged[0]
    assert board(best, judged[1]).choose("y") == best
    worse = dataclasses.replace(judged[1], nested=0.41)
    assert board(judged[0], worse).choose("y") == judged[0]
    assert board(*judged, rule="best").choose("y") == judged[1]
    dearer = dataclasses.replace(judged[1], operations=60)
    assert board(judged[0], dearer, rule="best").choose("y") == judged[0]
    assert board(*judged, rule="share").simplest("y") is None


def test_worst_group():
    assert board().worst_group(BEST) == ("day 4", 0.9)
    some = dataclasses.replace(BEST, groups=(None, 0.5, None, None))
    assert board().worst_group(some) == ("day 2", 0.5)
    assert board().worst_group(dataclasses.replace(BEST, groups=())) is None
    assert board().worst_group(dataclasses.replace(BEST, groups=(None,) * 4)) is None


def test_table_of_commas():
    wild = row(2, (0.1, 0.2), 1, free_run=None, status="diverged", diverged=3)
    wild = dataclasses.replace(wild, name='lags "1", 2', detail="runs away, twice")
    found = board(wild, BEST)
    head, *lines = csv.reader(io.StringIO(found.to_csv()))
    table = [dict(zip(head, line, strict=True)) for line in lines]
    assert [line["number"] for line in table] == ["1", "2"]
    assert [line["rank"] for line in table] == ["1", "2"]
    assert [line["chosen"] for line in table] == ["1", "0"]
    assert float(table[0]["free_run"]) == BEST.free_run
    assert (table[0]["worst_group"], table[0]["worst_group_error"]) == ("day 4", "0.9")
    assert table[1]["free_run"] == "" and table[1]["diverged"] == "3"
    assert (
        table[1]["name"] == 'lags "1", 2' and table[1]["detail"] == "runs away, twice"
    )
    assert found.to_csv().endswith("\n") and "\r" not in found.to_csv()
    (alone,) = csv.reader(io.StringIO(board().to_csv()))
    assert alone == head


def test_a_row_there_and_back():
    wild = dataclasses.replace(BEST, groups=(0.1, None), free_run=None)
    for one in (BEST, wild):
        table = one.to_dict()
        assert Candidate.from_dict(table) == one
        assert Candidate.from_dict(table | {"groups": list(one.groups)}) == one
    assert BEST.eligible and not wild.eligible
    assert not dataclasses.replace(BEST, status="failed").eligible


def test_a_spreadsheet_takes_no_name_for_a_formula():
    told = row(1, (0.1, 0.2), name="=HYPERLINK(1)", output="@y", detail="+1")
    cells = next(csv.DictReader(io.StringIO(board(told).to_csv())))
    assert [cells[k] for k in ("output", "name", "detail")] == [
        "'@y",
        "'=HYPERLINK(1)",
        "'+1",
    ]
