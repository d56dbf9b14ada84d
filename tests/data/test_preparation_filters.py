"""Filters and rasters: gains from theory, limits, there and back."""

import dataclasses

import numpy as np
import pytest

from jaxnarx.data import (
    Channel,
    Channels,
    Dataset,
    Decimate,
    LowPass,
    Resample,
    ToCrankAngle,
    ToTime,
    prepare,
)
from jaxnarx.data.preparation.crank_angle import crank_angles, event_times
from jaxnarx.data.preparation.resample import LEAST_SAMPLES, interpolate_on_grid, sinc
from jaxnarx.data.preparation.step import bridge_gaps
from jaxnarx.errors import DataError, SpecError

STEP = 0.01


def signal(*columns: np.ndarray, step: float = STEP, speed=None) -> Dataset:
    """One record of outputs a, b, ..., and an input `speed` [rpm] if given."""
    names = [Channel(n) for n in "abcdef"[: len(columns)]]
    return Dataset.from_arrays(
        speed,
        np.stack(columns, axis=1),
        inputs=[] if speed is None else [Channel("speed", "rpm")],
        outputs=names,
        sample_time=step,
        missing="mask",
    )


def wave(frequency: float, rows: int = 1000, step: float = STEP) -> np.ndarray:
    return np.sin(2 * np.pi * frequency * step * np.arange(rows) + 0.3)


def only(step, data: Dataset):
    return step.fit(data).apply(data).records[0]


# low-pass -------------------------------------------------------------------------


@pytest.mark.parametrize("frequency", [1.0, 5.0, 6.0, 20.0])
@pytest.mark.parametrize("order", [1, 4])
def test_a_sine_comes_out_with_the_stated_gain_and_no_phase(frequency, order):
    """Away from the ends, where what was put in at the edge has died out."""
    x = wave(frequency)
    y = only(LowPass(cutoff=5.0, order=order), signal(x)).y[:, 0]
    tangents = np.tan(np.pi * STEP * np.array([frequency, 5.0]))
    gain = 1 / (1 + (tangents[0] / tangents[1]) ** (2 * order))
    middle = slice(300, 700)
    np.testing.assert_allclose(y[middle], gain * x[middle], atol=1e-9)


def test_constants_and_lines_pass_the_low_pass():
    line = 3 - 0.2 * np.arange(300.0)
    data = signal(np.full(300, 7.0), line)
    y = only(LowPass(cutoff=5.0), data).y
    np.testing.assert_allclose(y, data.records[0].y, atol=1e-8)


def test_filtering_backwards_is_the_same():
    """No phase: a reversed record comes out reversed, gaps and all."""
    x = np.random.default_rng(0).standard_normal(400)
    x[[40, 41, 42, 43, 44, 45, 46, 200]] = np.nan
    forward = only(LowPass(cutoff=4.0), signal(x))
    backward = only(LowPass(cutoff=4.0), signal(x[::-1]))
    valid = forward.valid[:, 0]
    np.testing.assert_array_equal(valid, backward.valid[::-1, 0])
    # what is put in at the ends decays from there, at 4 Hz to 1e-8 in 2 s
    middle = valid & (np.abs(np.arange(400) - 199.5) < 150)
    a, b = forward.y[:, 0], backward.y[::-1, 0]
    np.testing.assert_allclose(a[middle], b[middle], atol=1e-8)


def test_a_gap_widens_by_what_the_filter_mixes_in():
    """A lone masked sample bears less than a tenth of the weight; a long gap grows."""
    data = np.ones(400)
    data[100], data[200:220] = np.nan, np.nan
    valid = only(LowPass(cutoff=2.0), signal(data)).valid[:, 0]
    assert list(np.flatnonzero(~valid[:150])) == [100]
    wide = np.flatnonzero(~valid[150:]) + 150
    assert wide[0] < 200 and wide[-1] > 219
    assert wide[0] + wide[-1] == 419  # on both sides alike
    # the wider the filter, the more samples it spoils
    slow = only(LowPass(cutoff=1.0), signal(data)).valid[:, 0]
    assert slow[150:].sum() < valid[150:].sum()


def test_channels_that_are_not_named_are_left_alone():
    data = signal(wave(30), wave(30))
    record = only(LowPass(cutoff=3.0, channels=("b",)), data)
    np.testing.assert_array_equal(record.y[:, 0], data.records[0].y[:, 0])
    assert np.abs(record.y[300:700, 1]).max() < 1e-6


@pytest.mark.parametrize("cutoff", [50.0, 80.0])
def test_a_cut_off_that_the_samples_cannot_hold_is_refused(cutoff):
    with pytest.raises(SpecError, match="frequencies below 50 Hz only"):
        LowPass(cutoff=cutoff).fit(signal(wave(1)))


# decimation and resampling --------------------------------------------------------


@pytest.mark.parametrize("factor", [2, 5, 7])
def test_decimation_keeps_slow_signals_and_removes_fast_ones(factor):
    """Below half and above the new Nyquist frequency: 1/300 is the stated stop band."""
    nyquist = 0.5 / (factor * STEP)
    data = signal(wave(0.5 * nyquist, 2001), wave(1.05 * nyquist, 2001))
    done = Decimate(factor=factor).fit(data).apply(data)
    record, rows = done.records[0], np.arange(0, 2001, factor)
    assert done.sample_time == pytest.approx(factor * STEP, rel=1e-12)
    assert len(record) == len(rows)
    middle = slice(2 * LEAST_SAMPLES, -2 * LEAST_SAMPLES)
    expected = data.records[0].y[rows][middle, 0]
    np.testing.assert_allclose(record.y[middle, 0], expected, atol=1 / 300)
    assert np.abs(record.y[middle, 1]).max() < 1 / 300


def test_the_filter_has_the_stated_gains():
    """Sum one, half amplitude at the edge, symmetric, 1/300 beyond the stop band."""
    for m in (2, 3, 10):
        weights = sinc(0.8 / m, 10 * m)
        assert len(weights) == 20 * m + 1
        assert weights.sum() == pytest.approx(1, rel=1e-14)
        np.testing.assert_allclose(weights, weights[::-1], rtol=1e-12, atol=1e-17)
        at = np.arange(-10 * m, 10 * m + 1)
        share = np.concatenate([[0.8], np.linspace(1, m, 400)])
        gain = np.cos(np.pi * share[:, None] / m * at[None]) @ weights
        # a window halves the gain at the edge but for its own stop band
        assert gain[0] == pytest.approx(0.5, abs=1 / 300)
        assert np.abs(gain[1:]).max() < 1 / 300


def test_constants_and_lines_survive_every_raster():
    line = 3 - 0.2 * np.arange(300.0)
    data = signal(np.full(300, 7.0), line)
    for step in (0.004, 0.01, 0.0137, 0.05):
        record = only(Resample(sample_time=step), data)
        t = step * np.arange(len(record))
        # the odd mirror image continues a line; what is left is rounding
        np.testing.assert_allclose(record.y[:, 0], 7.0, atol=1e-12)
        np.testing.assert_allclose(record.y[:, 1], 3 - 0.2 * t / STEP, atol=1e-10)


def test_the_same_sample_time_changes_nothing():
    data = signal(np.random.default_rng(0).standard_normal(100))
    record = only(Resample(sample_time=STEP), data)
    np.testing.assert_array_equal(record.y, data.records[0].y)


def test_decimation_is_resampling():
    data = signal(np.random.default_rng(0).standard_normal(300))
    a = only(Decimate(factor=4), data)
    b = only(Resample(sample_time=4 * STEP), data)
    np.testing.assert_array_equal(a.y, b.y)


def test_steps_do_not_overshoot_when_sampled_more_often():
    levels = np.repeat([0.0, 1.0, 0.2, 0.9], 25)
    y = only(Resample(sample_time=STEP / 3.3), signal(levels)).y
    assert y.min() >= 0 and y.max() <= 1


def test_more_often_and_back_is_second_order():
    """The monotone cubic's error at extremes falls with the square of the step."""

    def error(step: float) -> float:
        data = signal(wave(1.0, int(10 / step), step), step=step)
        fine, _ = prepare(data, [Resample(sample_time=step / 2.5)])
        back, _ = prepare(fine, [Resample(sample_time=step)])
        n = len(back.records[0])
        middle = slice(n // 4, 3 * n // 4)
        return np.abs(back.records[0].y - data.records[0].y[:n])[middle].max()

    coarse, fine = error(0.04), error(0.02)
    # (2 pi f T)^2 / 8 is a chord's distance from its arc, the most that can happen
    assert coarse < (2 * np.pi * 0.04) ** 2 / 8
    assert fine < coarse / 2.5


def test_a_gap_stays_a_gap_on_every_raster():
    x = wave(1.0, 600)
    x[200:260] = np.nan
    for sample_time in (0.004, 0.013, 0.05):
        record = only(Resample(sample_time=sample_time), signal(x))
        t = sample_time * np.arange(len(record))
        valid = record.valid[:, 0]
        assert not valid[(t > 2.0) & (t < 2.59)].any()
        # a filter on 20 new samples reaches no further than 10 of them
        far = (t < 1.98 - 10 * sample_time) | (t > 2.61 + 10 * sample_time)
        assert valid[far].all()


def test_a_hostile_sample_time_does_not_fill_the_memory():
    with pytest.raises(SpecError, match="Take longer steps"):
        only(Resample(sample_time=1e-12), signal(wave(1.0)))


def test_bridges_are_straight():
    x = np.array([[5.0], [1.0], [9.0], [9.0], [4.0], [0.0]])
    valid = np.array([[False], [True], [False], [False], [True], [False]])
    expected = [[1.0], [1.0], [2.0], [3.0], [4.0], [4.0]]
    np.testing.assert_allclose(bridge_gaps(x, valid), expected, rtol=1e-15)


# crank angle ----------------------------------------------------------------------


def test_an_event_lasts_as_long_as_its_speed_says():
    """180 degrees at 1000 rpm are 0.03 s; the angle of so many seconds is the events'.

    A speed that rises evenly in time has an angle that is a parabola, which the
    trapezoidal rule integrates without error.
    """
    t = event_times(np.full(50, 1000.0), 180.0)
    np.testing.assert_allclose(t, 0.03 * np.arange(50), rtol=1e-13)
    angle = crank_angles(np.full(50, 1000.0), 0.03)
    np.testing.assert_allclose(angle, 180 * np.arange(50), rtol=1e-13)
    ramp = 900 + 40 * 0.1 * np.arange(60)
    seconds = 0.1 * np.arange(60)
    expected = 6 * (900 * seconds + 20 * seconds**2)
    np.testing.assert_allclose(crank_angles(ramp, 0.1), expected, rtol=1e-13)


def test_the_faster_engine_has_the_shorter_record():
    events, lengths = 400, []
    for rpm in (800.0, 1600.0):
        data = signal(np.ones(events), speed=np.full(events, rpm), step=0.03)
        lengths.append(
            len(only(ToTime(speed="speed", degrees=180, sample_time=0.01), data))
        )
    seconds = 180 / (6 * np.array([800.0, 1600.0])) * (events - 1)
    np.testing.assert_array_equal(lengths, np.floor(seconds / 0.01 + 1e-6) + 1)


def engine_run() -> Dataset:
    """Speed between 900 and 2100 rpm and a slow signal, sampled in time."""
    t = STEP * np.arange(3000)
    speed = 1500 + 600 * np.sin(2 * np.pi * 0.1 * t)
    return signal(np.cos(2 * np.pi * 0.4 * t), speed=speed)


def test_to_crank_angle_and_back():
    """Events of 60 degrees last 5 to 11 ms, so little is lost of a signal of 0.4 Hz.

    Interpolating twice costs (2 pi f T)^2 / 8 each time, at most 1e-4 of the amplitude;
    the speed that both ways are counted by is interpolated too.
    """
    data = engine_run()
    events, _ = prepare(data, [ToCrankAngle(speed="speed", degrees=60)])
    back, _ = prepare(events, [ToTime(speed="speed", degrees=60, sample_time=STEP)])
    record, n = back.records[0], len(back.records[0])
    assert abs(n - 3000) <= 2
    middle = slice(300, n - 300)
    np.testing.assert_allclose(
        record.y[middle], data.records[0].y[:n][middle], atol=1e-3
    )
    np.testing.assert_allclose(
        record.u[middle], data.records[0].u[:n][middle], rtol=1e-3
    )


def test_a_wave_on_the_crankshaft_has_its_period_in_degrees():
    """A sine of the angle, sampled in time at any speed, is a sine over the events."""
    t = STEP * np.arange(4000)
    speed = 1500 + 300 * np.sin(t)
    angle = 6 * (1500 * t + 300 * (1 - np.cos(t)))
    data = signal(np.sin(2 * np.pi * angle / 7200), speed=speed)
    record = only(ToCrankAngle(speed="speed", degrees=360), data)
    expected = np.sin(2 * np.pi * np.arange(len(record)) / 20)
    np.testing.assert_allclose(record.y[20:-20, 0], expected[20:-20], atol=5e-3)


def test_the_nominal_sample_time_is_fixed_by_the_training_data():
    data = engine_run()
    fitted = ToCrankAngle(speed="speed", degrees=180).fit(data)
    mean = data.records[0].u.mean()
    assert fitted.sample_time == pytest.approx(180 / (6 * mean), rel=1e-5)
    fast = dataclasses.replace(data.records[0], u=1.5 * data.records[0].u)
    other = fitted.apply(dataclasses.replace(data, records=(fast,)))
    assert other.sample_time == fitted.sample_time


def test_a_standing_engine_is_named_with_its_row():
    data = engine_run()
    u = data.records[0].u.copy()
    u[77:80] = 0.0
    stopped = dataclasses.replace(data.records[0], u=u, start_row=1000)
    data = dataclasses.replace(data, records=(stopped,))
    for step in (
        ToTime(speed="speed", degrees=180, sample_time=0.05),
        ToCrankAngle(speed="speed", degrees=180),
    ):
        with pytest.raises(DataError, match="speed is 0 in row 1077, and 3 time") as e:
            step.fit(data).apply(data)
        assert (e.value.channel, e.value.row) == ("speed", 1077)


def test_a_masked_standstill_does_not_count():
    data = engine_run()
    record = data.records[0]
    u, valid = record.u.copy(), record.valid.copy()
    u[77:80], valid[77:80, 0] = -1.0, False
    masked = dataclasses.replace(record, u=u, valid=valid)
    data = dataclasses.replace(data, records=(masked,))
    bridge = np.interp(np.arange(76, 81), [76, 80], [u[76, 0], u[80, 0]])
    u = u.copy()
    u[76:81, 0] = bridge
    step = ToTime(speed="speed", degrees=180, sample_time=0.05)
    other = dataclasses.replace(data, records=(dataclasses.replace(masked, u=u),))
    np.testing.assert_array_equal(only(step, data).y, only(step, other).y)


def test_a_speed_in_other_units_is_refused():
    data = engine_run()
    scaled = Channels((Channel("speed", "-"),), data.channels.outputs)
    data = dataclasses.replace(data, channels=scaled)
    with pytest.raises(SpecError, match="speed is in '-'; crank angle needs"):
        ToCrankAngle(speed="speed", degrees=180).fit(data)


def test_the_grid_begins_at_the_first_sample_and_ends_before_the_last():
    rng = np.random.default_rng(2)
    at = np.cumsum(rng.uniform(0.5, 1.5, 200))
    for step in (0.3, 1.0, 4.0):
        x, valid = interpolate_on_grid(
            at, at[:, None], np.ones((200, 1), bool), step=step, name="r"
        )
        assert len(x) == int((at[-1] - at[0]) / step) + 1 and valid.all()
        # the value is the position itself: a line
        np.testing.assert_allclose(
            x[:, 0], at[0] + step * np.arange(len(x)), atol=1e-10
        )
