"""`jaxnarx fleet`: learn from files, calibrate, report; what is wrong with either."""

import functools
import json
from pathlib import Path

import numpy as np
import pytest
from fleet_problems import coefficients, donors, engine

import jaxnarx as jnx
from jaxnarx.shell.cli import run

DONOR = """
[data]
sample_time = 0.1
[channels.inputs]
u = ""
[channels.outputs]
y = ""
[records]
train = ["{name}.csv"]
"""
FLEET = """
[data]
engines = ["engines/*.toml"]
[identification]
refine = "none"
[identification.pool]
outputs = ["y"]
input_lags = [1, 2]
output_lags = []
degree = 2
"""


def write(data: jnx.Dataset, path: Path) -> None:
    """Records as a table with a header."""
    table = np.column_stack([data.records[0].u, data.records[0].y])
    np.savetxt(path, table, delimiter=",", header="u,y", comments="")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a dozen donors, one of them without a file, and a new engine."""
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "engines").mkdir()
    for n, (name, data) in enumerate(list(donors().items())[:12]):
        slug = name.replace(" ", "")
        write(data, folder / "engines" / f"{slug}.csv")
        (folder / "engines" / f"{slug}.toml").write_text(DONOR.format(name=slug))
        if n == 3:
            (folder / "engines" / f"{slug}.csv").unlink()
    (folder / "line.toml").write_text(FLEET)
    write(engine(coefficients(1, 77)[0], 14, 5), folder / "new.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("JAXNARX_DATA", raising=False)
        yield folder


@pytest.fixture
def jaxnarx(place, typed):
    return functools.partial(typed, "fleet")


def test_a_fleet_is_learnt_told_and_used(jaxnarx, place):
    code, out, err = jaxnarx("learn line.toml --out line")
    assert code == 0, err
    assert "12 of 12 donors, 0 remain" in out and "11 donors" in out
    assert "engine3" in out and not (place / "line" / "sums").exists()
    page = (place / "line" / "report.html").read_text()
    assert "<script" not in page and "offset and gain" in page and "engine3" in page
    code, out, err = jaxnarx("learn line.toml --out line")
    assert code == 2 and "--force" in err
    code, out, err = jaxnarx("calibrate line/prior.fleet new.csv --out new")
    assert code == 0, err
    told = json.loads((place / "new" / "calibration.json").read_text())
    assert told["samples"] == {"y": 12} and told["way"]["y"] in out
    network = jnx.load(place / "new" / "model.safetensors")
    assert network.output_names == ["y"] and network.errors is not None
    code, out, err = jaxnarx("report line/prior.fleet --out told")
    assert code == 0 and (place / "told" / "report.html").read_text() == page


def test_an_engine_is_compared_and_its_test_planned(jaxnarx, place):
    jaxnarx("learn line.toml --out again")
    theta = coefficients(1, 77)[0]
    for name, own in (("same", theta), ("other", theta + [4.0, 0.0, 2.0, 0.0])):
        write(engine(own, 200, 6), place / f"{name}.csv")
    write(engine(theta, 200, 7), place / "first.csv")
    code, out, err = jaxnarx("compare again/prior.fleet first.csv same.csv")
    assert code == 0 and "still itself" in out, err
    code, out, err = jaxnarx("compare again/prior.fleet first.csv other.csv")
    assert code == 1 and "another, or changed" in out, err
    command = "plan again/prior.fleet --duration 4s --out planned"
    assert run(command.split()) == 0
    with (place / "planned" / "plan.csv").open() as file:
        assert len(file.readlines()) == 1 + 40
    page = (place / "again" / "report.html").read_text()
    assert "What more donors bring" in page and "own samples alone" in page


def test_calibrations_are_swept(jaxnarx, typed, place):
    text = (
        '[data]\nengines = ["engines/*.toml"]\n[fleet]\nprior = "swept/prior.fleet"\n'
    )
    (place / "new.toml").write_text(text + "samples = [10, 50]\n")
    assert jaxnarx("learn line.toml --out swept")[0] == 0
    code, out, _ = typed("sweep", "new.toml --folder calibrations")
    assert code == 0 and "24 calibrations: 12 engines by 2 numbers of samples" in out
    assert "  y, 50 samples: " in out and "prior 11" in out
    table = (place / "calibrations" / "table.csv").read_text()
    assert "y_free_run" in table and "nonfinite_data" in table
    for more, said in (("[cases]\n", "[cases] identify"), ("most = 3\n", "'most'")):
        (place / "bad.toml").write_text(text + more)
        code, _, told = typed("sweep", "bad.toml")
        assert code == 3 and said in told


def test_what_is_wrong_is_named(jaxnarx, place):
    code, _, err = jaxnarx("calibrate none.fleet new.csv")
    assert code == 3 and "none.fleet: there is no such file" in err
    code, _, err = jaxnarx("calibrate new.csv new.csv")
    assert code == 3 and "no fleet prior" in err
    code, _, err = jaxnarx("")
    assert code == 2 and "fleet calibrate, fleet compare, fleet report" in err
    (place / "empty.toml").write_text('[data]\nengines = ["none/*.toml"]\n')
    code, _, err = jaxnarx("learn empty.toml --out empty")
    assert code == 3 and "no file matches" in err
    assert not (place / "empty").exists()
