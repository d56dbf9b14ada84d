"""Signals at random moments of `identify` and `sweep`: the right end, nothing half."""

import csv
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from sweep_toys import BED

from jaxnarx.sweep import read_sweep

FILES = {"model.safetensors", "report.html", "report.json"}
ENDS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -signal.SIGKILL}
LIMIT = 300
"""Seconds after which a command that should have ended is a failure."""
SOON = 30
"""Seconds that an interrupted one may take; on a machine with nothing else to do it
takes at most four."""

ENGINE = """
[data]
sample_time = 0.1
[channels.inputs]
u = "V"
[channels.outputs]
y = "V"
[records]
train = ["r0.csv", "r1.csv"]
test = ["r2.csv"]
"""
IDENTIFY = "identify engine.toml --terms 4 --steps 2 --window-steps 2 --out run"
SWEEP = "sweep bed.toml --folder run --chunk 1"
COMMANDS = {
    "identify": IDENTIFY,
    "sweep": SWEEP,
    "sweep on two processes": f"{SWEEP} --workers 2",
}


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Three records of a first-order lag, a bed, and no more."""
    rng = np.random.default_rng(1)
    for k in range(3):
        u = rng.standard_normal(200)
        y = np.zeros(200)
        for t in range(1, 200):
            y[t] = 0.8 * y[t - 1] + u[t - 1]
        with open(tmp_path / f"r{k}.csv", "w", newline="") as file:
            csv.writer(file).writerows([("u", "y"), *zip(u, y, strict=True)])
    (tmp_path / "engine.toml").write_text(ENGINE)
    (tmp_path / "bed.toml").write_text(BED.replace("count = 2", "count = 3"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("JAXNARX_DATA", raising=False)
    return tmp_path


def started(line: str) -> subprocess.Popen[str]:
    """The command, once it has a handler of its own for signals."""
    process = subprocess.Popen(
        [sys.executable, "-m", "jaxnarx.shell.cli", *line.split()],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    status = Path(f"/proc/{process.pid}/status")
    while not _catches(status, signal.SIGTERM):
        assert process.poll() is None, process.communicate()
        time.sleep(0.002)
    return process


def _catches(status: Path, number: int) -> bool:
    lines = [s for s in status.read_text().splitlines() if s.startswith("SigCgt")]
    return bool(lines) and bool(int(lines[0].split()[1], 16) >> (number - 1) & 1)


def completed(line: str) -> float:
    """Run the command to its end; seconds from its first handler on."""
    process, begin = started(line), time.monotonic()
    _, errors = process.communicate(timeout=LIMIT)
    assert process.returncode == 0, errors
    return time.monotonic() - begin


def leftovers() -> list[Path]:
    """What only an unfinished command has."""
    found = Path("run").rglob("*")
    return [p for p in found if p.name.startswith(".unfinished") or ".tmp" in p.name]


def require_sound(name: str, number: int) -> bool:
    """Files are all there or not at all; whether the command had come to its end."""
    if number != signal.SIGKILL:
        assert not leftovers()
    if name == "identify":
        there = {p.name for p in Path("run").glob("*")} & FILES
        assert there in (set(), FILES)
        return there == FILES
    if any(Path("run/chunks").glob("*.parquet")):
        # A start may diverge with so few samples; nothing may be missing.
        assert not {"crashed", "not_run"} & set(read_sweep("run").column("status"))
    return Path("run/table.csv").exists()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("name", COMMANDS)
def test_interrupts(battery, place, name):
    line, signals = COMMANDS[name], list(ENDS)
    whole = max(completed(line), 0.5)

    def attempt(rng):
        shutil.rmtree("run")
        number = signals[int(rng.integers(0, len(signals)))]
        process = started(line)
        time.sleep(float(rng.uniform(0, 1.1)) * whole)
        begin = time.monotonic()
        process.send_signal(number)
        _, errors = process.communicate(timeout=LIMIT)
        code, took = process.returncode, time.monotonic() - begin
        assert code in (0, ENDS[number]), (code, number, errors)
        assert code == 0 or took < SOON, took
        assert "Traceback" not in errors and "defect" not in errors, errors
        last = errors.splitlines()[-1:]
        assert code < 1 or last[0].startswith("jaxnarx: interrupted"), errors
        done = require_sound(name, number)
        assert done or code, "it says it is done and is not"
        if not (done and name == "identify"):
            completed(line)
            assert not leftovers() and require_sound(name, 0)

    small = type(battery)(battery.seed, -(-battery.cases // 60), battery.first)
    small.run(attempt, seconds=2 * LIMIT, megabytes=2000)
