"""MATLAB, HDF5 and npz files as other libraries write them, read back."""

import zipfile
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

matio = pytest.importorskip("matio")
h5py = pytest.importorskip("h5py")

from jaxnarx.data.readers import contents, read_table  # noqa: E402
from jaxnarx.data.readers.columns import Asked  # noqa: E402
from jaxnarx.errors import DataFileError  # noqa: E402

T = 0.1 * np.arange(50)
SPEED, NOX = 1000 + 10 * np.sin(T), 300 + 40 * np.cos(T)
NAMES, UNITS = ["t", "speed", "NOx/raw"], ["s", "rpm", "ppm"]


def texts(values):
    return np.array(values, object)


def structs(**fields):
    """An array of structs, from a list for every field."""
    rows = list(zip(*fields.values(), strict=True))
    return np.array(rows, dtype=[(name, object) for name in fields])


def timeseries(path, uniform):
    """As MATLAB keeps one: an object with hidden properties."""
    from matio.utils.matclass import MatlabOpaque

    time = np.zeros((0, 0)) if uniform else T[:, None]
    info = {"Units": "seconds", "Start": 0.0, "Increment": 0.1, "Length": 50.0}
    inside = {"Data_": SPEED[:, None], "Time_": time, "Name": "speed"}
    inside |= {"TimeInfo": MatlabOpaque(info, "tsdata.timemetadata")}
    inside |= {"DataInfo": MatlabOpaque({"Units": "rpm"}, "tsdata.datametadata")}
    matio.save_to_mat(path, {"speed": MatlabOpaque(inside, "timeseries")})


def timetable(path, version="v7.3"):
    index = pd.to_timedelta(T, unit="s").as_unit("ms")
    table = pd.DataFrame({"speed": SPEED, "NOx": NOX}, index=index)
    table.index.name = "Time"
    matio.save_to_mat(path, {"run": table}, version=version)


def hdf5(path):
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        group.attrs["sample_time"] = 0.1
        group.create_dataset("speed", data=SPEED, compression="gzip")
        group["speed"].attrs["units"] = "rpm"
        group["picture"] = np.zeros((4, 4, 4))


def compound(path):
    both = np.zeros(50, [("time", float), ("speed", float)])
    both["time"], both["speed"] = T, SPEED
    with h5py.File(path, "w") as file:
        file["run"] = both


def matrix(path):
    inside = {"data": np.c_[T, SPEED, NOX], "names": texts(NAMES), "Ts": 0.1}
    savemat(path, inside | {"units": texts(UNITS)})


def pandas_block(path):
    """As pandas lays out a frame of one kind of numbers."""
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        group["axis0"] = np.array([b"speed", b"NOx"])
        group["block0_items"] = np.array([b"speed", b"NOx"])
        group["block0_values"] = np.c_[SPEED, NOX]
        group["axis1"] = np.arange(50)


LOG: dict[str, Any] = {"time": T[:, None]}
LOG["signals"] = structs(values=[SPEED[:, None], NOX[:, None]], label=["speed", "NOx"])
DSPACE: dict[str, Any] = {"X": {"Data": T, "Name": "time"}}
DSPACE["Y"] = structs(Data=[SPEED, NOX], Name=["speed", "NOx"], Unit=["rpm", "ppm"])
IDDATA = {"OutputData": NOX[:, None], "InputData": SPEED[:, None], "Ts": 0.1}
IDDATA |= {"InputName": texts(["speed"]), "InputUnit": texts(["rpm"])}
IDDATA |= {"OutputName": texts(["NOx"]), "OutputUnit": texts(["ppm"]), "Tstart": 0.0}

CASES = {
    "matrix.mat": (matrix, "rpm", True),
    "plain.mat": (lambda p: savemat(p, {"t": T, "speed": SPEED}), "", False),
    "four.mat": (
        lambda p: savemat(p, {"t": T, "speed": SPEED}, format="4"),
        "",
        False,
    ),
    "rate.mat": (lambda p: savemat(p, {"fs": 10.0, "speed": SPEED}), "", True),
    "group.mat": (
        lambda p: savemat(p, {"run": {"time": T, "speed": SPEED, "torque": T}}),
        "",
        True,
    ),
    "simulink.mat": (lambda p: savemat(p, {"log": LOG}), "", True),
    "dspace.mat": (lambda p: savemat(p, {"rec_001": DSPACE}), "rpm", True),
    "iddata.mat": (lambda p: savemat(p, {"z": IDDATA}), "rpm", True),
    "timetable.mat": (timetable, "", True),
    "timetable7.mat": (lambda p: timetable(p, "v7"), "", True),
    "timeseries.mat": (lambda p: timeseries(p, False), "rpm", True),
    "uniform.mat": (lambda p: timeseries(p, True), "rpm", True),
    "run.h5": (hdf5, "rpm", True),
    "compound.hdf5": (compound, "", True),
    "pandas.h5": (pandas_block, "", False),
    "run.npz": (lambda p: np.savez(p, t=T, speed=SPEED), "", False),
    "packed.npz": (lambda p: np.savez_compressed(p, speed=SPEED, dt=0.1), "", True),
}


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", CASES)
def test_a_channel_is_found_with_its_unit_and_time(tmp_path, name):
    write, unit, timed = CASES[name]
    path = tmp_path / name
    write(path)
    found = {column.name: column for column in contents(path, Asked())}
    assert found["speed"].rows == 50 and found["speed"].unit == unit
    table = read_table(path, ["speed"], Asked())
    np.testing.assert_array_equal(table.columns["speed"].to_numpy(), SPEED)
    assert table.units["speed"] == unit
    if timed:
        assert found["speed"].step == pytest.approx(0.1)
        assert table.time is not None
        np.testing.assert_allclose(table.time, T, atol=1e-12)
    else:
        assert table.time is None


@pytest.mark.parametrize("name", ["T", "t"])
def test_a_t_beside_a_time_is_a_channel(tmp_path, name):
    path = tmp_path / "thermo.mat"
    savemat(path, {"thermo": {"time": T, name: SPEED}, "other": {name: T, "u": NOX}})
    found = sorted((c.table, c.name) for c in contents(path, Asked()))
    assert found == [("other", "u"), ("thermo", name)]
    assert all(c.step == pytest.approx(0.1) for c in contents(path, Asked()))
    table = read_table(path, [name], Asked(table="thermo"))
    np.testing.assert_array_equal(table.columns[name].to_numpy(), SPEED)
    assert table.time is not None
    np.testing.assert_allclose(table.time, T, atol=1e-12)


def test_names_that_matlab_does_not_allow_come_back(tmp_path):
    path = tmp_path / "named.mat"
    inside = {"NOx_raw": NOX[:, None], "speed": SPEED[:, None]}
    names, units = texts(["NOx/raw", "speed"]), texts(["ppm", "rpm"])
    savemat(path, inside | {"names": names, "units": units})
    table = read_table(path, ["NOx/raw", "speed"], Asked())
    np.testing.assert_array_equal(table.columns["NOx/raw"].to_numpy(), NOX)
    assert table.units == {"NOx/raw": "ppm", "speed": "rpm"}


def test_enumerations_are_held_and_their_gaps_missing(tmp_path):
    modes = pd.Categorical.from_codes([0, 1, -1] * 16 + [0, 1], ["idle", "load"])
    path = tmp_path / "mode.mat"
    matio.save_to_mat(path, {"run": pd.DataFrame({"mode": modes, "speed": SPEED})})
    x = read_table(path, ["mode"], Asked()).columns["mode"].to_numpy()
    np.testing.assert_array_equal(x[:4], [0, 1, np.nan, 0])


@pytest.fixture
def runs(tmp_path):
    path = tmp_path / "runs.mat"
    one, two = ({"time": T, "speed": k * SPEED} for k in (1, 2))
    word = {"word": texts(["idle", "load"] * 25), "short": np.arange(7.0)}
    savemat(path, {"day": {"one": one, "two": two}, "rest": word, "z": 1j * T})
    return path


def test_a_name_that_is_there_twice_is_asked_by_its_place(runs):
    with pytest.raises(DataFileError, match="2 times: 'day.one.speed', 'day.two.speed"):
        read_table(runs, ["speed"], Asked())
    for asked, name in (("", "day.two.speed"), ("day.two", "speed")):
        table = read_table(runs, [name], Asked(table=asked))
        np.testing.assert_array_equal(table.columns[name].to_numpy(), 2 * SPEED)
    with pytest.raises(DataFileError, match="no variable 'day.tow'.*Did you mean"):
        read_table(runs, ["speed"], Asked(table="day.tow"))


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        (["word"], "word holds text: 'idle', 'load'"),
        (["sped"], "no channel 'sped'. Did you mean 'speed'"),
        (["short", "day.one.speed"], "short has 7 samples and no time, others have 50"),
        (["z"], "no channel 'z'"),
    ],
)
def test_what_is_no_channel_is_told(runs, wanted, said):
    with pytest.raises(DataFileError, match=said):
        read_table(runs, wanted, Asked())


@pytest.mark.parametrize("name", ["x.mat", "x.h5", "x.npz"])
@pytest.mark.parametrize("content", [b"a;b\n1;2\n" * 20, b"PK\x03\x04" + bytes(60)])
def test_mislabelled_files_are_told(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DataFileError, match=name):
        read_table(path, ["a"], Asked())


def test_bombs_are_refused_before_they_unfold(tmp_path):
    much = np.zeros((20_000_000, 1))
    savemat(tmp_path / "b.mat", {"s": {"x": much}}, do_compression=True)
    np.savez_compressed(tmp_path / "b.npz", x=much)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        # nothing is written of what is as it was
        file.create_dataset("x", (10**12,), chunks=(10**6,), dtype="f8")
    for name in ("b.mat", "b.npz", "b.h5"):
        path = tmp_path / name
        assert path.stat().st_size < 1e6
        with pytest.raises(
            DataFileError, match=r"GB when read, (more than 1,000|over)"
        ):
            read_table(path, ["x"], Asked())
    with pytest.raises(DataFileError, match="over the limit"):
        read_table(tmp_path / "b.npz", ["x"], Asked(max_bytes=1e6))


def test_an_archive_of_pickles_is_never_unpickled(tmp_path):
    path = tmp_path / "p.npz"
    np.savez(path, x=texts([1.0, "a"]))
    assert zipfile.is_zipfile(path)
    with pytest.raises(DataFileError, match="p.npz"):
        read_table(path, ["x"], Asked())
