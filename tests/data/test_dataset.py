"""Datasets from arrays and frames: shapes, types, missing samples, matching."""

import subprocess
import sys
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from jaxnarx.data import Channel, Channels, Dataset, match_channels
from jaxnarx.data.sampling import positive_sample_time
from jaxnarx.errors import DataError, SpecError

NAN = np.nan


def make(u, y, **options):
    settings = {"inputs": ["N", "TRQ"], "outputs": ["NOx"], "sample_time": 0.01}
    return Dataset.from_arrays(u, y, **(settings | options))


def random(rows, columns=2, seed=0):
    return np.random.default_rng(seed).normal(size=(rows, columns))


def frame(rows=50):
    x = random(rows, 3)
    return pd.DataFrame(
        {"t": 0.1 * np.arange(rows), "N": x[:, 0], "TRQ": x[:, 1], "NOx": x[:, 2]}
    )


def from_frame(table, **options: Any):
    options = {"inputs": ["N", "TRQ"], "outputs": ["NOx"]} | options
    return Dataset.from_frame(table, **options)


# shapes and types -----------------------------------------------------------------


def test_records_keep_values_and_lengths():
    us, ys = [random(30), random(20, seed=1)], [random(30, 1), random(20, 1)]
    data = make(us, ys, names=["a", "b"], units={"N": "rpm"})
    assert data.names == ["a", "b"] and [len(r) for r in data] == [30, 20]
    np.testing.assert_array_equal(data.records[1].u, us[1])
    assert data.channels.inputs[0] == Channel("N", "rpm")
    assert all(r.valid.all() for r in data)


def test_the_arrays_given_are_not_shared():
    u = random(5)
    data = make(u, np.ones(5))
    u[:] = 0
    assert (data.records[0].u != 0).all()


@pytest.mark.parametrize("kind", [int, bool, np.int8, np.float16, list, tuple])
def test_unambiguous_numbers_become_float64(kind):
    y = np.array([1, 0, 1, 1])
    y = kind(y) if kind in (list, tuple) else y.astype(kind)
    record = make(random(4), y).records[0]
    assert record.y.dtype == np.float64
    np.testing.assert_array_equal(record.y[:, 0], [1, 0, 1, 1])


def test_float32_stays_only_when_all_channels_have_it():
    u, y = random(4).astype(np.float32), np.ones(4, np.float32)
    both = make(u, y).records[0]
    mixed = make(u, y.astype(np.float64)).records[0]
    assert both.u.dtype == both.y.dtype == np.float32
    assert mixed.u.dtype == mixed.y.dtype == np.float64


def test_no_inputs_is_a_free_series():
    data = make(None, np.arange(3.0), inputs=[])
    assert data.records[0].u.shape == (3, 0)


@pytest.mark.parametrize(
    ("u", "said"),
    [
        (random(4).astype(str), "text"),
        (random(4) + 1j, "complex"),
        (np.array([[1, None]] * 4), "Python objects"),
        (random(4).T, "transposed: pass u.T"),
        (random(4, 3), "(4, 3), expected (time, 2) for N, TRQ"),
        (random(4)[None], "list(u)"),
        (random(4).tolist(), "nested list"),
        ([[1.0, 2.0], [3.0]], "nested list"),
        (np.ones(4), "expected (time, 2)"),
        ([], "empty list"),
    ],
)
def test_ambiguous_arrays_are_refused_with_the_shape_expected(u, said):
    with pytest.raises(SpecError) as error:
        make(u, np.ones(4))
    assert said in str(error.value)
    assert str(error.value.field).startswith("u")


def test_masked_arrays_do_not_lose_their_mask():
    y = np.ma.masked_array(np.arange(4), mask=np.arange(4) == 2)
    with pytest.raises(DataError, match="NOx has 1 NaN, first at row 2"):
        make(random(4), y)


def test_unequal_lengths_name_channels_and_lengths():
    with pytest.raises(DataError, match=r"run2: N, TRQ has 7 rows and NOx has 6"):
        make([random(5), random(7)], [np.ones(5), np.ones(6)], names=["run1", "run2"])


@pytest.mark.parametrize("step", [0, -1.0, np.nan, np.inf, True])
def test_sample_time_must_be_positive(step):
    with pytest.raises(SpecError, match="sample_time must be a positive finite"):
        make(random(4), np.ones(4), sample_time=step)


@pytest.mark.parametrize("step", ["0.1", None, [0.1], 1j])
def test_sample_time_must_be_a_number(step):
    with pytest.raises(SpecError, match="sample_time must be a positive finite"):
        positive_sample_time(step)


def test_wrong_names_and_units_are_refused():
    with pytest.raises(SpecError, match="'TRW'.*Did you mean 'TRQ'"):
        make(random(4), np.ones(4), units={"TRW": "Nm"})
    with pytest.raises(SpecError, match="different name for each of the 2"):
        make([random(4)] * 2, [np.ones(4)] * 2, names=["a", "a"])
    with pytest.raises(SpecError, match="outputs is empty"):
        make(random(4), np.ones((4, 0)), outputs=[])


@pytest.mark.parametrize(
    ("scale", "dtype", "word"),
    [
        (1e200, np.float64, "overflow"),
        (1e-200, np.float64, "underflow"),
        (1e25, np.float32, "overflow"),
    ],
)
def test_scales_whose_squares_leave_the_type_are_refused(scale, dtype, word):
    u = (random(4) * [1, scale]).astype(dtype)
    with pytest.raises(DataError, match=f"TRQ has values up to .*{word}.*unit") as e:
        make(u, np.ones(4, dtype))
    assert e.value.channel == "TRQ"


# missing samples ------------------------------------------------------------------


def gappy():
    u = random(2000)
    u[1203:1240, 1] = NAN
    return u


def test_nan_is_refused_with_count_row_time_and_ways_out():
    with pytest.raises(DataError) as error:
        make(gappy(), np.ones(2000))
    assert str(error.value) == (
        "TRQ has 37 NaN, first at row 1203 (t = 12.03 s). "
        "Use missing='mask', 'split' or 'interpolate'."
    )
    assert (error.value.channel, error.value.row) == ("TRQ", 1203)
    assert error.value.time == pytest.approx(12.03)


def test_inf_is_said_as_inf_and_the_record_is_named():
    y = np.ones(9)
    y[[4, 6]] = [np.inf, -np.inf]
    u = random(9)
    u[0] = NAN
    with pytest.raises(DataError, match="record 2: NOx has 2 inf, first at row 4 "):
        make([random(9), random(9)], [np.ones(9), y])
    with pytest.raises(DataError, match=r"N has 1 NaN.*Also missing: TRQ \(1\), NOx"):
        make(u, y)


def test_mask_holds_the_previous_sample_and_the_next_at_the_beginning():
    y = np.array([NAN, NAN, 3.0, np.inf, NAN, 6.0, NAN])
    record = make(random(7), y, missing="mask").records[0]
    np.testing.assert_array_equal(record.y[:, 0], [3, 3, 3, 3, 3, 6, 6])
    np.testing.assert_array_equal(record.valid[:, 2], np.isfinite(y))
    assert record.valid[:, :2].all()


def test_interpolation_is_linear_inside_and_masked_at_the_edges():
    y = np.array([NAN, 2.0, NAN, NAN, 5.0, NAN])
    record = make(random(6), y, missing="interpolate").records[0]
    np.testing.assert_allclose(record.y[:, 0], [2, 2, 3, 4, 5, 5], rtol=1e-15)
    np.testing.assert_array_equal(record.valid[:, 2], [0, 1, 1, 1, 1, 0])


def test_split_begins_a_record_after_every_gap():
    u = gappy()
    y = np.arange(2000.0)
    y[0] = NAN
    data = make(u, y, missing="split")
    assert [len(r) for r in data] == [1202, 760]
    assert [r.start_row for r in data] == [1, 1240]
    assert data.names == ["record 1#1", "record 1#2"]
    np.testing.assert_array_equal(data.records[1].y[:, 0], np.arange(1240.0, 2000))
    assert all(r.valid.all() and np.isfinite(r.u).all() for r in data)


@pytest.mark.parametrize("missing", ["refuse", "mask", "split", "interpolate"])
def test_a_channel_without_any_sample_is_refused_by_name(missing):
    with pytest.raises(DataError, match="NOx has no valid sample at all") as error:
        make(random(5), np.full(5, NAN), missing=missing)
    assert error.value.channel == "NOx"
    with pytest.raises(DataError, match="N is empty"):
        make(np.zeros((0, 2)), np.zeros((0, 1)), missing=missing)


def test_unknown_treatment_lists_the_four():
    with pytest.raises(SpecError, match="'refuse', 'mask', 'split', 'interpolate'"):
        make(random(5), np.ones(5), missing="drop")


# frames ---------------------------------------------------------------------------


def test_pandas_polars_and_arrow_tables_agree():
    polars = pytest.importorskip("polars", reason="polars is not installed")
    table = frame()
    one = from_frame(table, time="t")
    two = from_frame(
        polars.DataFrame({c: table[c].to_numpy() for c in table}), time="t"
    )
    three = from_frame(pa.Table.from_pandas(table), sample_time=0.1)
    for data in (one, two, three):
        assert data.sample_time == 0.1
        np.testing.assert_array_equal(data.records[0].u, table[["N", "TRQ"]])


def test_frames_of_nullable_integers_and_dates():
    table = frame(4)
    table["N"] = pd.array([1, None, 3, 4], dtype="Int64")
    table["t"] = pd.date_range("2024-05-31", periods=4, freq="100ms")
    data = from_frame(table, time="t", missing="interpolate")
    assert data.sample_time == pytest.approx(0.1, rel=1e-9)
    np.testing.assert_array_equal(data.records[0].u[:, 0], [1, 2, 3, 4])


def test_a_column_separates_records():
    table = frame(6).assign(run=["a", "a", "b", "b", "b", "b"])
    data = from_frame(table, sample_time=0.1, record="run")
    assert data.names == ["a", "b"] and [len(r) for r in data] == [2, 4]
    assert [r.start_row for r in data] == [0, 2]
    table["run"] = ["a", "b", "b", "a", "a", "a"]
    with pytest.raises(DataError, match="'a'.*row 3 .*Sort the frame by 'run'"):
        from_frame(table, sample_time=0.1, record="run")


def test_text_columns_are_refused_with_their_labels():
    table = frame(4)
    table["TRQ"] = ["D", "N", "D", "R"]
    for column in (table["TRQ"], table["TRQ"].astype("category")):
        with pytest.raises(DataError, match="TRQ holds text: 'D', 'N', 'R'"):
            from_frame(table.assign(TRQ=column), sample_time=0.1)
    with pytest.raises(SpecError, match="mixes kinds of values"):
        mixed = pd.Series([1.0, "a", 2.0, 3.0], dtype=object)
        from_frame(table.assign(TRQ=mixed), sample_time=0.1)


def test_unknown_and_repeated_columns_are_named():
    with pytest.raises(SpecError, match="0 columns named 'Noxx'.*Did you mean 'NOx'"):
        from_frame(frame(), outputs=["Noxx"], sample_time=0.1)
    twice = pd.concat([frame(), frame()[["N"]]], axis=1)
    with pytest.raises(SpecError, match="2 columns named 'N'"):
        from_frame(twice, sample_time=0.1)
    with pytest.raises(SpecError, match="give sample_time in seconds, or"):
        from_frame(frame())
    with pytest.raises(SpecError, match="got ndarray; for arrays use"):
        from_frame(np.ones((3, 3)), sample_time=0.1)


# sample time from a column --------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((20, 19 * 0.1), "does not increase: it repeats 1.9 s between rows 19 and 20"),
        ((20, 0.5), "goes back from 1.9 s to 0.5 s between rows 19 and 20"),
        ((20, NAN), "1 missing value.*row 20"),
        ((slice(30, None), 9.0), "jumps from 2.9 s to 12 s between rows 29 and 30"),
        (
            (slice(None, None, 2), 0.03),
            r"from 0.07 s to 0.13 s .*jitter 30.8 %.*Resample",
        ),
    ],
)
def test_bad_time_columns_are_refused_with_rows(change, said):
    table = frame()
    rows, value = change
    t = table["t"].to_numpy().copy()
    t[rows] = value if isinstance(rows, int) else t[rows] + value
    with pytest.raises(DataError, match=said) as error:
        from_frame(table.assign(t=t), time="t")
    assert error.value.channel == "t"


def test_split_makes_records_of_jumps_in_time():
    table = frame()
    table.loc[30:, "t"] += 9.0
    data = from_frame(table, time="t", missing="split")
    assert [len(r) for r in data] == [30, 20] and data.sample_time == 0.1


def test_a_stated_sample_time_checks_the_column_and_forgives_rounding():
    table = frame()
    table["t"] = (np.arange(50) / 30).round(2)
    with pytest.raises(DataError, match="not uniform"):
        from_frame(table, time="t")
    assert from_frame(table, time="t", sample_time=1 / 30).sample_time == 1 / 30
    with pytest.raises(DataError, match=r"advances by .* but sample_time is 0\.1 s"):
        from_frame(table, time="t", sample_time=0.1)
    with pytest.raises(DataError, match="leaves the grid .* more than half a step at"):
        from_frame(table, time="t", sample_time=0.034)


def test_records_of_different_rasters_are_refused():
    table = pd.concat([frame(9).assign(run="a"), frame(9).assign(run="b")])
    table["t"] = np.where(table["run"] == "b", 2 * table["t"], table["t"])
    with pytest.raises(DataError, match="a is sampled every 0.1 s, but b every 0.2 s"):
        from_frame(table, time="t", record="run")


# matching -------------------------------------------------------------------------


def schema(*names, unit=""):
    return Channels(tuple(Channel(n) for n in names), (Channel("NOx", unit),))


def test_matching_reorders_by_name_and_says_what_is_left():
    data = make(gappy(), np.arange(2000.0), missing="mask", units={"NOx": "ppm"})
    same, extra = match_channels(data, schema("TRQ", "N"))
    assert extra == [] and same.channels.input_names == ["TRQ", "N"]
    np.testing.assert_array_equal(same.records[0].u, data.records[0].u[:, ::-1])
    np.testing.assert_array_equal(
        same.records[0].valid[:, 0], data.records[0].valid[:, 1]
    )
    fewer, extra = match_channels(data, schema("TRQ", unit="ppm"))
    assert extra == ["N"] and fewer.records[0].valid.shape == (2000, 2)
    assert match_channels(data, data.channels)[0] is data


def test_an_output_may_serve_as_input():
    data = make(random(5), np.arange(5.0))
    inverse = Channels((Channel("NOx"),), (Channel("N"),))
    matched, extra = match_channels(data, inverse)
    np.testing.assert_array_equal(matched.records[0].u[:, 0], np.arange(5.0))
    assert extra == ["TRQ"]


def test_missing_channels_and_other_units_are_refused():
    data = make(random(5), np.ones(5), units={"NOx": "ppm"})
    with pytest.raises(SpecError, match="no channel 'TRQQ'.*Did you mean 'TRQ'"):
        match_channels(data, schema("N", "TRQQ"))
    with pytest.raises(SpecError, match="NOx is in 'ppm' in the data.*in 'mg/m3'"):
        match_channels(data, schema("N", "TRQ", unit="mg/m3"))


def test_the_folder_imports_without_heavy_packages():
    heavy = "jax equinox pandas pyarrow scipy matplotlib polars"
    code = (
        "import sys, jaxnarx.data as d; [getattr(d, n) for n in ('read', 'check')];"
        f"print([m for m in {heavy.split()} if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_inputs_without_samples_are_refused():
    with pytest.raises(SpecError, match=r"u is None, but inputs names a, b\."):
        Dataset.from_arrays(
            None, np.zeros(9), inputs=["a", "b"], outputs=["y"], sample_time=1
        )


@pytest.mark.parametrize("odd", ["a\0", "a\x1b[31m", "a\nb", "a\u202eb", "\ud800"])
def test_names_with_characters_that_are_not_seen_are_refused(odd):
    y = np.arange(9.0)

    def made(name="y", unit="", record="r"):
        return Dataset.from_arrays(
            None,
            y,
            inputs=[],
            outputs=[name],
            units={name: unit},
            names=[record],
            sample_time=1,
        )

    assert made("µ-Abgas [°C]", "m\u00b3", "Prüfstand 4").names == ["Prüfstand 4"]
    for case in ({"name": odd}, {"unit": odd}, {"record": odd}):
        with pytest.raises(SpecError, match="characters that are seen") as caught:
            made(**case)
        assert str(caught.value).replace("\n", "").isprintable()
