"""Time columns: units, gaps and jitter."""

import numpy as np
import pandas as pd
import pytest
from described import HEADER, refuse, rows, write

from jaxnarx.data import Dataset, read
from jaxnarx.errors import DataError, SpecError


@pytest.fixture(autouse=True)
def no_environment(monkeypatch):
    monkeypatch.delenv("JAXNARX_DATA", raising=False)


def timed(t, *, name="t", **options):
    """A series with these stamps."""
    frame = pd.DataFrame({name: t, "y": np.arange(len(t)) % 7.0})
    return Dataset.from_frame(frame, inputs=[], outputs=["y"], time=name, **options)


# units ----------------------------------------------------------------------------


@pytest.mark.parametrize("step", [20, 100, 1000, 60])
def test_stamps_that_look_like_milliseconds_are_refused_until_said(step):
    t = step * np.arange(50)
    with pytest.raises(DataError, match=rf"by {step} a row.*time_unit=\"ms\"") as e:
        timed(t)
    assert e.value.channel == "t"
    assert timed(t, time_unit="ms").sample_time == pytest.approx(step / 1e3)
    assert timed(t, time_unit="s").sample_time == step
    # said by the sample time beside it, too
    assert timed(t, sample_time=step).sample_time == step
    with pytest.raises(DataError, match="seems to be in milliseconds"):
        timed(t, sample_time=step / 1e3)


def test_a_long_run_of_whole_numbers_looks_like_milliseconds_as_well():
    # 10 ms for 50 minutes, or 10 s for five weeks
    with pytest.raises(DataError, match="in all, which looks like milliseconds"):
        timed(10 * np.arange(300_000))
    assert timed(10 * np.arange(10_000)).sample_time == 10
    assert timed(0.5 * np.arange(300_000)).sample_time == 0.5


@pytest.mark.parametrize(
    ("name", "seconds"),
    [("t_ms", 0.1), ("Time [ms]", 0.1), ("time(us)", 1e-4), ("t/min", 6e3)]
    + [("time [s]", 100), ("t.µs", 1e-4), ("clock h", 3.6e5), ("msec", 0.1)],
)
def test_the_name_of_the_column_tells_its_unit(name, seconds):
    assert timed(100 * np.arange(9), name=name).sample_time == pytest.approx(seconds)


def test_the_unit_row_and_the_description_tell_the_unit(tmp_path):
    text = (HEADER + "ms,rpm,Nm,ppm,\n" + rows()).replace("0.", "10")
    text = (
        HEADER
        + "ms,rpm,Nm,ppm,\n"
        + "".join(f"{100 * i},{i},{i},{i % 5},x\n" for i in range(20))
    )
    said = 'time = "t"\nunit_row = true'
    assert read(write(tmp_path, text, data=said)).sample_time == pytest.approx(0.1)
    # a description is nearer than the file
    path = write(tmp_path, text, data=said + '\ntime_unit = "s"')
    assert read(path).sample_time == 100
    path = write(tmp_path, text, data=said + '\ntime_unit = "sec"')
    error = refuse(SpecError, path, "d.toml", "'s', 'ms', 'us', 'min', 'h'")
    assert error.field == "time_unit"


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_dates_and_durations_have_units_of_their_own(unit):
    since = pd.to_timedelta(100 * np.arange(9), unit="s")
    for t in (since, pd.Timestamp("2024-05-31") + since):
        assert timed(t.as_unit(unit)).sample_time == 100


# gaps and jitter ------------------------------------------------------------------


def jittery(share, count=400, step=0.1):
    """Stamps off their grid by up to `share` of a step, at random."""
    rng = np.random.default_rng(5)
    return step * (np.arange(count) + rng.uniform(-share, share, count))


@pytest.mark.parametrize("missing", ["refuse", "split"])
@pytest.mark.parametrize("share", [0.02, 0.2, 0.3])
def test_jitter_is_called_jitter_and_is_no_gap(share, missing):
    t = jittery(share)
    with pytest.raises(DataError, match=r"not uniform.*jitter") as caught:
        timed(t, missing=missing)
    assert "jump" not in str(caught.value)
    # the stated grid is kept to by less than half a step, so the stamps are rough
    data = timed(t, sample_time=0.1, missing=missing)
    assert len(data) == 1 and data.samples == len(t)


def test_true_gaps_are_found_among_jitter():
    t = jittery(0.3)
    t[100:] += 0.1  # one sample is lost
    t[250:] += 7.0
    with pytest.raises(DataError, match="2 such place"):
        timed(t, sample_time=0.1)
    data = timed(t, sample_time=0.1, missing="split")
    assert [len(r) for r in data] == [100, 150, 150]


def test_one_late_stamp_is_not_a_gap_and_a_lost_last_row_is():
    t = 0.1 * np.arange(50)
    late = np.where(np.arange(50) == 20, t + 0.07, t)
    with pytest.raises(DataError, match="jitter 70 %"):
        timed(late)
    t[-1] += 0.1
    assert [len(r) for r in timed(t, missing="split")] == [49, 1]
