"""Running a toy sweep in a process of its own, and comparing what came out."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]

SCRIPT = """
import sys
from sweep_toys import Compiled, Toy
from jaxnarx.sweep import OverDevices, run_sweep

if __name__ == "__main__":
    toy = eval(sys.argv[2])
    options = eval(sys.argv[3])
    run_sweep(toy, sys.argv[1], progress=lambda row: print(row["done"], flush=True),
              **options)
"""


@pytest.fixture
def start(tmp_path):
    """Start a sweep in another process; what is still alive at the end is killed."""
    script = tmp_path / "script.py"
    started: list[subprocess.Popen[str]] = []

    def start(folder, toy: str, options: str, more=None, *, guard=True):
        script.write_text(
            SCRIPT if guard else SCRIPT.replace("if __name__ ==", "if True or", 1)
        )
        path = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])
        process = subprocess.Popen(
            [sys.executable, str(script), str(folder), toy, options],
            env={
                **os.environ,
                "PYTHONPATH": path,
                "JAX_ENABLE_X64": "1",
                **(more or {}),
            },
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def same_rows():
    """Assert that two tables hold the same rows, but for the seconds they took."""

    def same_rows(one, other):
        found = [t.arrow.drop_columns(["seconds"]) for t in (one, other)]
        assert found[0].schema == found[1].schema
        assert found[0].to_pylist() == found[1].to_pylist()

    return same_rows
