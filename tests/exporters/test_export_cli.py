"""`jaxnarx export` from a model file to files that run."""

import subprocess
import zipfile
from pathlib import Path

import common
import numpy as np
import pytest
import test_dcm

import jaxnarx as jnx
from jaxnarx.exporters import runners
from jaxnarx.shell.cli import run
from jaxnarx.shell.formats import table_csv


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("JAXNARX_DATA", raising=False)
    jnx.save(common.named("coupled"), "model.safetensors")
    return tmp_path


def records() -> list[str]:
    """Two CSV files of the model's channels."""
    names = common.CHANNELS.names
    found = []
    for n in range(2):
        Path(f"r{n}.csv").write_text(table_csv(names, common.signals(60, n).T.tolist()))
        found.append(f"r{n}.csv")
    return found


@pytest.mark.skipif(runners.compiler() is None, reason="there is no C compiler here")
def test_a_model_becomes_files_that_prove_themselves(place, capsys):
    words = ["export", "model.safetensors", *records(), "--to", "c", "python"]
    assert run([*words, "--name", "mean value", "--out", "out"]) == 0
    told = capsys.readouterr().out
    assert "c, double: differs from the model by" in told
    names = {f"mean_value{end}" for end in (".c", ".h", "_selftest.c", ".py")}
    assert {path.name for path in Path("out").iterdir()} == names | {"README.md"}
    text = Path("out/README.md").read_text()
    assert "| c, single |" in text and "| input 0 | a | V | -20 | 20 |" in text
    subprocess.run(
        ["cc", "mean_value.c", "mean_value_selftest.c", "-lm", "-o", "selftest"],
        cwd="out",
        check=True,
    )
    assert b"largest difference" in subprocess.check_output(["./selftest"], cwd="out")
    assert run([*words, "--name", "mean value", "--out", "out"]) != 0
    assert "--force" in capsys.readouterr().err


@pytest.mark.skipif(runners.compiler() is None, reason="there is no C compiler here")
def test_a_model_becomes_fmus_of_both_versions(place, capsys):
    words = ["export", "model.safetensors", *records(), "--to", "fmu2", "fmu3"]
    assert run([*words, "--name", "mean value", "--out", "out"]) == 0
    assert "fmu2: differs from the model by" in capsys.readouterr().out
    names = {"mean_value_fmi2.fmu", "mean_value_fmi3.fmu", "README.md"}
    assert {path.name for path in Path("out").iterdir()} == names
    text = Path("out/README.md").read_text()
    assert "| fmu3 |" in text and "`start` of an FMU" in text
    with zipfile.ZipFile("out/mean_value_fmi3.fmu") as packed:
        assert packed.testzip() is None
        page = packed.read("documentation/index.html").decode()
    assert "<td>given.y[2]</td>" in page


def test_python_without_records_runs_by_itself(place, capsys):
    words = ["export", "model.safetensors", "--to", "python", "--out", "out"]
    assert run(words) == 0
    assert "python: differs from the model by" in capsys.readouterr().out
    code = "import model; m = model.Model(); m.begin([1.0, 0.2], [0.0, 0.0]); "
    done = subprocess.run(
        ["python", "-c", code + "print(*m.step([1.0, 0.2]))"],
        cwd="out",
        check=True,
        capture_output=True,
        text=True,
    )
    assert np.all(np.isfinite(list(map(float, done.stdout.split()))))


def test_a_calibrator_changes_the_model(place, capsys):
    """Export, one number changed in the file, import: the model, and what is told."""
    net = test_dcm.rising()
    jnx.save(net, "model.safetensors", about={"from": "day 1"})
    words = ["export", "model.safetensors", "--to", "dcm", "a2l", "--map", "b", "a"]
    assert run([*words, "--out", "out"]) == 0
    told = Path("out/README.md").read_text()
    assert "dcm, parameters read back" in told and "jaxnarx import-dcm MODEL" in told
    text = Path("out/model.dcm").read_text("iso-8859-1")
    assert 'LANGNAME "y at rest over b and a"' in text
    back = ["import-dcm", "model.safetensors", "out/model.dcm", "--out", "back"]
    capsys.readouterr()
    assert run(back) == 0
    assert "Nothing has changed; no model was written." in capsys.readouterr().out
    assert not Path("back").exists()
    Path("out/model.dcm").write_text(text.replace("WERT 0.1 0.5 ", "WERT 0.1 0.625 "))
    assert run(back) == 0
    told = capsys.readouterr().out
    assert "theta_y: 1 number changed, by 0.125 at most" in told
    assert "Next: jaxnarx report back/model.safetensors" in told
    changed = jnx.load("back/model.safetensors")
    old, new = (np.asarray(n.models[0].local.coefficient) for n in (net, changed))
    assert new[new != old].tolist() == [0.625]
    about = {"from": "day 1", "parameters": "out/model.dcm"}
    assert jnx.models.load_about("back/model.safetensors") == about
    assert run(back) == 2
    assert "--force" in capsys.readouterr().err
    Path("out/model.dcm").write_text(text.replace("WERT 0.1 0.5 ", "WERT 0.1 half "))
    assert run([*back, "--force"]) == 3
    assert "out/model.dcm, line" in capsys.readouterr().err
    assert run(["import-dcm", "model.safetensors", "none.dcm"]) == 3
    assert "none.dcm: cannot be opened" in capsys.readouterr().err
    assert run([*words[:-2], "--map", "b", "--out", "other"]) == 2
    assert "--map must name two inputs" in capsys.readouterr().err


def test_what_is_wrong_is_told(place, capsys):
    records()
    assert run(["export", "model.safetensors", "a.toml", "r0.csv"]) == 2
    assert "not both" in capsys.readouterr().err
    Path("r0.csv").write_text("a,b\n1,2\n")
    assert run(["export", "model.safetensors", "r0.csv"]) == 3
    assert "'y'" in capsys.readouterr().err
    assert not Path("export").exists()
