"""`jaxnarx adapt`: what is written and said, and what is wrong with files."""

import functools

import numpy as np
import pytest
from adapt_problems import dataset, excitation, one_model, plant

import jaxnarx as jnx
from jaxnarx.shell.record_files import record_csv

TIME = 600


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a model and a record of its plant, changed."""
    folder = tmp_path_factory.mktemp("adapt")
    u = excitation(TIME)
    network = one_model(dataset(u, plant(u, np.full(TIME, 0.5), noise=0.02)))
    jnx.save(network, folder / "model.safetensors")
    changed = dataset(u, plant(u, np.full(TIME, 0.8), noise=0.02))
    (folder / "new.csv").write_text(record_csv(changed, 0))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


@pytest.fixture
def jaxnarx(place, typed):
    return functools.partial(typed, "adapt")


def test_the_model_follows_and_its_windows_are_told(jaxnarx, place):
    line = "model.safetensors new.csv --out done --start 1 --c unit --fmu 3"
    code, out, err = jaxnarx(line)
    assert code == 0, err
    assert "y: error 0.0" in out and "by the model as it began" in out
    assert "Next: jaxnarx report done/model.safetensors" in out + err
    found = jnx.load(place / "done" / "model.safetensors")
    gain = found.equations()[0]["terms"][1][1]
    assert abs(gain - 0.8) < 0.02
    rows = (place / "done" / "adaptation.csv").read_text().splitlines()
    assert rows[0] == "time [s],y rmse,y rmse_start,y drift,y undone"
    assert len(rows) == 1 + TIME // 100
    page = (place / "done" / "report.html").read_text()
    assert "<svg" in page and "as it began" in page and "<script" not in page
    assert (place / "done" / "unit_adapt.c").exists()
    assert (place / "done" / "unit_fmi3.fmu").exists()
    code, out, err = jaxnarx(line)
    assert code == 2 and "--force" in err


@pytest.mark.parametrize(
    ("line", "code", "why"),
    [
        ("model.safetensors", 2, "give data files"),
        ("model.safetensors none.csv", 3, "there is no such file"),
        ("model.safetensors new.csv --forgetting 2", 2, "--forgetting must lie"),
        ("model.safetensors new.csv --fmu 4", 2, "--fmu"),
        ("model.safetensors new.csv --window 1000 --c m", 3, "window of 1000"),
    ],
)
def test_what_is_wrong_is_said(jaxnarx, line, code, why):
    found, out, err = jaxnarx(f"{line} --out wrong")
    assert found == code and why in out + err
