"""Validation records held out of training."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnarx.data import Dataset, hold_out
from jaxnarx.errors import DataError, SpecError


def records(*levels: float, rows: int | list[int] = 100, seed: int = 0) -> Dataset:
    """One record per level of the input; outputs count rows, so that cuts show."""
    rng = np.random.default_rng(seed)
    rows = [rows] * len(levels) if isinstance(rows, int) else rows
    pairs = list(zip(levels, rows, strict=True))
    return Dataset.from_arrays(
        [level + 0.1 * rng.standard_normal((n, 1)) for level, n in pairs],
        [np.arange(n, dtype=float)[:, None] for _, n in pairs],
        inputs=["u"],
        outputs=["y"],
        sample_time=0.1,
        names=[f"r{i}" for i in range(len(levels))],
    )


def test_every_record_goes_to_one_side_in_its_order():
    data = records(0, 0, 1, 1, 2, 2, 3, 3, 4, 4)
    train, validate = hold_out(data)
    assert sorted(train.names + validate.names) == sorted(data.names)
    for part in (train, validate):
        assert part.names == [n for n in data.names if n in part.names]
        assert part.channels == data.channels and part.sample_time == data.sample_time


def test_a_held_out_record_has_a_like_one_that_stays():
    """Pairs of records at five levels: never both of a pair."""
    for seed in range(10):
        train, validate = hold_out(records(0, 0, 1, 1, 2, 2, 3, 3, 4, 4, seed=seed))
        levels = {int(n[1:]) // 2 for n in validate.names}
        assert len(levels) == len(validate) == 2
        assert levels <= {int(n[1:]) // 2 for n in train.names}


def test_the_only_record_of_a_regime_stays():
    for seed in range(10):
        train, _ = hold_out(records(0, 0, 0, 0, 0, 50, seed=seed))
        assert "r5" in train.names


@settings(max_examples=50, deadline=None, database=None, derandomize=True)
@given(
    st.lists(st.integers(20, 300), min_size=4, max_size=12),
    st.floats(0.1, 0.5),
    st.integers(0, 100),
)
def test_about_the_wanted_share_and_never_everything(lengths, share, seed):
    levels = np.random.default_rng(seed).uniform(0, 3, len(lengths))
    data = records(*levels, rows=lengths, seed=seed)
    train, validate = hold_out(data, share=share)
    assert train.samples + validate.samples == data.samples
    assert 0 < validate.samples <= 1.25 * share * data.samples + len(data)
    assert train.samples > 0


@pytest.mark.parametrize("count", [1, 2, 3])
def test_of_few_records_the_ends_are_cut_off(count):
    train, validate = hold_out(records(*range(count)), share=0.25)
    assert len(train) == len(validate) == count
    assert validate.names == [f"r{i} (end)" for i in range(count)]
    for first, last in zip(train, validate, strict=True):
        rows = np.concatenate([first.y, last.y])[:, 0]
        np.testing.assert_array_equal(rows, np.arange(100))
        assert len(last) == 25
        assert last.start_row == first.start_row + 75


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


def test_four_records_of_very_unequal_length_are_cut():
    """No whole record is near the share: the ends are taken instead."""
    data = records(0, 0, 0, 0, rows=[400, 400, 400, 400])
    _, validate = hold_out(data, share=0.05)
    assert validate.names == [f"r{i} (end)" for i in range(4)]


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


def test_the_choice_is_the_same_every_time():
    data = records(*np.random.default_rng(3).uniform(size=12))
    assert hold_out(data)[1].names == hold_out(data)[1].names


@pytest.mark.parametrize("share", [0, 1, -0.2, 1.5, float("nan")])
def test_a_share_outside_zero_to_one_is_refused(share):
    with pytest.raises(SpecError, match="between 0 and 1") as caught:
        hold_out(records(0, 1), share=share)
    assert caught.value.field == "share"


@pytest.mark.parametrize("rows, share", [(1, 0.2), (2, 0.1), (100, 0.999)])
def test_a_record_too_short_to_cut_is_named(rows, share):
    with pytest.raises(DataError, match=f"r0 has {rows} row"):
        hold_out(records(0, rows=rows), share=share)
