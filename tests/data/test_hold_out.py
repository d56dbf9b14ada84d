"""Validation records held out of training."""

import dataclasses

import numpy as np
import pytest
from test_groups import records

from jaxnarx.data import Dataset, hold_out
from jaxnarx.errors import DataError, SpecError


def test_every_record_goes_to_one_side_in_its_order():
    data = records(*[100] * 10)
    train, validate = hold_out(data)
    assert sorted(train.names + validate.names) == sorted(data.names)
    for part in (train, validate):
        assert part.names == [n for n in data.names if n in part.names]
        assert part.channels == data.channels and part.sample_time == data.sample_time


def test_records_that_repeat_each_other_stay_on_one_side():
    for seed in range(5):
        again = {n + 5: n for n in range(5)}
        train, validate = hold_out(records(*[200] * 10, again=again, seed=seed))
        own = {int(name[1:]) % 5 for name in validate.names}
        assert len(validate) == 2 and len(own) == 1
        assert not own & {int(name[1:]) % 5 for name in train.names}


@pytest.mark.parametrize(
    ("rows", "share", "held"),
    [
        ((100,) * 10, 0.2, 200),
        ((100,) * 10, 0.5, 500),
        ((100, 100, 100, 100), 0.05, 100),
        ((400, 300, 250, 50), 0.25, 250),
        ((400, 350, 250), 0.9, 600),
    ],
)
def test_the_group_nearest_to_the_share_is_held_out(rows, share, held):
    data = records(*rows)
    train, validate = hold_out(data, share=share)
    assert validate.samples == held and train.samples == data.samples - held


def test_a_named_group_is_held_out():
    data = records(*[100] * 6)
    stated = [
        dataclasses.replace(r, group=g) for r, g in zip(data, "aabbbb", strict=True)
    ]
    data = dataclasses.replace(data, records=tuple(stated))
    assert hold_out(data, share=0.3)[1].names == ["r0", "r1"]
    assert hold_out(data, share=0.6)[1].names == ["r2", "r3", "r4", "r5"]


@pytest.mark.parametrize("count", [1, 2])
def test_of_few_records_the_ends_are_cut_off(count):
    train, validate = hold_out(records(*[100] * count), share=0.25)
    assert len(train) == len(validate) == count
    assert validate.names == [f"r{i} (end)" for i in range(count)]
    for first, last in zip(train, validate, strict=True):
        rows = np.concatenate([first.y, last.y])[:, 0]
        np.testing.assert_array_equal(rows, np.arange(100) + 0.5)
        assert len(last) == 25
        assert last.start_row == first.start_row + 75


def test_the_end_is_one_of_the_cycle_that_two_records_repeat():
    data = records(400, 400, again={1: 0})
    late = data.records[1]
    late = dataclasses.replace(
        late, u=late.u[30:], y=late.y[30:], valid=late.valid[30:]
    )
    data = dataclasses.replace(data, records=(data.records[0], late))
    train, validate = hold_out(data, share=0.25)
    assert [len(r) for r in train] == [300, 270]
    assert [len(r) for r in validate] == [100, 100]


def test_missing_samples_stay_marked_across_a_cut():
    y = np.arange(40.0)[:, None]
    y[[5, 35]] = np.nan
    data = Dataset.from_arrays(
        [np.random.default_rng(0).normal(size=(40, 1))],
        [y],
        inputs=["u"],
        outputs=["y"],
        sample_time=0.1,
        missing="mask",
    )
    train, validate = hold_out(data, share=0.25)
    assert np.flatnonzero(~train.records[0].valid[:, 1]).tolist() == [5]
    assert np.flatnonzero(~validate.records[0].valid[:, 1]).tolist() == [5]


def test_beside_a_long_record_short_ones_do_not_validate_alone():
    """A share of 3 % whole would tell nothing: the ends are taken instead."""
    train, validate = hold_out(records(1000, 30, 1), share=0.2)
    assert validate.names == ["r0 (end)", "r1 (end)"]
    assert train.names == ["r0", "r1", "r2"]


def test_constant_and_absent_inputs_do_not_matter():
    constant = Dataset.from_arrays(
        [np.ones((50, 1))] * 5,
        [np.full((50, 1), float(i)) for i in range(5)],
        inputs=["u"],
        outputs=["y"],
        sample_time=1,
    )
    none = Dataset.from_arrays(
        None,
        [np.full((50, 1), float(i)) for i in range(5)],
        inputs=[],
        outputs=["y"],
        sample_time=1,
    )
    for data in (constant, none):
        train, validate = hold_out(data)
        assert len(train) == 4 and len(validate) == 1


@pytest.mark.parametrize("share", [0, 1, -0.2, 1.5, float("nan")])
def test_a_share_outside_zero_to_one_is_refused(share):
    with pytest.raises(SpecError, match="between 0 and 1") as caught:
        hold_out(records(100, 100), share=share)
    assert caught.value.field == "share"


@pytest.mark.parametrize("rows, share", [(1, 0.2), (2, 0.1), (100, 0.999)])
def test_a_record_too_short_to_cut_is_named(rows, share):
    with pytest.raises(DataError, match=f"r0 has {rows} row"):
        hold_out(records(rows), share=share)
