"""Targets that fail their proof, and the number types of C."""

import dataclasses
import subprocess
from pathlib import Path

import common
import pytest
from test_targets import needs_compiler, records, trusting

import jaxnarx as jnx
from jaxnarx.errors import SpecError
from jaxnarx.exporters import ExportError, export, lower, runners
from jaxnarx.exporters.causes import cause
from jaxnarx.exporters.compilers import WARNING_FLAGS
from jaxnarx.shell.cli import run

pytestmark = needs_compiler


@pytest.fixture
def strict(monkeypatch):
    """Single precision is never good enough."""
    monkeypatch.setattr(runners, "SINGLE_TOLERANCE", 1e-12)


def compiled(files, place: Path, *flags: str) -> str:
    """What the compiler says of the source; empty where it is fine."""
    for name, text in files.items():
        if name.endswith((".c", ".h")):
            (place / name).write_text(text)
    words = [
        runners.compiler(),
        *WARNING_FLAGS,
        *flags,
        "-c",
        place / "m.c",
        "-o",
    ]
    words = [*map(str, words), str(place / "m.o")]
    return subprocess.run(words, capture_output=True, text=True).stderr


def test_a_model_that_single_precision_cannot_follow_is_written_for_double(
    strict, tmp_path
):
    to = ["c", "python", "a2l", "fmu2"]
    found = export(common.named("one model"), to=to, name="m")
    assert set(found.failed) == {"c, single"}
    assert "c, single differs from the model" in found.failed["c, single"]
    assert "not written: c, single" in str(found)
    assert {"c, double", "python", "fmu2"} <= set(found.difference)
    assert not any("single" in name for name in found.difference)
    files = found.files
    assert {"m.h", "m.c", "m.py", "m.a2l", "m_fmi2.fmu"} <= set(files)
    symbols = str(files["m.a2l"])
    assert "FLOAT64_IEEE" in symbols and "FLOAT32" not in symbols
    assert not compiled(found.texts, tmp_path)
    refused = compiled(found.texts, tmp_path, "-DM_SINGLE")
    assert "not proven in single precision" in refused


def test_nothing_is_written_where_nothing_passes(strict, monkeypatch):
    net = common.named("one model")
    with pytest.raises(ExportError, match="single differs.*Nothing was written"):
        export(net, precision="single")
    monkeypatch.setattr(runners, "DOUBLE_TOLERANCE", -1.0)
    with pytest.raises(ExportError, match="c, double differs.*Python differs"):
        export(net, to=["c", "python"])


@pytest.mark.parametrize("precision", ["single", "double"])
def test_one_number_type_is_written_alone(precision, tmp_path):
    net = common.named("one model")
    found = export(net, to=["c", "fmu3"], name="m", precision=precision)
    assert {f"c, {precision}", "fmu3"} <= set(found.difference) and not found.failed
    kept = {"single": "typedef float", "double": "typedef double"}
    for kind, text in kept.items():
        assert (text in found.texts["m.h"]) == (kind == precision)
    assert not compiled(found.texts, tmp_path)


def test_an_unknown_number_type_is_refused():
    with pytest.raises(SpecError, match="precision must be one of 'double', 'single'"):
        export(common.named("one model"), precision="half")


def test_the_cause_is_a_pole_that_does_not_forget():
    part = common.Part([[((0, 0), 0.001), ((0, 3), 1.019)]])
    net = common.network([part], variables=common.VARIABLES[:4])
    text = cause(net, common.dataset((60,), seed=3))
    assert "Local model 1 of y does not forget its past (pole 1.019)" in text
    assert "double precision" in text
    fine = cause(common.named("one model"), common.dataset((60,), seed=3))
    assert "forget" not in fine and "double precision" in fine


def test_the_command_names_what_failed_and_ends_with_one(
    strict, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    jnx.save(common.named("one model"), "model.safetensors")
    words = ["export", "model.safetensors", "--to", "c", "--out", "out"]
    assert run(words) == 1
    told = capsys.readouterr()
    assert "not written: c, single: " in told.err and "wrote model.h" in told.out
    assert "not written: the export as c, single" in Path("out/README.md").read_text()
    assert run([*words, "--precision", "double", "--force"]) == 0
    assert "Numbers are double" in Path("out/README.md").read_text()
    assert run([*words, "--nan", "nan", "--invalid-after", "2", "--force"]) == 1
    text = " ".join(Path("out/model.h").read_text().replace("*", "").split())
    assert "outputs are NaN" in text and "20 samples in a row (2 s)" in text


def test_the_cost_is_told_with_and_without_the_index(tmp_path, monkeypatch, capsys):
    net = dataclasses.replace(trusting(), errors=None)
    program, bare = lower(net), lower(net, index=False)
    assert program.model_operations == bare.operations == bare.model_operations
    assert program.operations > 2 * bare.operations
    told = f"{program.operations} operations a sample, {bare.operations} of them"
    found = export(net, records(net), verify=False)
    assert f"{told} without the index of the domain" in str(found)
    assert told in " ".join(found.texts["model.h"].replace("*", "").split())
    assert "of them" not in bare.cost
    monkeypatch.chdir(tmp_path)
    jnx.save(net, "model.safetensors")
    words = ["export", "model.safetensors", "--to", "python", "--unproven"]
    assert run(words) == 0
    said = capsys.readouterr().out
    assert told in said and "(--without-index)" in said
    assert run([*words, "--without-index", "--force"]) == 0
    assert "without" not in capsys.readouterr().out
