"""`jaxnarx calibrate`: maps from files, and what is wrong with these."""

import functools
import json

import numpy as np
import pytest
from calibration_problems import cycle, network_and_cycle

import jaxnarx as jnx
from jaxnarx.calibration import Calibratable, read_map
from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.exporters import map_lines
from jaxnarx.exporters.calibration import read_dcm
from jaxnarx.shell.calibrate import read_task

STARTED = np.array([0.1, 0.2, 0.3])

MAPS = """
[maps.c]
over = ["s"]
axes = [[-1.0, 0.0, 1.0]]
start = 0.3
[[objective]]
of = "y + 1"
[[limits]]
of = "heat"
kind = "peak"
at_most = 0.1
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a model, a cycle and maps."""
    folder = tmp_path_factory.mktemp("calibrate")
    network, _ = network_and_cycle()
    jnx.save(network, folder / "model.safetensors")
    s = cycle().records[0].u
    np.savetxt(folder / "cycle.csv", s, header="s", comments="")
    (folder / "maps.toml").write_text(MAPS)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


@pytest.fixture
def jaxnarx(place, typed):
    return functools.partial(typed, "calibrate")


def test_maps_are_optimised_and_written(jaxnarx, place):
    line = "model.safetensors cycle.csv --maps maps.toml --out done"
    code, out, err = jaxnarx(line)
    assert code == 0, err
    assert "round 1 of 8 at most" in out + err and "all 1 limits kept" in out
    told = json.loads((place / "done" / "calibration.json").read_text())
    value = told["maps"]["c"]["value"]
    (block,) = read_dcm((place / "done" / "maps.dcm").read_text(), "maps.dcm")
    assert block.kind == "KENNLINIE" and block.name == "c"
    np.testing.assert_array_equal(block.values, value)
    reader = pytest.importorskip("dcmReader.dcm_reader").DcmReader()
    reader.read(str(place / "done" / "maps.dcm"), file_encoding="iso-8859-1")
    (curve,) = reader.get_characteristic_lines()
    assert curve.name == "c" and list(curve.values.values()) == pytest.approx(value)
    page = (place / "done" / "report.html").read_text()
    assert "<script" not in page and "Which points matter" in page
    assert not (place / "done" / "state").exists()
    code, out, err = jaxnarx(line)
    assert code == 2 and "--force" in err


def test_maps_begin_where_a_dcm_file_has_them(jaxnarx, place):
    given = Calibratable(("s",), axes=((-1.0, 0.0, 1.0),), start=(0.1, 0.2, 0.3))
    lines = map_lines("c", "f", "c", [(np.array(given.axes[0]), "")], "", STARTED)
    text = "\n".join(["KONSERVIERUNG_FORMAT 2.0", *lines]) + "\n"
    (place / "base.dcm").write_text(text)
    task = MAPS.replace("start = 0.3", 'dcm = "base.dcm"')
    (place / "from_dcm.toml").write_text(task.replace("axes = [[-1.0, 0.0, 1.0]]", ""))
    found = read_task(str(place / "from_dcm.toml")).maps["c"]
    assert found.start == STARTED.tolist() and found.axes == given.axes
    line = "model.safetensors cycle.csv --maps from_dcm.toml --out begun"
    assert jaxnarx(line)[0] == 0
    told = json.loads((place / "begun" / "calibration.json").read_text())
    assert told["maps"]["c"]["start"] == STARTED.tolist()


def test_a_map_of_two_axes_is_read_as_it_is_written(place):
    value, axes = np.arange(6.0).reshape(2, 3), (np.array([1.0, 2.0]), np.arange(3.0))
    lines = map_lines("m", "f", "m", [(a, "") for a in axes], "", value)
    text = "\n".join(["KONSERVIERUNG_FORMAT 2.0", *lines]) + "\n"
    (place / "two.dcm").write_text(text)
    found = read_map(place / "two.dcm", "m", Calibratable(("s", "t")))
    assert found.start == value.tolist()
    assert [list(a) for a in found.axes] == [a.tolist() for a in axes]
    with pytest.raises(DataFileError, match="no block n"):
        read_map(place / "two.dcm", "n", Calibratable(("s", "t")))
    with pytest.raises(SpecError, match="2 axes"):
        read_map(place / "two.dcm", "m", Calibratable(("s",)))
    (place / "two.dcm").write_text(text.replace("ST/X 1.0 2.0", "ST/X 2.0 1.0"))
    with pytest.raises(DataFileError, match="do not rise"):
        read_map(place / "two.dcm", "m", Calibratable(("s", "t")))


def test_what_is_wrong_is_named(jaxnarx, place):
    def refused(text, said, line="model.safetensors cycle.csv"):
        (place / "bad.toml").write_text(text)
        code, _, err = jaxnarx(f"{line} --maps bad.toml --out bad")
        assert code in (2, 3) and said in err, err

    refused("maps", "is no TOML")
    refused(MAPS + "[more]\n", "unknown key 'more'")
    refused(MAPS.replace("at_most", "at_mots"), "limits[0] has the unknown key")
    refused(MAPS.replace("maps.c", "maps.d"), "none of the plant's inputs")
    refused(MAPS.replace('"y + 1"', '"y +"'), "cannot be read")
    refused(MAPS.replace('"y + 1"', '"load"'), "load")
    refused(MAPS.replace("0.3", "30.0"), "within its bounds")
    code, _, err = jaxnarx("model.safetensors cycle.csv --maps none.toml")
    assert code == 3 and "there is no such file" in err
