"""Units: what is one, what becomes another, and where that is told."""

import numpy as np
import pytest

from jaxnarx.data import Channel, Channels, Dataset, match_channels, read
from jaxnarx.data.units import base_unit, conversion, same_unit, sum_over_time
from jaxnarx.errors import SpecError


@pytest.mark.parametrize(
    ("value", "old", "new", "expected"),
    [
        (3000.0, "1/min", "rpm", 3000.0),
        (100 * np.pi, "rad/s", "[rpm]", 3000.0),
        (3000.0, "rpm", "1/s", 50.0),
        (50.0, "Hz", "1/min", 3000.0),
        (1.01325, "bar", "kPa", 101.325),
        (25.0, "°C", "K", 298.15),
        (300.0, "K", "degC", 26.85),
        (212.0, "degF", "degC", 100.0),
        (50.0, "%", "-", 0.5),
        (36.0, "kg/h", "g/s", 10.0),
        (72.0, "km/h", "m/s", 20.0),
        (1.0, "vol%", "ppm", 1e4),
    ],
)
def test_what_measures_the_same_is_converted(value, old, new, expected):
    there, back = conversion(old, new), conversion(new, old)
    assert there is not None and back is not None
    assert there(np.array([value]))[0] == pytest.approx(expected, rel=1e-12)
    assert back(np.array([expected]))[0] == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new"),
    [("1/s", "1"), ("bar", "K"), ("ppm", "mg"), ("ppm", "%"), ("x", "y")],
)
def test_what_may_be_misread_is_not(old, new):
    assert conversion(old, new) is None


def test_spellings_are_one_unit():
    assert same_unit("[1/min]", "rpm") and same_unit("-", "1") and same_unit("x", "(x)")
    assert not same_unit("bar", "kPa")


def test_units_are_known_in_those_of_si():
    """Conversions from one unit of a quantity to another are those over the base."""
    for one, other in (("rpm", "rad/s"), ("°F", "K"), ("psi", "bar"), ("g/h", "kg/s")):
        a, b, there = base_unit(one), base_unit(other), conversion(one, other)
        assert a is not None and b is not None and there is not None
        assert a.exponents == b.exponents
        np.testing.assert_allclose(a.factor / b.factor, there.factor, rtol=1e-12)
        offset = (a.offset - b.offset) / b.factor
        np.testing.assert_allclose(offset, there.offset, rtol=1e-12)
    assert base_unit("furlong") is base_unit("1/s") is base_unit("1/min") is None


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("g/s", ("g", 1.0)),
        ("[kg/h]", ("kg", 3600.0)),
        ("kW", ("kJ", 1.0)),
        ("1/s", None),
        ("#/s", ("#", 1.0)),
        ("km/h", None),
        ("g/kW/h", None),
        ("ppm", None),
        ("", None),
    ],
)
def test_rates_are_told_from_levels(unit, expected):
    assert sum_over_time(unit) == expected


def test_single_precision_stays():
    convert = conversion("bar", "kPa")
    assert convert is not None
    x = convert(np.ones(3, np.float32))
    assert x.dtype == np.float32


CHANNELS = Channels((Channel("p", "kPa"),), (Channel("T", "degC"),))


def test_data_are_brought_to_the_units_of_a_model():
    other = Dataset.from_arrays(
        np.array([1.0, 2.0, 1.5]),
        np.array([300.0, 310.0, 305.0]),
        inputs=[Channel("p", "bar")],
        outputs=[Channel("T", "K")],
        sample_time=0.1,
    )
    data, _ = match_channels(other, CHANNELS)
    np.testing.assert_allclose(data.records[0].u[:, 0], [100.0, 200.0, 150.0])
    np.testing.assert_allclose(data.records[0].y[:, 0], [26.85, 36.85, 31.85])
    assert data.channels == CHANNELS
    assert any("p converted from bar to kPa, times 100" in n for n in data.notes)
    np.testing.assert_array_equal(other.records[0].u[:, 0], [1.0, 2.0, 1.5])
    again, _ = match_channels(data, CHANNELS)
    assert again.notes == data.notes


def test_files_are_brought_to_the_units_of_their_description(tmp_path):
    rows = "p;T\nbar;K\n1,0;300\n1,5;301\n2,0;302\n"
    text = (
        '[data]\nsample_time = 0.1\ndecimal = ","\ndelimiter = ";"\nunit_row = true\n'
    )
    text += '[channels.inputs]\np = "kPa"\n[channels.outputs]\nT = "degC"\n'
    text += '[records]\nfiles = ["a.csv"]\n'
    (tmp_path / "a.csv").write_text(rows)
    (tmp_path / "d.toml").write_text(text)
    data = read(tmp_path / "d.toml", root=tmp_path)
    np.testing.assert_allclose(data.records[0].u[:, 0], [100.0, 150.0, 200.0])
    np.testing.assert_allclose(data.records[0].y[:, 0], [26.85, 27.85, 28.85])
    assert (
        len(data.notes) == 2 and "a.csv: p converted from bar to kPa" in data.notes[0]
    )
    (tmp_path / "d.toml").write_text(text.replace("kPa", "mg"))
    with pytest.raises(SpecError, match="p is in 'bar', but in 'mg' according to"):
        read(tmp_path / "d.toml", root=tmp_path)


def test_a_report_scores_in_the_units_of_the_model():
    import jaxnarx as jnx

    rng = np.random.default_rng(2)
    u = rng.uniform(50, 150, 300)
    y = 20 + 0.1 * np.concatenate([[u[0]], u[:-1]])

    def made(u, y, p, t):
        inputs, outputs = [Channel("p", p)], [Channel("T", t)]
        return Dataset.from_arrays(
            u, y, inputs=inputs, outputs=outputs, sample_time=0.1
        )

    data = made(u, y, "kPa", "degC")
    pool = jnx.polynomial_pool(data.channels, input_lags=[1], output_lags=[1], degree=1)
    terms = jnx.select(pool, data, jnx.ForwardOLS(max_terms=2)).value
    net = jnx.grow(terms, data, jnx.Global()).value
    plain = {"stability": False, "diagnostics": False, "horizons": (1,)}
    other = made(u / 100, y + 273.15, "bar", "K")
    found = jnx.report(net, other, **plain)
    # in degC, as the model; in K the offset would be all of the error
    assert found.pooled_row("T").rmse == pytest.approx(0.0, abs=1e-9)
    assert any("p converted from bar to kPa" in note for note in found.notes)
