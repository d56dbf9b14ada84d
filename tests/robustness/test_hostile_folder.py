"""Commands in a folder with modules of Python's names: none of them is executed."""

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import common
import numpy as np
import pytest
from format_writers import NO_TIME_COLUMN, WRITERS
from sweep_toys import BED

from jaxnarx.models import save

pytestmark = pytest.mark.slow

NAMES = sorted(
    {*sys.stdlib_module_names, *importlib.metadata.packages_distributions()}
    | {"sitecustomize", "usercustomize", "distutils"}
)
"""Of all modules of Python and of the packages that are there."""
CODE = """
import os
with open({mark!r}, "a") as file:
    file.write({name!r} + " ")
raise ImportError("a module of the folder of data")
"""


def description(kind: str) -> str:
    lines = ["[data]", "sample_time = 0.1"]
    lines += [] if kind in NO_TIME_COLUMN else ['time = "time"']
    lines += ["unit_row = true"] if kind == "csv" else []
    for what in ("inputs", "outputs"):
        lines.append(f"[channels.{what}]")
        lines += [f'{c.name} = "{c.unit}"' for c in getattr(common.CHANNELS, what)]
    return "\n".join([*lines, f'[records]\ntrain = ["r*.{kind}"]'])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two records of two outputs in every format, a model, and the modules."""
    folder = tmp_path_factory.mktemp("hostile")
    data = common.dataset()
    names, step = data.channels.names, data.sample_time
    units = {c.name: c.unit for c in data.channels.inputs + data.channels.outputs}
    units["time"] = "s"
    for kind, write in WRITERS.items():
        for n, record in enumerate(data.records[:2]):
            x = np.concatenate([record.u, record.y], axis=1)
            columns = {"time": step * np.arange(len(x))}
            columns |= dict(zip(names, x.T.copy(), strict=True))
            write(folder / f"r{n}.{kind}", columns, units)
        (folder / f"{kind}.toml").write_text(description(kind))
    save(common.named("one model"), folder / "m.safetensors")
    (folder / "sweep.toml").write_text(BED)
    for name in NAMES:
        code = CODE.format(mark=str(folder / "executed"), name=name)
        (folder / f"{name}.py").write_text(code)
    return folder


COMMANDS = {
    "check": "check {kind}.toml",
    "describe": "describe r0.{kind} r1.{kind} --out of-{kind}.toml",
    "simulate": "simulate m.safetensors r0.{kind} --out out-{kind}",
    "report": "report m.safetensors {kind}.toml --out report-{kind}",
    "prepare": "prepare {kind}.toml --decimate 2 --out prepared-{kind}",
}


def executed(folder: Path, line: str) -> str:
    """The modules that a command has executed; it may not end as a defect."""
    mark = folder / "executed"
    mark.unlink(missing_ok=True)
    console = Path(sys.executable).with_name("jaxnarx")
    done = subprocess.run(
        [str(console), *line.split()], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode in (0, 1), f"{line}: {done.stderr[-600:]}"
    return mark.read_text() if mark.exists() else ""


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("command", COMMANDS)
def test_no_module_of_the_folder_is_executed(folder, command, kind):
    assert not executed(folder, COMMANDS[command].format(kind=kind))


@pytest.mark.parametrize(
    "line",
    [
        "identify csv.toml --candidates 2 --out search",
        "export m.safetensors csv.toml --to c python --out exported",
        "sweep sweep.toml --folder swept --workers 2 --chunk 1",
        "simulate-engine pfi-cc --duration 10 --records 1 --out bed",
        "leaderboard search",
        "take search 1 1001 --out taken",
    ],
    ids=lambda line: line.split()[0],
)
def test_other_commands_execute_none_either(folder, line):
    assert not executed(folder, line)
