"""`jaxnarx control`: a controller from files, and what is wrong with these."""

import functools
import json

import numpy as np
import pytest
from control_problems import TIME, linear

import jaxnarx as jnx
from jaxnarx.exporters import ExportError
from jaxnarx.exporters.compilers import compiler
from jaxnarx.shell import control
from jaxnarx.shell.control import read_control_task

TASK = """
targets = ["speed"]
horizon = 6
preview = false
[commands.force]
rate = 2.0
effort = 0.01
[limits.heat]
at_most = 5.0
[noise]
speed = 0.001
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a model, another one that plays the engine, records and a task."""
    folder = tmp_path_factory.mktemp("control")
    jnx.save(linear(), folder / "model.safetensors")
    jnx.save(linear(), folder / "plant.safetensors")
    random = np.random.default_rng(1)
    u = np.repeat(random.uniform(-0.5, 0.5, (6, 2)), 15, axis=0)
    data = jnx.Dataset.from_arrays(
        u,
        np.zeros((90, 2)),
        inputs=["force", "load"],
        outputs=["speed", "heat"],
        sample_time=TIME,
    )
    y = jnx.simulate(linear(), data).value.outputs[0]
    rows = np.column_stack([TIME * np.arange(90), u, y])
    head = "time,force,load,speed,heat"
    np.savetxt(folder / "new.csv", rows, header=head, comments="", delimiter=",")
    (folder / "task.toml").write_text(TASK)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


@pytest.fixture
def jaxnarx(place, typed):
    return functools.partial(typed, "control")


def test_a_controller_is_tried_and_written(jaxnarx, place):
    line = "model.safetensors new.csv --task task.toml --plant plant.safetensors"
    code, out, err = jaxnarx(f"{line} --tune --name idle --out done")
    assert code == 0, err
    told = json.loads((place / "done" / "control.json").read_text())
    assert told["status"] == "ok" and told["nrmse"]["speed"] < 0.6
    assert told["kept"] == {"heat": 1.0}
    assert "efforts times" in " ".join(told["remarks"])
    assert "Closed loop" in out and "heat at most 5" in out
    if compiler() is not None:
        assert told["c"]["c, controller"] < 1e-6
    assert "commands: force" in (place / "done" / "idle_control.h").read_text()
    head, *rows = (place / "done" / "loop.csv").read_text().splitlines()
    assert head == "record,time [s],force,speed,heat,speed reference"
    assert len(rows) == 90
    assert (place / "done" / "tracking.png").stat().st_size > 1000
    code, _, err = jaxnarx(f"{line} --out done")
    assert code == 2 and "--force" in err


def test_what_is_wrong_is_named(jaxnarx, place):
    def refused(text, said):
        (place / "bad.toml").write_text(text)
        code, _, err = jaxnarx("model.safetensors new.csv --task bad.toml --out bad")
        assert code in (2, 3) and said in err, err

    refused("targets", "is no TOML")
    refused(TASK + "[more]\n", "unknown key 'more'")
    refused(TASK.replace("rate", "rat"), "commands.force")
    refused(TASK.replace("commands.force", "commands.wind"), "wind")
    refused('targets = ["speed"]\n[commands]\nforce = 3\n', "must be a table")
    refused(TASK.replace("at_most = 5.0", "at_most = nan"), "must be finite")
    refused(TASK.replace("speed = 0.001", "speed = -1.0"), "bad.toml: noise")
    refused(TASK.replace("speed = 0.001", "wind = 1.0"), "bad.toml: noise names")
    refused(TASK.replace('["speed"]', '["speed", "speed"]'), "named twice")
    refused(TASK.replace("at_most = 5.0", ""), "at_most")
    refused('targets = ["speed"]\ncommands = 3\n', "[commands.NAME]")
    code, _, err = jaxnarx("model.safetensors new.csv --task none.toml")
    assert code == 3 and "there is no such file" in err


def test_files_of_others_are_kept_and_a_constant_reference_has_no_score(jaxnarx, place):
    (place / "own").mkdir()
    (place / "own" / "model_control.c").write_text("mine")
    line = "model.safetensors still.csv --task task.toml --out"
    head, *rows = (place / "new.csv").read_text().splitlines()
    still = [",".join([*row.split(",")[:3], "0.1", "0.1"]) for row in rows]
    (place / "still.csv").write_text("\n".join([head, *still]) + "\n")
    code, _, err = jaxnarx(f"{line} own")
    assert code == 2 and "--force" in err
    assert (place / "own" / "model_control.c").read_text() == "mine"
    assert jaxnarx(f"{line} still")[0] == 0
    told = json.loads((place / "still" / "control.json").read_text())
    assert told["nrmse"] == {"speed": None} and list(told["plants"]) == [
        "model.safetensors"
    ]


def test_without_a_proof_the_loop_is_kept(jaxnarx, place, monkeypatch):
    def refuse(*args, **kwargs):
        raise ExportError("differs")

    monkeypatch.setattr(control, "export_controller", refuse)
    code, out, err = jaxnarx("model.safetensors new.csv --task task.toml --out loop")
    assert code == 1 and "differs" in out and "not written" in err
    assert {p.name for p in (place / "loop").iterdir()} == {
        *("control.json", "loop.csv", "tracking.png"),
    }


def test_a_task_names_what_it_leaves_to_defaults(place):
    (place / "short.toml").write_text('targets = ["speed"]\n[commands.force]\n')
    task = read_control_task("short.toml")
    assert set(task.controller) == {"commands", "limits", "targets"} and not task.loop
