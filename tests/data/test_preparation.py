"""Preparation: what every step promises, and values that survive JSON."""

import dataclasses
import json

import numpy as np
import pytest
from measurements import columns, engine, levels, pooled, same

from jaxnarx.data import (
    Channel,
    Channels,
    Dataset,
    Decimate,
    Detrend,
    Hampel,
    LowPass,
    Preparation,
    RemoveOffset,
    Resample,
    Scale,
    Shift,
    ToCrankAngle,
    ToTime,
    match_channels,
    prepare,
)
from jaxnarx.data.preparation.cleaning import outliers
from jaxnarx.data.preparation.codec import STEP_KINDS
from jaxnarx.errors import DataError, SpecError

STEPS = [
    RemoveOffset(),
    RemoveOffset(kind="first"),
    RemoveOffset(kind="given", values={"speed": 900.0}),
    Detrend(),
    Detrend(keep_level=False, channels=("NOx",)),
    Hampel(half_width=4),
    LowPass(cutoff=1.5, order=3),
    Decimate(factor=3),
    Resample(sample_time=0.07),
    Resample(sample_time=0.23),
    ToTime(speed="speed", degrees=720, sample_time=0.1),
    ToCrankAngle(speed="speed", degrees=720),
    Scale(kind="min-max"),
    Scale(kind="mean"),
    Scale(kind="standard", channels=("NOx",)),
    Shift(samples={"NOx": 2, "speed": -1}),
]
LEVELS = [s for s in STEPS if isinstance(s, RemoveOffset | Scale)]


def name(step) -> str:
    return f"{type(step).__name__}-{STEPS.index(step)}"


every_step = pytest.mark.parametrize("step", STEPS, ids=name)


@pytest.fixture(scope="module")
def data() -> Dataset:
    return engine(150, 110, 200)


# what every step promises ---------------------------------------------------------


@every_step
def test_masked_samples_have_no_influence(step, data):
    """Other numbers under the mask: the same fit, the same result, bit by bit."""

    def spoilt(record):
        x = np.where(record.valid, columns(record), 1e6)
        return dataclasses.replace(record, u=x[:, :1], y=x[:, 1:])

    other = dataclasses.replace(data, records=tuple(map(spoilt, data)))
    a, b = step.fit(data), step.fit(other)
    assert a == b
    same(a.apply(data), b.apply(other))


@every_step
def test_record_by_record_is_all_at_once(step, data):
    fitted = step.fit(data)
    whole = fitted.apply(data)
    for n in range(len(data)):
        same(fitted.apply(data[n]), whole[n])


@every_step
def test_values_are_finite_and_held_where_masked(step, data):
    done = step.fit(data).apply(data)
    for record in done:
        x = columns(record)
        assert np.isfinite(x).all() and record.valid.shape == x.shape
        inner = ~record.valid[1:] & np.maximum.accumulate(record.valid, axis=0)[1:]
        np.testing.assert_array_equal(x[1:][inner], x[:-1][inner])


@every_step
def test_single_precision_stays(step, data):
    def single(record):
        u, y = record.u.astype(np.float32), record.y.astype(np.float32)
        return dataclasses.replace(record, u=u, y=y)

    light = dataclasses.replace(data, records=tuple(map(single, data)))
    for record in step.fit(light).apply(light):
        assert record.u.dtype == record.y.dtype == np.float32


@every_step
def test_a_fitted_step_survives_json(step, data):
    fitted = step.fit(data)
    table = json.loads(json.dumps(fitted.to_dict(), allow_nan=False))
    whole = Preparation((fitted,), data.channels, data.sample_time)
    read = Preparation.from_dict(json.loads(json.dumps(whole.to_dict())))
    assert STEP_KINDS[table["kind"]] is type(fitted)
    assert read == whole
    same(read.apply(data), fitted.apply(data))
    assert fitted.describe() == read.steps[0].describe()


# How many rows a shift cuts depends on the channels that are there.
@pytest.mark.parametrize(
    "step", [s for s in STEPS if not isinstance(s, Shift)], ids=name
)
def test_a_channel_that_no_step_needs_may_be_missing(step, data):
    fitted, only = step.fit(data), Channels((), (Channel("speed"),))
    less = match_channels(data, only)[0]
    same(fitted.apply(less), match_channels(fitted.apply(data), only)[0])


@every_step
def test_a_channel_masked_throughout_is_named(step, data):
    record = data.records[0]
    dead = dataclasses.replace(
        record, valid=record.valid & np.array([[True, False]]), name="dead"
    )
    only = dataclasses.replace(data, records=(dead,))
    with pytest.raises(DataError, match="NOx has .* ?valid sample"):
        step.fit(only).apply(only)


def test_unknown_channels_are_suggested(data):
    for step in (
        RemoveOffset(kind="given", values={"sped": 1.0}),
        Detrend(channels=("sped",)),
        Hampel(channels=("sped",)),
        LowPass(cutoff=1.0, channels=("sped",)),
        Scale(channels=("sped",)),
        Shift(samples={"sped": 1}),
        ToTime(speed="sped", degrees=180, sample_time=0.1),
        ToCrankAngle(speed="sped", degrees=180),
    ):
        with pytest.raises(SpecError, match="Did you mean 'speed'"):
            step.fit(data)


def test_undo_is_refused_where_something_is_lost(data):
    for step in STEPS:
        if not isinstance(step, RemoveOffset | Scale | Shift):
            with pytest.raises(SpecError, match="cannot be undone"):
                step.fit(data).undo(data)


# levels: offset and scale ---------------------------------------------------------


@pytest.mark.parametrize("step", LEVELS, ids=name)
def test_levels_are_undone(step, data):
    """Two roundings of numbers up to 2000, undone: a few parts in 2^52."""
    fitted = step.fit(data)
    same(fitted.undo(fitted.apply(data)), data, rtol=1e-14, atol=1e-12)


@pytest.mark.parametrize("step", [s for s in LEVELS if not getattr(s, "values", 0)])
def test_fitted_to_its_own_result_it_changes_nothing(step, data):
    once, _ = prepare(data, [step])
    twice, _ = prepare(once, [step])
    same(twice, once, rtol=1e-12, atol=1e-12)


def test_offsets_are_means_or_first_samples(data):
    mean = RemoveOffset().fit(data)
    first = RemoveOffset(kind="first").fit(data)
    for j, channel in enumerate(("speed", "NOx")):
        x = pooled(data, j)
        assert mean.offset[channel] == pytest.approx(x.mean(), rel=1e-14)
        assert first.offset[channel] == x[0]
        assert abs(pooled(mean.apply(data), j).mean()) < 1e-11  # N eps times 2000


def test_scaled_channels_have_the_stated_size(data):
    for j in range(2):
        low_high = pooled(prepare(data, [Scale(kind="min-max")])[0], j)
        assert (low_high.min(), low_high.max()) == (0.0, 1.0)
        mean = pooled(prepare(data, [Scale(kind="mean")])[0], j)
        assert mean.mean() == pytest.approx(1.0, rel=1e-13)
        standard = pooled(prepare(data, [Scale(kind="standard")])[0], j)
        assert standard.mean() == pytest.approx(0.0, abs=1e-13)
        assert standard.std() == pytest.approx(1.0, rel=1e-13)


def test_units_follow_the_scale_and_return(data):
    done, preparation = prepare(data, [Scale(channels=("NOx",))])
    assert [c.unit for c in done.channels.all] == ["rpm", "-"]
    assert preparation.undo(done).channels == data.channels


@pytest.mark.parametrize("kind", ["min-max", "standard"])
def test_a_constant_channel_is_only_moved(kind):
    done, preparation = prepare(levels([0.1] * 12), [Scale(kind=kind)])
    assert np.all(done.records[0].y == 0)
    assert "only moved" in preparation.describe()


def test_mean_scaling_guards_means_near_zero():
    x = np.array([-1.0, 1.0, -1.0, 1.0])
    assert Scale(kind="mean").fit(levels(x)).gain["y"] == 1.0
    assert Scale(kind="mean").fit(levels(3 * x)).gain["y"] == 3.0
    assert Scale(kind="mean").fit(levels(0 * x)).gain["y"] == 1.0
    assert Scale(kind="mean").fit(levels(x - 5)).gain["y"] == 5.0


# trends ---------------------------------------------------------------------------


def test_lines_vanish_and_levels_stay():
    t = 0.5 * np.arange(40)
    lines = np.stack([3 + 2 * t, -7 - 0.1 * t], axis=1)
    data = Dataset.from_arrays(
        None, lines, inputs=[], outputs=["a", "b"], sample_time=0.5
    )
    kept, _ = prepare(data, [Detrend()])
    gone, _ = prepare(data, [Detrend(keep_level=False)])
    # a straight line through numbers up to 40: their rounding
    level = np.broadcast_to(lines.mean(axis=0), lines.shape)
    np.testing.assert_allclose(kept.records[0].y, level, atol=1e-13)
    np.testing.assert_allclose(gone.records[0].y, 0, atol=1e-13)


def test_detrending_is_that_of_least_squares(data):
    """The oracle is a polynomial fit of degree one to the valid samples."""
    done = Detrend(keep_level=False).fit(data).apply(data)
    for before, after in zip(data, done, strict=True):
        t = 0.1 * np.arange(len(before))
        for j in range(2):
            known = before.valid[:, j]
            fit = np.polynomial.Polynomial.fit(t[known], columns(before)[known, j], 1)
            expected = columns(before)[known, j] - fit(t[known])
            np.testing.assert_allclose(columns(after)[known, j], expected, atol=1e-10)


def test_detrending_is_a_projection_and_can_be_restored(data):
    step = Detrend()
    lines = step.lines(data)
    once = step.apply(data)
    same(step.apply(once), once, atol=1e-10)
    for record, back in zip(data, step.restore(once, lines), strict=True):
        x, z = columns(record), columns(back)
        np.testing.assert_allclose(z[record.valid], x[record.valid], rtol=1e-13)
    with pytest.raises(SpecError, match="has no record 'r0'"):
        step.restore(once, {})


# outliers -------------------------------------------------------------------------


def test_spikes_are_masked_and_counted(data):
    done, preparation = prepare(data, [Hampel()])
    for record in done:
        masked = np.flatnonzero(~record.valid[:, 1])
        np.testing.assert_array_equal(masked, [17, 31, 50, 51, 52, 53])
        assert record.y[17, 0] == record.y[16, 0]
    assert preparation.report.count_masked(0) == {"NOx": 6}
    assert preparation.report.items[0].rows == {"NOx": ((17, 17), (31, 31))}
    assert "NOx: 6 masked" in str(preparation.report)


def test_hampel_is_the_definition():
    """Against a loop over windows, gaps and all."""
    rng = np.random.default_rng(0)
    x = 0.1 * np.arange(90) + rng.standard_t(1.5, 90)
    valid = rng.uniform(size=90) > 0.15
    found = outliers(x, valid, 5, 3.0, 0.5)
    for i in range(90):
        first = min(max(i - 5, 0), 90 - 11)
        window = x[first : first + 11][valid[first : first + 11]]
        middle = np.median(window)
        scale = 1.4826 * np.median(np.abs(window - middle))
        far = abs(x[i] - middle) > max(3 * scale, 0.5)
        assert found[i] == (valid[i] and window.size > 5 and far)
    assert 3 < found.sum() < 30


def test_windows_of_equal_values_are_judged_by_their_mean_deviation():
    flat = np.full(60, 4.0)
    flat[30] = 9.0
    assert list(np.flatnonzero(~prepared(flat, Hampel()))) == [30]
    # the last digit of a sensor flickers: no spike, though the MAD is zero
    digit = np.where(np.arange(60) % 5 == 0, 4.1, 4.0)
    assert prepared(digit, Hampel()).all()


def prepared(x, step) -> np.ndarray:
    """Which samples of a single channel stay valid."""
    return prepare(levels(x), [step])[0].records[0].valid[:, 0]


def test_steps_are_no_outliers():
    """In a monotone window a sample is its own median: nothing deviates."""
    assert prepared(np.repeat([0.0, 5.0, -3.0, 9.0], 20), Hampel()).all()
    assert prepared(np.arange(60.0) ** 3, Hampel(sigmas=0.1, floor=0)).mean() > 0.7


def test_outliers_do_not_depend_on_unit_or_direction(data):
    fitted = Hampel().fit(data)
    valid = [r.valid for r in fitted.apply(data)]

    def turned(record):
        return dataclasses.replace(record, u=-3 * record.u, y=-3 * record.y)

    other = dataclasses.replace(data, records=tuple(map(turned, data)))
    for a, b in zip(valid, Hampel().fit(other).apply(other), strict=True):
        np.testing.assert_array_equal(a, b.valid)


# alignment ------------------------------------------------------------------------


def test_a_shift_aligns_a_delayed_channel():
    u = np.random.default_rng(1).standard_normal(80)
    data = Dataset.from_arrays(
        u, np.roll(u, 4), inputs=["u"], outputs=["y"], sample_time=1
    )
    for samples in ({"y": 4}, {"u": -4}, {"u": -1, "y": 3}):
        record = Shift(samples=samples).fit(data).apply(data).records[0]
        assert len(record) == 76
        np.testing.assert_array_equal(record.u, record.y)
    step = Shift(samples={"u": 2, "y": -1})
    back = step.undo(step.apply(data)).records[0]
    np.testing.assert_array_equal(back.u[:, 0], u[3:-3])
    assert back.start_row == 3
