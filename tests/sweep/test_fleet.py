"""Fleets: padding, parts, what is wrong with a member, and the digest."""

import dataclasses
import pickle

import numpy as np
import pytest
from identify_problems import engine, fleet_of, parts, replaced

from jaxnarx.data import Fleet
from jaxnarx.errors import DataError, SpecError


def test_records_come_back_without_their_padding():
    data = {"a": engine(1), "b": engine(2, lengths=(40, 70, 50))}
    fleet = fleet_of(data)
    assert len(fleet) == 2 and fleet.status == ("ok", "ok")
    assert fleet.train.signals.shape == (2, 1, 90, 3)
    assert fleet.train.length.tolist() == [[90], [40]]
    assert not fleet.train.valid[1, 0, 40:].any()
    np.testing.assert_array_equal(
        fleet.train.signals[1, 0, 40:], fleet.train.signals[1, 0, 39:40].repeat(50, 0)
    )
    for n, own in enumerate(data.values()):
        for name, part in zip(("train", "validation", "test"), parts(own), strict=True):
            (record,) = fleet.dataset(n, name).records
            np.testing.assert_array_equal(record.u, part.records[0].u)
            np.testing.assert_array_equal(record.y, part.records[0].y)
            np.testing.assert_array_equal(record.valid, part.records[0].valid)
            assert record.name == part.records[0].name


def test_records_are_chosen_by_slice_place_or_name():
    data = {"a": engine(1)}
    fleet = Fleet.from_datasets(data, train=slice(0, 2), test="record 3")
    assert fleet.validation is None and list(fleet.parts) == ["train", "test"]
    assert fleet.dataset(0).names == ["record 1", "record 2"]
    last = Fleet.from_datasets(data, train=[0], validation=-1)
    assert last.dataset(0, "validation").names == ["record 3"]


def test_bad_members_are_told_apart_and_stay_finite():
    good, nan = engine(1), engine(2)
    u = nan.records[2].u.copy()
    u[7, 1] = np.inf
    fleet = fleet_of(
        {
            "good": good,
            "inf": replaced(nan, 2, u=u),
            "none": DataError("the engine stalls at 3.2 s"),
            "few": good[:2],
        }
    )
    assert fleet.status == ("ok", "nonfinite_data", "nonfinite_data", "too_short")
    assert "record 3" in fleet.detail[1] and "row 7" in fleet.detail[1]
    assert "stalls" in fleet.detail[2] and "test" in fleet.detail[3]
    assert all(np.all(np.isfinite(p.signals)) for p in fleet.parts.values())


def test_wrong_use_is_an_error():
    data = engine(1)
    with pytest.raises(SpecError, match="at least one dataset"):
        fleet_of({})
    slower = dataclasses.replace(data, sample_time=0.2)
    with pytest.raises(SpecError, match="sample time"):
        fleet_of({"a": data, "b": slower})
    with pytest.raises(SpecError, match="no member 'c'"):
        fleet_of({"a": data}).index("c")


def test_channels_are_matched_by_name():
    data = engine(1)
    swapped = dataclasses.replace(
        data,
        channels=dataclasses.replace(data.channels, inputs=data.channels.inputs[::-1]),
        records=tuple(
            dataclasses.replace(r, u=r.u[:, ::-1].copy(), valid=r.valid[:, [1, 0, 2]])
            for r in data.records
        ),
    )
    fleet = fleet_of({"a": data, "b": swapped})
    np.testing.assert_array_equal(fleet.train.signals[0], fleet.train.signals[1])


def test_the_digest_sees_content_and_not_padding():
    data = {"a": engine(1), "b": engine(2)}
    fleet = fleet_of(data)
    digest = fleet.digest()
    assert pickle.loads(pickle.dumps(fleet)).digest() == digest
    wider = dataclasses.replace(fleet, train=fleet.train.widen(3, 120))
    assert wider.train.signals.shape == (2, 3, 120, 3)
    assert wider.digest() == digest
    y = data["b"].records[0].y.copy()
    y[50, 0] += 1e-12
    other = fleet_of(data | {"b": replaced(data["b"], 0, y=y)})
    renamed = fleet_of({"a": data["a"], "c": data["b"]})
    assert (
        len({digest, other.digest(), renamed.digest(), fleet.pick([0]).digest()}) == 4
    )


def test_pick_takes_members_in_any_order():
    fleet = fleet_of({"a": engine(1), "b": engine(2), "c": engine(3)})
    picked = fleet.pick([2, 0])
    assert picked.names == ("c", "a")
    np.testing.assert_array_equal(picked.train.signals, fleet.train.signals[[2, 0]])
