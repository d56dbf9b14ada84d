"""What is left out together: dealing, blocks and gaps, what a fold trains and scores.

Models are run on folds in `tests/test_folds.py`.
"""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_repeated_cycles import staircase

from jaxnarx.data import Dataset, Groups, groups
from jaxnarx.data._groups import block_labels
from jaxnarx.errors import DataError, SpecError


def records(*rows: int, again: dict[int, int] | None = None, seed: int = 0) -> Dataset:
    """Independent random steps of these lengths; those of `again` repeat another."""
    rng = np.random.default_rng(seed)
    us = [staircase(rng, n) for n in rows]
    for k, like in (again or {}).items():
        us[k] = us[like][: rows[k]] + 0.05 * rng.standard_normal((rows[k], 2))
    return Dataset.from_arrays(
        us,
        [np.arange(len(u), dtype=float)[:, None] + 0.5 for u in us],
        inputs=["a", "b"],
        outputs=["y"],
        sample_time=0.1,
        names=[f"r{n}" for n in range(len(rows))],
    )


def members(found: Groups) -> list[list[int]]:
    """Records of every group, all of them whole."""
    assert found.whole
    assert all(len(set(label.tolist())) == 1 for label in found.labels)
    of = [int(label[0]) for label in found.labels]
    return [[n for n, g in enumerate(of) if g == k] for k in range(len(found))]


# whole records ----------------------------------------------------------------------


def test_records_that_repeat_each_other_are_in_one_group():
    data = records(*[200] * 10, again={n + 5: n for n in range(5)})
    found = groups(data)
    assert members(found) == [[n, n + 5] for n in range(5)]
    assert found.names[2] == "r2, r7"
    for g, fold in enumerate(found.folds(data)):
        assert fold.name == f"r{g}, r{g + 5}" and fold.left.names == [
            f"r{g}",
            f"r{g + 5}",
        ]
        assert fold.train.names == [n for n in data.names if n not in fold.left.names]
        parts = (*fold.train, *fold.left)
        assert all(any(r is own for own in data) for r in parts)
        assert fold.train.channels == data.channels


@settings(max_examples=30, deadline=None, database=None, derandomize=True)
@given(st.lists(st.integers(30, 400), min_size=3, max_size=12), st.integers(2, 6))
def test_the_largest_goes_where_there_is_least(rows, folds):
    data = records(*rows)
    found = groups(data, folds=folds)
    if 2 * max(rows) > sum(rows):
        assert not found.whole
        return
    # The rule written out, of components that are all single records.
    own = [0] * min(folds, len(rows))
    sizes = []
    for n in sorted(range(len(rows)), key=lambda n: (-rows[n], n)):
        own[own.index(min(own))] += rows[n]
    for part in members(found):
        assert part
        sizes.append(sum(rows[n] for n in part))
    assert sorted(sizes) == sorted(own)
    again = groups(data, folds=folds)
    assert again.names == found.names


def test_a_record_that_holds_over_half_of_the_samples_is_cut():
    assert groups(records(300, 200, 101)).whole
    assert not groups(records(303, 200, 101)).whole


# named ------------------------------------------------------------------------------


def test_named_groups_stay_and_others_are_found():
    data = records(*[200] * 7, again={6: 5})
    found = groups(data, named={"cold": ["r1", "r4"]}, folds=3)
    assert found.names[0] == "cold" and members(found)[0] == [1, 4]
    assert members(found)[1:] == [[0, 2], [3, 5, 6]]
    # Named all by themselves, they do not follow what their inputs say.
    named = {"a": ["r0", "r1", "r2", "r5"], "b": ["r3", "r4", "r6"]}
    assert members(groups(data, named=named)) == [[0, 1, 2, 5], [3, 4, 6]]


def test_records_say_themselves_what_they_belong_to():
    data = records(*[200] * 4)
    own = tuple(
        dataclasses.replace(r, group=g)
        for r, g in zip(data, ["x", "", "x", "y"], strict=True)
    )
    data = dataclasses.replace(data, records=own)
    assert groups(data).names == ("x", "y", "r1")
    assert members(groups(data)) == [[0, 2], [3], [1]]
    assert members(groups(data, named={})) == [[0], [1], [2], [3]]


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ({"a": ["r0", "r1"], "b": ["r1"]}, "r1 is in the groups 'a' and 'b'"),
        ({"a": ["r0", "r7"]}, "the group 'a' names 'r7'"),
        ({"a": ["r0", "r1", "r2"]}, "'a' holds every record"),
        ({"a": [], "b": ["r1"]}, "'a' names no record"),
    ],
)
def test_names_that_cannot_be_are_refused(named, said):
    with pytest.raises(SpecError, match=said) as caught:
        groups(records(100, 100, 100), named=named)
    assert caught.value.field == "named"


# blocks -----------------------------------------------------------------------------


@settings(max_examples=100, deadline=None, database=None, derandomize=True)
@given(st.integers(80, 400), st.integers(2, 8), st.integers(0, 60))
def test_blocks_are_equal_with_gaps_between(rows, folds, gap):
    label = block_labels(rows, folds, gap)
    sizes = np.bincount(label[label >= 0], minlength=folds)
    assert sizes.max() - sizes.min() <= 1 and sizes.min() >= 0.9 * rows // folds - 1
    runs = np.flatnonzero(np.diff(label)) + 1
    told = [int(part[0]) for part in np.split(label, runs)]
    blocks = [k for k in told if k >= 0]
    assert blocks == list(range(folds))
    cut = min(gap, rows // 10 // (folds - 1))
    assert len(told) == (2 * folds - 1 if cut else folds)
    for part in np.split(label, runs):
        if part[0] < 0:
            assert len(part) == cut


def test_one_record_is_cut_into_blocks():
    data = records(1000)
    found = groups(data, folds=5, gap=10)
    assert not found.whole and len(found) == 5
    assert found.names[0] == "rows 0 to 191 of r0"
    np.testing.assert_array_equal(found.labels[0], block_labels(1000, 5, 10))


def test_records_that_repeat_each_other_are_cut_at_one_place_of_the_cycle():
    data = records(600, 600, 500)
    late = data.records[0]
    late = dataclasses.replace(
        late, u=late.u[20:], y=late.y[20:], valid=late.valid[20:], name="late"
    )
    data = dataclasses.replace(data, records=(data.records[0], late))
    found = groups(data, gap=6)
    np.testing.assert_array_equal(found.labels[1], found.labels[0][20:])
    assert found.names[1] == "rows 121 to 235 of r0, rows 101 to 215 of late"


def test_two_records_that_do_not_repeat_are_both_cut():
    found = groups(records(500, 400), folds=4)
    for label, rows in zip(found.labels, (500, 400), strict=True):
        np.testing.assert_array_equal(label, np.repeat(np.arange(4), rows // 4))


def test_a_record_too_short_to_be_cut_goes_to_one_group():
    data = records(1000, 30, 12)
    found = groups(data, gap=4)
    for label, g in zip(found.labels[1:], (0, 1), strict=True):
        assert set(label.tolist()) == {g}
    assert found.names[0] == "rows 0 to 195 of r0, r1"
    fold = found.fold(data, 0)
    assert fold.train.names == ["r0", "r2"] and fold.left.names == ["r0", "r1"]


@pytest.mark.parametrize("rows", [(49,), (30, 30), (1,), (40, 9, 3)])
def test_records_too_short_for_blocks_are_refused_with_what_to_do(rows):
    with pytest.raises(DataError, match=f"r0, .* has {rows[0]} rows") as caught:
        groups(records(*rows))
    assert "fewer folds" in str(caught.value)
    assert len(groups(records(20, 20), folds=2)) == 2


@pytest.mark.parametrize("options", [{"folds": 1}, {"folds": 0}, {"gap": -1}])
def test_counts_that_cannot_be_are_refused(options):
    with pytest.raises(SpecError) as caught:
        groups(records(100, 100, 100), **options)
    assert caught.value.field in options
    with pytest.raises(SpecError, match="no records"):
        groups(records(100)[:0])


# folds ------------------------------------------------------------------------------


def left_out(label: np.ndarray, g: int) -> np.ndarray:
    """Sample by sample: own ones, and gaps that touch them."""
    out = label == g
    for step in (1, -1):
        for t in range(len(label))[::step]:
            if label[t] == -1 and 0 <= t - step < len(label):
                out[t] |= out[t - step] and label[t] == -1
    return out


def test_a_fold_marks_block_and_gaps_as_missing_in_training():
    data = records(300, 250)
    valid = data.records[0].valid.copy()
    valid[[5, 100], 2] = False
    valid[7, 0] = False
    first = dataclasses.replace(data.records[0], valid=valid)
    data = dataclasses.replace(data, records=(first, data.records[1]))
    found = groups(data, folds=4, gap=7)
    for g, fold in enumerate(found.folds(data)):
        assert fold.train.names == fold.left.names == data.names
        for n, record in enumerate(data):
            out = left_out(found.labels[n], g)
            np.testing.assert_array_equal(found.held_out_samples(g)[n], out)
            assert out.sum() == (found.labels[n] == g).sum() + 7 * (1 + (0 < g < 3))
            train, left = fold.train.records[n], fold.left.records[n]
            np.testing.assert_array_equal(train.u, record.u)
            np.testing.assert_array_equal(train.valid[:, :2], record.valid[:, :2])
            counted = record.valid[:, 2] & ~out
            np.testing.assert_array_equal(train.valid[:, 2], counted)
            np.testing.assert_array_equal(train.y[counted], record.y[counted])
            # What is left out can be read nowhere: it is held from its neighbours.
            assert set(train.y[~counted, 0]) <= set(record.y[counted, 0])
            np.testing.assert_array_equal(left.y, record.y)
            np.testing.assert_array_equal(left.valid, record.valid)
            np.testing.assert_array_equal(left.scored, found.labels[n] == g)
            assert train.scored is None


@pytest.mark.parametrize("gap", [0, 7])
def test_parts_are_groups_and_gaps_by_what_they_are_left_out_with(gap):
    data = records(150, 31)
    found = groups(data, folds=3, gap=gap)
    labels, apart = found.parts()
    for g in range(len(found)):
        expected = found.held_out_samples(g)
        for own, out, judged in zip(labels, expected, found.labels, strict=True):
            np.testing.assert_array_equal(apart[g][own], out)
            np.testing.assert_array_equal(own == g, judged == g)
    assert apart.shape[1] == 3 + (2 if gap else 0)


def test_every_sample_is_judged_once_but_for_the_gaps():
    data = records(300, 250, 40)
    found = groups(data, folds=3, gap=5)
    count = [np.zeros(len(r), int) for r in data]
    for fold in found.folds(data):
        for record in fold.left:
            scored = np.ones(len(record), bool)
            scored = scored if record.scored is None else record.scored
            count[data.names.index(record.name)] += scored
    for label, seen in zip(found.labels, count, strict=True):
        np.testing.assert_array_equal(seen, label >= 0)


def test_groups_serve_the_same_records_with_other_channels_alone():
    data = records(200, 200, 200)
    found = groups(data)
    one = dataclasses.replace(data, channels=data.channels)
    assert found.fold(one, 1).left.names == ["r1"]
    with pytest.raises(SpecError, match="make groups of these data"):
        found.fold(data[:2], 0)


@pytest.mark.parametrize("rows", [(200, 200, 150, 90), (300, 250, 40)])
def test_a_whole_fold_keeps_records_that_train_nothing_without_a_valid_sample(rows):
    data = records(*rows)
    found = groups(data, folds=3, gap=5)
    pairs = zip(found.folds(data), found.folds(data, whole=True), strict=True)
    for fold, kept in pairs:
        assert kept.left.names == fold.left.names
        assert kept.train.names == data.names
        own = dict(zip(fold.train.names, fold.train, strict=True))
        for record in kept.train:
            valid = own[record.name].valid if record.name in own else False
            assert np.all(record.valid == valid)
            assert len(record) == len(data.records[data.names.index(record.name)])


@pytest.mark.parametrize("rows", [(40, 50, 60, 70), (100,)])
def test_the_records_without_a_group_keep_the_other_groups(rows):
    data = records(*rows)
    found = groups(data, folds=4, gap=3)
    for g in range(4):
        train, left = found.without(data, g)
        fold = found.fold(data, g)
        assert train.names == fold.train.names
        assert left.names == tuple(n for n in found.names if n != fold.name)
        for record, label in zip(train, left.labels, strict=True):
            before = found.labels[data.names.index(record.name)]
            own = [n if n < g else n - 1 for n in before if n >= 0 and n != g]
            assert label[label >= 0].tolist() == own
            assert (label < 0).tolist() == ((before == g) | (before < 0)).tolist()
