"""Channels with rasters of their own: where the common one lies, and what is on it."""

import numpy as np
import pytest

from jaxnarx.data.readers.rasters import Signal, one_raster
from jaxnarx.data.record import RowSource
from jaxnarx.errors import DataError

PLACE = RowSource("run.mf4")


def signal(name: str, step: float, start: float, stop: float, of, **more) -> Signal:
    """`of` the time from start to stop."""
    t = np.arange(start, stop + 1e-9, step)
    values = np.asarray(of(t), float)
    return Signal(name, t, values, np.ones(len(t), bool), **more)


def columns(table) -> dict[str, np.ndarray]:
    return {name: column.to_numpy() for name, column in table.columns.items()}


def test_one_raster_stays_as_it_is():
    a, b = (signal(n, 0.1, 0.0, 5.0, np.sin) for n in "ab")
    for step in (None, 0.1):
        table = one_raster([a, b], PLACE, step)
        np.testing.assert_array_equal(table.time, a.time)
        np.testing.assert_array_equal(columns(table)["b"], b.values)
        assert table.notes == ()


def test_several_are_brought_to_the_wanted_one_and_that_is_told():
    slow = signal("T", 1.0, 0.3, 60.0, lambda t: 20 + t, unit="degC")
    fast = signal("p", 0.01, 0.0, 58.0, lambda t: np.sin(0.5 * t))
    gear = signal("gear", 0.5, 0.0, 60.0, lambda t: (t > 20) * 1 + (t > 40) * 1)
    table = one_raster([slow, fast, gear], PLACE, 0.1)
    found, t = columns(table), np.asarray(table.time)
    # from the last begin, .3 s, to the first end, 58 s
    assert t[0] == pytest.approx(0.3) and t[-1] == pytest.approx(58.0, abs=0.1)
    np.testing.assert_allclose(np.diff(t), 0.1, rtol=1e-9)
    np.testing.assert_allclose(found["T"], 20 + t, rtol=1e-12)  # a line stays one
    # the filter is flat to .3 % far below its edge; at the ends it mirrors
    inner = slice(20, -20)
    np.testing.assert_allclose(found["p"][inner], np.sin(0.5 * t[inner]), atol=4e-3)
    assert set(found["gear"]) == {0.0, 1.0, 2.0}
    # held: the last sample before or at each instant
    at = np.searchsorted(gear.time, t + 1e-7, side="right") - 1
    np.testing.assert_array_equal(found["gear"], gear.values[at])
    (note,) = table.notes
    assert "gear held" in note and "p filtered" in note and "T interpolated" in note
    assert table.units["T"] == "degC"


def test_a_channel_on_the_wanted_raster_stays_as_measured_and_is_not_told():
    slow = signal("T", 0.5, 0.25, 60.0, lambda t: np.sin(9 * t))
    fast = signal("p", 0.01, 0.0, 58.0, lambda t: t)
    table = one_raster([fast, slow], PLACE, 0.5)
    count = len(np.asarray(table.time))
    np.testing.assert_allclose(columns(table)["T"], slow.values[:count], atol=1e-12)
    assert table.notes == ("run.mf4: brought to 0.5 s: p filtered against aliasing",)
    # half a sample beside the grid it is interpolated
    late = signal("q", 0.5, 0.0, 60.0, lambda t: t)
    (note,) = one_raster([slow, late], PLACE, 0.5).notes
    assert note.endswith("q interpolated")
    early = signal("q", 0.5, -0.25, 60.0, lambda t: t)
    assert one_raster([slow, early], PLACE, 0.5).notes == ()  # cut alone


def test_a_tone_above_the_new_raster_does_not_fold_back():
    # 9 Hz sampled at 100 Hz; at 10 Hz it would be a slow swing of 1 Hz
    tone = signal("p", 0.01, 0.0, 30.0, lambda t: np.sin(2 * np.pi * 9 * t))
    other = signal("u", 0.1, 0.0, 30.0, lambda t: t * np.sqrt(2))
    inner = columns(one_raster([tone, other], PLACE, 0.1))["p"][20:-20]
    # the stop band is 1/300 at least
    assert np.abs(inner).max() < 1 / 300


def test_invalid_samples_and_gaps_stay_invalid():
    t = np.delete(np.arange(0, 30, 0.1), slice(100, 150))  # from 10 to 15 s nothing
    valid = np.ones(len(t), bool)
    valid[20:25] = False
    a = Signal("a", t, np.sin(t), valid)
    b = signal("b", 0.05, 0.0, 29.9, np.cos)
    table = one_raster([a, b], PLACE, 0.1)
    found = columns(table)["a"]
    missing = np.asarray(table.time)[np.isnan(found)]
    assert np.all(
        ((missing > 1.85) & (missing < 2.55)) | ((missing > 9.9) & (missing < 15))
    )
    assert np.sum((missing > 10.0) & (missing < 14.9)) >= 48
    assert np.sum((missing > 1.9) & (missing < 2.5)) >= 5
    assert any("invalid samples" in note and "of a" in note for note in table.notes)


def test_what_cannot_be_brought_together_is_refused():
    a = signal("a", 0.1, 0.0, 5.0, np.sin)
    b = signal("b", 0.2, 0.0, 5.0, np.sin)
    with pytest.raises(
        DataError, match="different rasters.*a every 0.1 s.*sample_time"
    ):
        one_raster([a, b], PLACE, None)
    late = signal("c", 0.2, 6.0, 9.0, np.sin)
    with pytest.raises(DataError, match="a ends at 5 s, before c begins at 6"):
        one_raster([a, late], PLACE, 0.1)
    back = Signal("d", np.array([0.0, 0.1, 0.1]), np.zeros(3), np.ones(3, bool))
    with pytest.raises(DataError, match="time of d does not increase after 0.1 s"):
        one_raster([a, back], PLACE, 0.1)
    empty = Signal("e", np.zeros(0), np.zeros(0), np.zeros(0, bool))
    with pytest.raises(DataError, match="e has no sample"):
        one_raster([a, empty], PLACE, 0.1)


def test_a_label_is_never_between_two():
    t = np.arange(0, 5, 0.5)
    mode = Signal(
        "mode", t, np.tile([0.0, 300.0], 5), np.ones(10, bool), "", ("a", "b")
    )
    fine = signal("u", 0.1, 0.0, 4.5, np.sin)
    assert set(columns(one_raster([mode, fine], PLACE, 0.1))["mode"]) == {0.0, 300.0}
