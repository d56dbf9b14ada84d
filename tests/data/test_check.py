"""The look at the data: every finding on data made to have it, none on clean data."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from jaxnarx.data import Dataset, check, read_split, suggest_lags
from jaxnarx.errors import SpecError


def system(rows=3000, delay=0, seed=0):
    """A white input and y(t) = 0.8 y(t-1) + u(t - 1 - delay) + small noise."""
    rng = np.random.default_rng(seed)
    u, noise = rng.normal(size=rows), 0.05 * rng.normal(size=rows)
    y = np.zeros(rows)
    for t in range(1, rows):
        past = u[t - 1 - delay] if t > delay else 0.0
        y[t] = 0.8 * y[t - 1] + past + noise[t]
    return u, y


def dataset(u, y, **options):
    u = np.atleast_2d(np.asarray(u).T).T
    inputs = [f"u{i + 1}" for i in range(u.shape[1])]
    units = dict.fromkeys([*inputs, "y"], "1")
    return Dataset.from_arrays(
        u, y, inputs=inputs, outputs=["y"], sample_time=0.1, units=units, **options
    )


def kinds(findings):
    return {f.kind for f in findings}


def test_clean_data_give_no_warning():
    findings = check(dataset(*system()))
    assert kinds(findings) <= {"dead time"}
    assert findings.is_okay and all(f.severity == "note" for f in findings)


@pytest.mark.parametrize("scale", [1e-150, 1e150])
def test_findings_are_the_same_in_any_unit(scale):
    u, y = system(rows=600)
    u = np.stack([u, 2 * u], axis=1)
    expected = [(f.kind, f.channel) for f in check(dataset(u, y))]
    for data in (dataset(u * scale, y / scale), dataset(u * scale, y * scale)):
        findings = check(data)
        assert [(f.kind, f.channel) for f in findings] == expected
        assert "is 2 times u1" in str(findings)


def test_constant_channels():
    u, y = system()
    (found,) = check(dataset(np.stack([u, 0 * u + 3], 1), y)).of("constant")
    assert found.severity == "warning" and found.channel == "u2"
    assert "input u2 is constant at 3" in found.message
    findings = check(dataset(u, 0 * y))
    assert not findings.is_okay and "output y is constant" in str(findings)


def test_output_constant_in_one_record_only_is_a_note():
    u, y = system()
    data = Dataset.from_arrays(
        [u, u[::-1]], [y, 0 * y], inputs=["u"], outputs=["y"], sample_time=1.0
    )
    (found,) = check(data).of("constant")
    assert (found.severity, found.record) == ("note", "record 2")
    assert "NRMSE" in found.message


@pytest.mark.parametrize(
    ("copy", "said"),
    [
        (lambda u: u, "u2 equals u1"),
        (lambda u: -2.5 * u, "u2 is -2.5 times u1"),
        (lambda u: 2 * u + 7, "u2 is 2 times u1 plus 7"),
    ],
)
def test_duplicates_name_both_channels(copy, said):
    u, y = system()
    (found,) = check(dataset(np.stack([u, copy(u)], 1), y)).of("duplicate")
    assert said in found.message and found.channel == "u2"


def test_nearly_equal_channels_are_not_duplicates():
    u, y = system()
    near = u + 1e-3 * np.random.default_rng(5).normal(size=u.size)
    assert not check(dataset(np.stack([u, near], 1), y)).of("duplicate")


def test_saturation_gives_rows_and_time_spans():
    u, y = system()
    y[500:540] = y.max() + 1
    (found,) = check(dataset(u, y)).of("saturated")
    assert found.channel == "y" and found.rows == ((500, 539),)
    assert found.times == ((50.0, 53.9),)
    assert "maximum" in found.message and "50 to 53.9 s" in found.message


def test_a_frozen_output_is_found_and_a_stepped_input_is_not():
    u, y = system()
    y[1000:1400] = y[1000]
    steps = np.repeat(np.random.default_rng(1).uniform(size=100), 30)
    findings = check(dataset(np.stack([u, steps], 1), y))
    (found,) = findings.of("stuck")
    assert found.channel == "y" and found.rows == ((1000, 1399),)
    assert not findings.of("saturated")


def test_a_switch_is_no_saturation():
    u, y = system()
    switch = (np.arange(u.size) % 1000 < 100).astype(float)
    assert not check(dataset(np.stack([u, switch], 1), y)).of("saturated")


def test_spikes_are_listed():
    rows = np.arange(2000)
    y = np.sin(rows / 40) + 0.01 * np.random.default_rng(2).normal(size=2000)
    y[[300, 301, 1200]] += 3
    (found,) = check(dataset(system(2000)[0], y)).of("spikes")
    assert [r[0] for r in found.rows] == [300, 301, 1200]
    assert found.channel == "y" and "t = 30, 30.1, 120 s" in found.message


def test_gaps_are_counted():
    u, y = system()
    y[100:150] = np.nan
    y[7] = np.inf
    (found,) = check(dataset(u, y, missing="mask")).of("missing")
    assert "51 missing sample(s) in 2 gap(s)" in found.message
    assert found.rows == ((7, 7), (100, 149)) and found.severity == "note"


def test_too_few_rows():
    u, y = system(30)
    findings = check(dataset(u, y), max_lag=20)
    assert "10 rows remain after lag 20; need >= 20" in str(findings)
    assert not check(dataset(u, y), max_lag=40).is_okay


def test_identical_records_and_missing_units():
    u, y = system()
    data = Dataset.from_arrays(
        [u, u.copy()], [y, y], inputs=["u"], outputs=["y"], sample_time=1.0
    )
    findings = check(data)
    assert "record 2 has the same contents as record 1" in str(findings)
    assert "no unit is stated for u, y" in findings.of("units")[0].message


@pytest.mark.parametrize("sines", [1, 3])
def test_sines_excite_twice_their_number(sines):
    t = np.arange(3000)
    u = sum(np.sin((0.2 + 0.45 * k) * t + k) for k in range(sines))
    y = system()[1]
    (found,) = check(dataset(u, y)).of("excitation")
    assert f"order {2 * sines} only" in found.message and "need 21" in found.message
    assert not check(dataset(u, y), max_lag=2 * sines - 1).of("excitation")


@pytest.mark.parametrize("delay", [0, 6, 30])
def test_dead_time_is_found_also_for_a_coloured_input(delay):
    u, _ = system()
    slow = np.zeros_like(u)
    for t in range(1, u.size):
        slow[t] = 0.95 * slow[t - 1] + u[t]
    y = np.zeros_like(u)
    for t in range(delay + 1, u.size):
        y[t] = 0.8 * y[t - 1] + slow[t - 1 - delay]
    (found,) = check(dataset(slow, y)).of("dead time")
    assert f"after about {delay + 1} sample" in found.message
    assert (found.severity == "warning") == (delay + 1 > 20)


def test_closed_loop_is_told_from_open_loop():
    rng = np.random.default_rng(3)
    u, y, r = np.zeros(4000), np.zeros(4000), rng.normal(size=4000)
    for t in range(1, 4000):
        y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1] + 0.7 * rng.normal()
        u[t] = 0.5 * r[t] - 0.8 * y[t - 1]
    (found,) = check(dataset(u, y)).of("closed loop")
    assert "input u1 follows past values of y" in found.message
    assert not check(dataset(*system())).of("closed loop")


def test_independent_channels_have_no_dead_time_or_feedback():
    u, y = system()[0], system(seed=8)[1]
    findings = check(dataset(u, y))
    assert not findings.of("dead time") and not findings.of("closed loop")
    assert suggest_lags(dataset(u, y)).dead_time == {("u1", "y"): None}


def test_findings_are_sorted_and_survive_json():
    u, y = system()
    y[500:540] = y.max() + 1
    findings = check(dataset(np.stack([u, 0 * u], 1), 0 * y))
    told = json.loads(json.dumps(findings.to_dict()))
    severities = [f["severity"] for f in told["findings"]]
    assert severities == sorted(severities, key=["error", "warning", "note"].index)
    assert told["counts"]["error"] == 1 and told["is_okay"] is False
    assert str(check(dataset(*system(seed=4)), max_lag=5))


def test_many_of_a_kind_are_told_in_a_few_lines():
    rng = np.random.default_rng(0)
    time = np.arange(400.0)
    u = np.stack([np.sin(time / (3 + k)) for k in range(9)], axis=1)
    data = dataset(u, rng.normal(size=400))
    findings = check(data)
    assert len(findings.of("excitation")) == 9
    lines = str(findings).splitlines()
    own = [n for n in lines if "persistently" in n or "(excitation" in n]
    assert len(own) == 4 and "u1" in own[0] and "u2" in own[1]
    assert own[-1] == ("warning: ... and 6 more (excitation of u4, u5, u6, u7, u8, u9)")


def test_bad_max_lag():
    with pytest.raises(SpecError, match="max_lag must be at least 1"):
        check(dataset(*system(50)), max_lag=0)


def test_suggested_lags_cover_delay_and_settling():
    quick = suggest_lags(dataset(*system()))
    assert quick.input_lags == (0, 1, 2, 4, 8, 16) and quick.output_lags == (1, 2)
    late = suggest_lags(dataset(*system(delay=25)))
    assert late.input_lags[0] == 0 and 26 in late.input_lags
    assert late.dead_time["u1", "y"] == 26
    assert "u1 -> y: dead time 2.6 s" in str(late)


def test_padding_with_a_silent_record_does_not_move_the_delay():
    u, y = system(delay=4)
    one = suggest_lags(dataset(u, y))
    parts = Dataset.from_arrays(
        [u[:1700], u[1700:]],
        [y[:1700], y[1700:]],
        inputs=["u1"],
        outputs=["y"],
        sample_time=0.1,
    )
    assert suggest_lags(parts).dead_time == one.dead_time


@pytest.mark.parametrize("rows", [1, 5, 60])
def test_tiny_and_autonomous_data_are_survived(rows):
    y = system()[1][:rows]
    alone = Dataset.from_arrays(None, y, inputs=[], outputs=["y"], sample_time=1.0)
    for data in (alone, dataset(np.ones(rows), y), dataset(y, np.ones(rows))):
        assert str(check(data))
        assert suggest_lags(data).input_lags[:2] == (0, 1)
    assert not check(alone[[]]).is_okay


ROOT = Path(__file__).parents[2]
FOLDER = Path(os.environ.get("JAXNARX_DATA", ROOT / "../shared/data"))


@pytest.mark.slow
@pytest.mark.skipif(
    not (FOLDER / "gengine1").is_dir(),
    reason="gengine1 is not in JAXNARX_DATA (default ../shared/data)",
)
def test_gengine1_is_read_and_checked():
    split = read_split(ROOT / "experiments/gengine1/gengine1.toml", root=FOLDER)
    assert split.train is not None and split.test is not None
    findings, lags = check(split.train), suggest_lags(split.train)
    assert (len(split.train), len(split.test), split.validate) == (20, 6, None)
    assert split.train.samples == 247_844
    assert split.all.channels.output_names[4] == "NOx"
    np.testing.assert_allclose(
        split.train.records[0].u[0, :2], [-0.107029012, 1.54308670]
    )
    assert findings.is_okay and "O2" in {f.channel for f in findings.of("saturated")}
    assert {0, 1, 2, 4, 8, 16, 32, 64} <= set(lags.input_lags)
    # the gases take .6 to .8 s to the analyser, the exhaust remembers for a minute
    assert lags.dead_time["load", "NOx"] in range(4, 9)
    assert lags.filters[0] < 2 < 10 < lags.filters[-1]
