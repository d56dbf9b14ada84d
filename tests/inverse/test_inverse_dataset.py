"""Datasets read backwards: which sample stands where, and what is refused."""

import numpy as np
import pytest
from common import Part, network

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.inverse import dead_times, inverse_data
from jaxnarx.inverse.dataset import parse_ahead


def two_by_two(lengths=(12, 3, 9), gap: bool = False) -> Dataset:
    """Counting signals: the value tells channel, record and row."""
    rows = [
        np.arange(n)[:, None] + 100.0 * np.arange(4)[None] + 1000.0 * k
        for k, n in enumerate(lengths)
    ]
    if gap:
        rows[0][5, 2] = np.nan
    return Dataset.from_arrays(
        [r[:, :2] for r in rows],
        [r[:, 2:] for r in rows],
        inputs=["throttle", "speed"],
        outputs=["torque", "pressure"],
        sample_time=0.1,
        units={"throttle": "deg", "torque": "N m"},
        missing="mask",
    )


def swapped(data: Dataset, **options) -> Dataset:
    return inverse_data(
        data, commands=["throttle"], targets=["torque"], states=["pressure"], **options
    )


def test_every_channel_stands_at_its_sample():
    data = two_by_two()
    found = swapped(data, lead=3)
    assert found.channels.input_names == ["torque_ahead3", "speed", "pressure"]
    assert found.channels.output_names == ["throttle"]
    assert [c.unit for c in found.channels.all] == ["N m", "", "", "deg"]
    # The record of three rows has nothing left.
    assert [len(r) for r in found] == [9, 6]
    for k, record in zip((0, 2), found, strict=True):
        t = np.arange(len(record)) + 1000.0 * k
        np.testing.assert_array_equal(record.u[:, 0], 200 + t + 3)
        np.testing.assert_array_equal(record.u[:, 1], 100 + t)
        np.testing.assert_array_equal(record.u[:, 2], 300 + t)
        np.testing.assert_array_equal(record.y[:, 0], t)


def test_masks_move_with_their_channel():
    found = swapped(two_by_two(gap=True), lead=3).records[0]
    hole = np.argwhere(~found.valid)
    # The sample missing at row 5 is seen three samples earlier, in that column alone.
    np.testing.assert_array_equal(hole, [[2, 0]])


def test_without_lead_nothing_is_lost():
    data = two_by_two()
    assert swapped(data, lead=0).samples == data.samples


def test_the_lead_is_the_forward_models_dead_time_or_that_of_the_data(clean, forward):
    for model in (forward, None):
        found = inverse_data(clean, commands=["u"], targets=["y"], forward=model)
        assert found.channels.input_names[0] == "y_ahead2"


def test_dead_time_counts_the_way_through_another_output():
    # w feels a after 2 samples, y feels w after 1 and a not at all.
    a, w = 0, 3
    net = network(
        [Part([[((0, 1), 0.5)]]), Part([[((0, 2), 0.4)]])],
        (0, 1),
        variables=((w, 1), (a, 2)),
    )
    found = dead_times(net)
    assert found[0, a] == 3 and found[1, a] == 2
    assert found[0, w] == 1 and np.isinf(found[1, 1])


def test_names_ahead_read_back():
    assert parse_ahead("a_b_ahead12") == ("a_b", 12)
    assert parse_ahead("ahead3") is None


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"commands": ["torque"]}, "commands"),
        ({"targets": ["speed"]}, "targets"),
        ({"targets": []}, "targets"),
        ({"states": ["nothing"]}, "states"),
        ({"lead": -1}, "lead"),
        ({"lead": {"pressure": 1}}, "lead"),
        ({"commands": ["throttle", "throttle"]}, "commands"),
    ],
)
def test_wrong_names_and_leads_are_named(options, field):
    given = {"commands": ["throttle"], "targets": ["torque"], "lead": 1} | options
    with pytest.raises(SpecError) as caught:
        inverse_data(two_by_two(), **given)
    assert caught.value.field == field


def test_records_shorter_than_the_lead_are_an_error():
    with pytest.raises(DataError, match="no record is longer"):
        swapped(two_by_two(), lead=12)
