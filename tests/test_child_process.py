"""Processes of our own never import what lies in the current folder."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxnarx
from jaxnarx.child_process import python_command, python_environment
from jaxnarx.data.readers import contents, sandbox
from jaxnarx.data.readers.columns import Asked
from jaxnarx.errors import DataFileError

NAMES = ("json", "select", "numpy", "jaxnarx", "pickle", "socket", "h5py", "typing")


@pytest.fixture(params=["console", "notebook"])
def hostile_folder(request, tmp_path, monkeypatch):
    """The working folder with modules that write `executed`; in a notebook it is on the
    module path."""
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text(
            f"open({str(tmp_path / 'executed')!r}, 'a').write('{name} ')\n"
        )
    elsewhere = [p for p in sys.path if p]
    first = [""] if request.param == "notebook" else []
    monkeypatch.setattr(sys, "path", [*first, *elsewhere])
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_reader_executes_nothing_of_the_current_folder(hostile_folder):
    np.savez("a.npz", speed=np.arange(3.0))
    sandbox.close()
    try:
        (column,) = contents(Path("a.npz"), Asked())
    finally:
        sandbox.close()
    assert column.name == "speed"
    assert not (hostile_folder / "executed").exists()


def test_a_relative_path_is_that_of_the_folder_we_are_in(tmp_path, monkeypatch):
    """The process that reads goes on while the working folder changes."""
    sandbox.close()
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        found: dict[str, Any] = {name: np.arange(3.0)}
        np.savez("a.npz", **found)
        (column,) = contents(Path("a.npz"), Asked())
        assert column.name == name
    (tmp_path / "second" / "a.npz").write_bytes(b"PK")
    with pytest.raises(DataFileError, match="^a.npz: "):
        contents(Path("a.npz"), Asked())
    sandbox.close()


@pytest.mark.parametrize(
    "code",
    [
        "import jaxnarx.identification.worker, jaxnarx.data.readers.sandbox",
        "import multiprocessing as m; m.get_context('spawn').Process().start()",
    ],
    ids=["search", "a process that it starts"],
)
def test_a_process_executes_nothing_of_the_current_folder(hostile_folder, code):
    done = subprocess.run(python_command(code), env=python_environment())
    assert done.returncode == 0
    assert not (hostile_folder / "executed").exists()


def test_modules_of_a_notebook_are_found_last(tmp_path, monkeypatch):
    (tmp_path / "own_of_a_notebook.py").write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    paths = python_environment()["PYTHONPATH"].split(os.pathsep)
    assert paths[-1] == str(tmp_path)
    done = subprocess.run(
        python_command("import own_of_a_notebook"), env=python_environment()
    )
    assert done.returncode == 0


def test_no_other_module_starts_python():
    package = Path(jaxnarx.__file__).parent
    started = {
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if re.search(r"sys\.executable", path.read_text())
    }
    assert started == {"child_process.py"}
