"""Regions that are corners."""

import numpy as np

from jaxnarx.inverse.region import find_region


def test_a_corner_needs_both_borders():
    place = np.random.default_rng(1).uniform(size=(400, 3))
    flag = (place[:, 0] < 0.4) & (place[:, 2] > 0.6)
    names = ["VGT [%]", "fuel [mg]", "EGR [%]"]
    found = find_region(place, names, flag)
    assert found.also is not None
    assert {found.channel, found.also.channel} == {"VGT [%]", "EGR [%]"}
    np.testing.assert_array_equal(found.holds(place, names), flag)
    assert found.also.agreement == 1.0 and found.agreement < 0.9
    assert "VGT [%] is below" in str(found) and "EGR [%] is above" in str(found)


def test_a_second_border_that_tells_no_more_is_not_named():
    place = np.random.default_rng(2).uniform(size=(400, 2))
    flag = place[:, 0] < 0.3
    flag[np.argsort(place[:, 0])[110:115]] = True
    found = find_region(place, ["a", "b"], flag)
    assert found.also is None and found.channel == "a"
