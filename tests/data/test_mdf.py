"""MDF files: what two other libraries have written, read back, and what is refused."""

import numpy as np
import pytest

asammdf = pytest.importorskip("asammdf")
mf4_rs = pytest.importorskip("mf4_rs")

from jaxnarx.data.readers import contents, read_table  # noqa: E402
from jaxnarx.data.readers.columns import Asked  # noqa: E402
from jaxnarx.errors import DataError, DataFileError  # noqa: E402

FAST, SLOW = 0.1 * np.arange(300), 0.5 * np.arange(60)
SPEED, NOX = 1000 + 10 * np.sin(FAST), 300 + 40 * np.cos(0.3 * SLOW)


def written(path, version="4.10", compression=2):
    """Two rasters, an enumeration, invalid samples, a name twice, a linear scale."""
    signal = asammdf.Signal
    bits = {} if version < "4" else {"invalidation_bits": np.arange(60) % 7 == 3}
    modes = {"val_0": 0, "text_0": "idle", "val_1": 1, "text_1": "load"}
    with asammdf.MDF(version=version) as mdf:
        mdf.append(
            [
                signal(SPEED, FAST, unit="rpm", name="n_mot"),
                signal(
                    (FAST > 10).astype(np.uint8),
                    FAST,
                    name="mode",
                    conversion=modes | {"default": b"?"},
                ),
                signal(
                    np.arange(300, dtype=np.int16),
                    FAST,
                    unit="bar",
                    name=r"p_rail\XCP:1",
                    conversion={"a": 0.5, "b": 100.0},
                ),
            ],
            comment="fast",
        )
        mdf.append(
            [
                signal(NOX, SLOW, unit="ppm", name="NOx", **bits),
                signal(np.arange(60.0), SLOW, unit="rpm", name="n_mot"),
            ],
            comment="slow",
        )
        saved = mdf.save(path, overwrite=True, compression=compression)
    return saved.rename(path)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return written(tmp_path_factory.mktemp("mdf") / "run.mf4")


def values(table, name):
    return table.columns[name].to_numpy()


def test_it_says_what_is_in_it(file):
    found = {c.name: c for c in contents(file, Asked())}
    assert set(found) == {
        *("n_mot @ group 0", "n_mot @ group 1", "mode", r"p_rail\XCP:1", "NOx")
    }
    assert found["NOx"].unit == "ppm" and found["NOx"].rows == 60
    assert found["NOx"].step == pytest.approx(0.5)
    assert found["mode"].step == pytest.approx(0.1)


@pytest.mark.parametrize("name", ["run.mf4", "run.mdf", "run.dat"])
def test_one_raster_comes_back_as_it_was(tmp_path, name):
    old = not name.endswith("mf4")
    path = written(tmp_path / name, "3.30" if old else "4.10", 0 if old else 2)
    table = read_table(path, ["n_mot @ group 0", "mode", "p_rail"], Asked())
    np.testing.assert_array_equal(values(table, "n_mot @ group 0"), SPEED)
    np.testing.assert_array_equal(values(table, "mode"), FAST > 10)
    np.testing.assert_allclose(values(table, "p_rail"), 0.5 * np.arange(300) + 100)
    assert table.time is not None
    np.testing.assert_allclose(table.time, FAST, atol=1e-12)
    assert table.units == {"n_mot @ group 0": "rpm", "mode": "", "p_rail": "bar"}


def test_invalid_samples_stay_in_their_place_and_are_counted(file):
    table = read_table(file, ["NOx"], Asked())
    bad = np.arange(60) % 7 == 3
    np.testing.assert_array_equal(np.isnan(values(table, "NOx")), bad)
    np.testing.assert_array_equal(values(table, "NOx")[~bad], NOX[~bad])
    assert any("invalid samples: 9 of NOx" in note for note in table.notes)


def test_several_rasters_are_brought_to_one(file):
    table = read_table(file, ["mode", "NOx"], Asked(sample_time=0.1))
    assert set(values(table, "mode")) == {0.0, 1.0}
    assert table.time is not None and np.allclose(np.diff(table.time), 0.1)
    with pytest.raises(DataError, match=r"mode every 0.1 s, NOx every 0.5 s"):
        read_table(file, ["mode", "NOx"], Asked())


def test_what_another_library_has_written_is_read(tmp_path):
    path = tmp_path / "other.mf4"
    writer = mf4_rs.MdfWriter(str(path))
    writer.init_mdf_file()
    group = writer.add_channel_group("bench")
    time = writer.add_time_channel(group, "t")
    speed = writer.add_float_channel(group, "speed")
    writer.start_data_block(group)
    for t, x in zip(FAST, SPEED, strict=True):
        writer.write_record(
            group, [mf4_rs.create_float_value(t), mf4_rs.create_float_value(x)]
        )
    writer.finish_data_block(group)
    writer.finalize()
    assert time is not None and speed is not None
    table = read_table(path, ["speed"], Asked())
    np.testing.assert_array_equal(values(table, "speed"), SPEED)
    np.testing.assert_array_equal(table.time, FAST)


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        ("n_mot", r"group 0 \(300 samples every 0.1 s\), group 1.*n_mot @ group 0"),
        ("N0x", "no channel 'N0x'. Did you mean 'NOx'"),
        ("n_mot @ group 7", "no channel 'n_mot @ group 7'"),
    ],
)
def test_names_that_are_not_clear_are_asked_back(file, wanted, said):
    with pytest.raises(DataFileError, match=said):
        read_table(file, [wanted], Asked())


def test_text_and_too_much_are_refused(tmp_path, file):
    path = tmp_path / "text.mf4"
    with asammdf.MDF(version="4.10") as mdf:
        words = np.array([b"idle", b"load"] * 5)
        mdf.append([asammdf.Signal(words, FAST[:10], name="word", encoding="utf-8")])
        mdf.save(path)
    with pytest.raises(DataFileError, match="word holds text: 'idle', 'load'"):
        read_table(path, ["word"], Asked())
    with pytest.raises(DataFileError, match="over the limit"):
        read_table(file, ["mode"], Asked(max_bytes=1000.0))


@pytest.mark.parametrize(
    "content", [b"a;b\n1;2\n", b"", b"MDF     4.10    " + bytes(9)]
)
def test_what_is_none_is_told(tmp_path, content):
    path = tmp_path / "x.mf4"
    path.write_bytes(content)
    with pytest.raises(DataFileError, match="x.mf4"):
        read_table(path, ["a"], Asked())


def test_a_file_that_was_cut_off_is_told_or_read_as_far_as_it_goes(tmp_path, file):
    raw = file.read_bytes()
    path = tmp_path / "cut.mf4"
    path.write_bytes(raw[: len(raw) // 3])
    with pytest.raises(DataFileError, match="cut.mf4"):
        read_table(path, ["mode"], Asked())
    # the next file is served as if nothing had been
    assert len(read_table(file, ["mode"], Asked())) == 300


def test_groups_over_angle_and_of_arrays_are_told(tmp_path):
    path = tmp_path / "angle.mf4"
    crank = asammdf.Signal(
        SPEED, FAST, name="p_cyl", master_metadata=("angle", 2), unit="bar"
    )
    four = np.rec.fromarrays([np.ones((60, 4))], dtype=[("spectrum", "(4,)<f8")])
    arrays = asammdf.Signal(four, SLOW, name="spectrum", unit="dB")
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append([crank])
        mdf.append([arrays, asammdf.Signal(NOX, SLOW, name="NOx")])
        mdf.save(path)
    with pytest.raises(DataFileError, match="group 0 is sampled over angles, not over"):
        read_table(path, ["p_cyl"], Asked())
    with pytest.raises(DataFileError, match="spectrum holds arrays"):
        read_table(path, ["spectrum"], Asked())
    np.testing.assert_array_equal(
        values(read_table(path, ["NOx"], Asked()), "NOx"), NOX
    )


def test_a_thousand_channels_of_one_name_are_asked_back(tmp_path):
    path = tmp_path / "many.mf4"
    with asammdf.MDF(version="4.10") as mdf:
        for k in range(1000):
            mdf.append([asammdf.Signal(np.full(3, float(k)), FAST[:3], name="x")])
        mdf.save(path)
    assert len(contents(path, Asked())) == 1000
    with pytest.raises(DataFileError, match="group 7 .3 samples.*and 992 more. Say"):
        read_table(path, ["x"], Asked())
    x = read_table(path, ["x @ group 999"], Asked())
    np.testing.assert_array_equal(values(x, "x @ group 999"), [999.0] * 3)


def test_time_that_runs_backwards_is_told_with_its_place(tmp_path):
    path = tmp_path / "back.mf4"
    time = np.r_[FAST[:20], FAST[10:20]]
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append([asammdf.Signal(np.arange(30.0), time, name="x")])
        mdf.save(path)
    with pytest.raises(DataError, match=r"time of x does not increase after 1.9 s"):
        read_table(path, ["x"], Asked())
