"""Two runs with one folder, and what killed runs leave in it."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.shell import unfinished
from jaxnarx.shell.output import run_folder, write_text, write_together

BUSY = """
import sys, time
from pathlib import Path
from jaxnarx.shell import interrupt
from jaxnarx.shell.output import run_folder, write_together
interrupt.listen()
out = sys.argv[1] if len(sys.argv) > 1 else None
with run_folder(out, "engine", force=False, marks=["model"]) as folder:
    with write_together(folder) as place:
        (place / "report").write_text("half")
        print(folder, flush=True)
        time.sleep(100)
"""


@pytest.fixture
def busy(tmp_path, monkeypatch):
    """Start a process in the midst of a run; returns it and the run's folder."""
    monkeypatch.chdir(tmp_path)
    started = []

    def start(*out):
        process = subprocess.Popen(
            [sys.executable, "-c", BUSY, *out],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        assert process.stdout
        return process, Path(process.stdout.readline().strip())

    yield start
    for process in started:
        process.kill()
        process.communicate()


def write(folder, text, *, marks=("model",), force=False):
    with run_folder(folder, "engine", force=force, marks=marks) as made:
        with write_together(made) as place:
            for mark in marks:
                write_text(place / mark, text)
    return made


def test_a_second_run_is_refused_where_it_would_write_the_same_files(busy):
    process, folder = busy("x")
    for force in (False, True):
        with pytest.raises(SpecError, match="another run is writing model to x; wait"):
            write("x", "ours", force=force)
    # what is being put in place counts as well; other files do not
    with pytest.raises(SpecError, match="another run is writing report"):
        write("x", "ours", marks=["report"])
    assert write("x", "ours", marks=["other"]) == Path("x")
    process.kill()
    process.wait()
    write("x", "ours")
    assert {p.name: p.read_text() for p in folder.iterdir()} == {
        "model": "ours",
        "other": "ours",
    }


def test_what_a_killed_run_leaves_is_cleared_by_the_next(busy):
    process, folder = busy()
    living, other = busy()
    assert (folder, other) == (Path("runs/engine"), Path("runs/engine-2"))
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert len(list(folder.glob(".unfinished-*"))) == 2
    assert write(None, "ours") == folder
    assert os.listdir(folder) == ["model"]
    assert len(list(other.glob(".unfinished-*"))) == 2 and living.poll() is None


def test_sigterm_leaves_nothing(busy):
    process, folder = busy("a/x")
    process.send_signal(signal.SIGTERM)
    process.wait()
    assert not folder.parent.exists()


def test_a_full_disk_is_said_with_the_folder_and_what_to_do(tmp_path, monkeypatch):
    def full(path, data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(DataFileError) as error:
        write(str(tmp_path / "x"), "ours")
    assert str(error.value).startswith(f"{tmp_path / 'x'}: cannot be written (No space")
    assert "Free some space and give the same command again" in str(error.value)
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("when", ["made", "locked", "removed"])
def test_an_interrupt_at_any_moment_leaves_nothing(tmp_path, monkeypatch, when):
    real = {"made": Path.mkdir, "locked": unfinished.lock_folder}
    real["removed"] = unfinished.shutil.rmtree
    where = {
        "made": (Path, "mkdir"),
        "locked": (unfinished, "lock_folder"),
        "removed": (unfinished.shutil, "rmtree"),
    }

    def interrupted(place, *args, **kwargs):
        if unfinished.UNFINISHED_PREFIX not in Path(place).name:
            return real[when](place, *args, **kwargs)
        monkeypatch.undo()
        if when != "removed":
            real[when](place, *args, **kwargs)
        raise KeyboardInterrupt

    monkeypatch.setattr(*where[when], interrupted)
    with pytest.raises(KeyboardInterrupt), unfinished.new_folder(tmp_path, ["report"]):
        pass
    assert not [
        p for p in tmp_path.iterdir() if p.name.startswith(unfinished.UNFINISHED_PREFIX)
    ]
