"""Several datasets as one: order, units, names, groups, and what does not fit."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.data import Channel, join


def campaign(seed, *, inputs, records=2, step=0.1, output: Any = "y", names=None):
    rng = np.random.default_rng(seed)
    shapes = [(20 + n, len(inputs)) for n in range(records)]
    return jnx.Dataset.from_arrays(
        [rng.normal(size=shape) for shape in shapes],
        [rng.normal(size=(rows, 1)) for rows, _ in shapes],
        inputs=inputs,
        outputs=[output],
        sample_time=step,
        names=names,
    )


def test_records_stand_behind_one_another_as_they_were():
    a, b = campaign(1, inputs=["u"]), campaign(2, inputs=["u"], records=3)
    both = join([a, b])
    assert len(both) == 5 and both.channels == a.channels
    for got, record in zip(both, [*a, *b], strict=True):
        np.testing.assert_array_equal(got.signals, record.signals)
    assert both.names[:2] == a.names and len(set(both.names)) == 5
    assert join([a]).names == a.names


def test_channels_are_matched_by_name_in_the_units_of_the_first():
    a = campaign(1, inputs=[Channel("T", "K"), Channel("n", "rpm")])
    b = campaign(2, inputs=[Channel("n", "rpm"), "spare", Channel("T", "°C")])
    both = join([a, b])
    np.testing.assert_allclose(both.records[2].u[:, 0], b.records[0].u[:, 2] + 273.15)
    np.testing.assert_array_equal(both.records[2].u[:, 1], b.records[0].u[:, 0])
    assert both.channels == a.channels
    told = "\n".join(both.notes)
    assert "T converted from °C to K" in told and "dataset 2: left out spare" in told


def test_names_are_told_apart_and_groups_kept():
    a, b = (campaign(n, inputs=["u"], names=["wltc", "ramp"]) for n in (1, 2))
    named = tuple(dataclasses.replace(r, group="second day") for r in b)
    both = join([a, dataclasses.replace(b, records=named), a])
    suffixes = ["", " (2)", " (3)"]
    assert both.names == [n + s for s in suffixes for n in ("wltc", "ramp")]
    assert [r.group for r in both][2:4] == ["second day"] * 2


@pytest.mark.parametrize(
    ("others", "said"),
    [
        ([], "no datasets"),
        ([{"step": 0.2}], "dataset 2 has a sample time of 0.2 s, the first of 0.1 s"),
        ([{}, {"inputs": ["v"]}], "no channel 'u'"),
        ([{"output": Channel("y", "bar")}], "y is in 'bar' in the data"),
    ],
    ids=["none", "sample time", "channel", "unit"],
)
def test_what_does_not_go_together_is_named(others, said):
    first = campaign(1, inputs=["u"], output=Channel("y", "K"))
    given = [campaign(2, **({"inputs": ["u"]} | other)) for other in others]
    with pytest.raises(jnx.SpecError, match=said):
        join([first, *given] if others else [])


def test_what_is_no_dataset_is_refused():
    with pytest.raises(jnx.SpecError, match="datasets"):
        join([campaign(1, inputs=["u"]), 3])  # pyright: ignore[reportArgumentType]
