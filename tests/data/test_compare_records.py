"""A record in another unit than its fellows is named, one in another range is not."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxnarx.data import Dataset, check, read_split
from jaxnarx.data.compare_records import far_levels, other_units
from jaxnarx.engines import Diesel

TORQUE, FUEL, T_EM = "torque", "fuel", "T_em"


@pytest.fixture(scope="module")
def bench() -> list[np.ndarray]:
    """The usual excitation of a diesel engine, for 22 records."""
    bed = Diesel()
    keys = jax.random.split(jax.random.key(3), 22)
    return [np.asarray(bed.excite(key, 300)) for key in keys]


def run(inputs) -> Dataset:
    data = Diesel().simulate(inputs, jax.random.key(0))
    names = [f"bus_{n:02d}" for n in range(len(data))]
    pairs = zip(data, names, strict=True)
    records = tuple(dataclasses.replace(r, name=name) for r, name in pairs)
    return dataclasses.replace(data, records=records)


@pytest.fixture(scope="module")
def clean(bench) -> Dataset:
    return run(bench)


def changed(data: Dataset, record: int, name: str, factor, offset=0.0) -> Dataset:
    records, j = list(data.records), data.channels.signal(name)
    x = records[record].signals.copy()
    x[:, j] = factor * x[:, j] + offset
    inputs = len(data.channels.inputs)
    parts = {"u": x[:, :inputs].copy(), "y": x[:, inputs:].copy()}
    records[record] = dataclasses.replace(records[record], **parts)
    return dataclasses.replace(data, records=tuple(records))


@pytest.mark.parametrize(
    ("name", "factor", "offset", "said"),
    [
        (TORQUE, 1 / 9, 0.0, "factor 9"),
        ("speed", np.pi / 30, 0.0, "the 9.549 of rpm and rad/s"),
        (FUEL, 60.0, 0.0, "the 60 of per minute and per second"),
        (FUEL, 1e3, 0.0, "the 1000 of a prefix"),
        (TORQUE, -1.0, 0.0, "factor -1"),
        (T_EM, 1.0, -273.15, "offset +273.15, degC and K"),
    ],
)
def test_one_of_22_records_in_another_unit(clean, name, factor, offset, said):
    found = list(other_units(changed(clean, 1, name, factor, offset)))
    assert [(f.record, f.channel) for f in found] == [("bus_01", name)]
    assert said in found[0].message and found[0].severity == "warning"
    assert "elsewhere from" in found[0].message


def test_check_tells_it(clean):
    (found,) = check(changed(clean, 1, TORQUE, 1 / 9)).of("another unit")
    assert found.record == "bus_01"
    assert found.message.startswith("torque in bus_01 goes from")


def test_two_records_are_both_named(clean):
    data = changed(changed(clean, 1, TORQUE, 1 / 9), 7, "speed", 1 / 60)
    assert {f.record for f in other_units(data)} == {"bus_01", "bus_07"}


@pytest.mark.parametrize("edge", [0.0, 1.0])
@pytest.mark.parametrize("share", [0.05, 0.3])
def test_another_operating_range_is_none(bench, edge, share):
    """One record stays near an edge of all inputs, another near that of one."""
    low, high = np.min(bench, axis=(0, 1)), np.max(bench, axis=(0, 1))
    corner = low + edge * (high - low)
    moved = [u.copy() for u in bench[:8]]
    moved[2] = corner + share * (moved[2] - corner)
    moved[5][:, 0] = corner[0] + share * (moved[5][:, 0] - corner[0])
    assert not list(other_units(run(moved)))


def test_clean_few_and_tiny_records_are_taken_as_they_are(clean):
    assert not list(other_units(clean))
    assert not list(other_units(changed(clean, 1, TORQUE, 1 / 9)[:3]))
    flat = Dataset.from_arrays(
        [np.full(30, float(k)) for k in range(5)],
        [np.arange(30.0) + k for k in range(5)],
        inputs=["u"],
        outputs=["y"],
        sample_time=1.0,
    )
    assert not list(other_units(flat))


def test_a_range_that_others_do_not_explain_is_a_note():
    rng = np.random.default_rng(0)
    u = [rng.uniform(0, 700, 100) for _ in range(6)]
    y = [rng.normal(size=100) for _ in range(6)]
    u[4] = u[4] / 60
    data = Dataset.from_arrays(u, y, inputs=["u"], outputs=["y"], sample_time=1.0)
    (found,) = other_units(data)
    assert (found.severity, found.record) == ("note", "record 5")
    assert "unless it was run so" in found.message


def test_levels_that_hide_the_movement_are_told():
    rng = np.random.default_rng(0)
    u = [rng.normal(size=100) for _ in range(3)]
    y = [x + 3e4 * k for k, x in enumerate(u)]
    data = Dataset.from_arrays(u, y, inputs=["u"], outputs=["y"], sample_time=1.0)
    (found,) = check(data).of("levels")
    assert found.channel == "y" and "scores 4" in found.message
    near = [x + k for k, x in enumerate(u)]
    data = Dataset.from_arrays(u, near, inputs=["u"], outputs=["y"], sample_time=1.0)
    assert not list(far_levels(data)) and not list(far_levels(data[:1]))


@pytest.mark.slow
def test_gengine1_has_none(measured):
    root = Path(__file__).parents[2]
    split = read_split(root / "experiments/gengine1/gengine1.toml", root=measured)
    assert not list(other_units(split.all))
