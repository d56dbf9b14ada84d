"""Stretches of all records, evenly spread."""

import dataclasses

import numpy as np
import pytest

from jaxnarx import Dataset
from jaxnarx.data import thin_records


def records(*rows: int) -> Dataset:
    """Each counts its rows."""
    us = [np.arange(float(n))[:, None] for n in rows]
    data = Dataset.from_arrays(us, us, inputs=["u"], outputs=["y"], sample_time=1.0)
    named = [dataclasses.replace(r, group="g") for r in data]
    return dataclasses.replace(data, records=tuple(named))


def test_short_data_stay_as_they_are():
    data = records(30, 20)
    assert thin_records(data, 50) is data


def test_short_records_keep_one_stretch_each_at_another_place():
    data = records(300, 200)
    found = thin_records(data, 100)
    assert [len(r) for r in found] == [60, 40]
    starts = [int(r.u[0, 0]) for r in found]
    assert [r.start_row for r in found] == starts and starts[0] == 0
    many = thin_records(records(*[100] * 50), 500)
    places = np.sort([r.u[0, 0] for r in many])
    assert places[0] < 5 and places[-1] > 85 and np.diff(places).max() < 5
    assert found.names == data.names and found.records[0].group == "g"


def test_stretches_are_as_long_as_is_asked_for_where_they_can_be():
    data = records(100_000, 1000)
    for shortest, lengths in ((0, 8), (4000, 5), (50_000, 1)):
        found = thin_records(data, 20_200, shortest)
        assert len(found) == lengths + 1
        assert sum(map(len, found)) == pytest.approx(20_200, rel=0.01)


@pytest.mark.parametrize(("rows", "count"), [(1500, 3), (3999, 7), (60_000, 8)])
def test_long_records_are_seen_from_begin_to_end(rows, count):
    length = 100_000
    found = thin_records(records(length), rows)
    assert len(found) == count
    starts = [int(r.u[0, 0]) for r in found]
    assert starts[0] == 0 and found.records[-1].u[-1, 0] == length - 1
    assert [r.start_row for r in found] == starts
    assert np.ptp(np.diff(starts)) <= 1, "at equal distances"
    assert 0.99 * rows < found.samples <= rows
    for r in found:
        np.testing.assert_array_equal(np.diff(r.u[:, 0]), 1.0)
    assert len(set(found.names)) == count
