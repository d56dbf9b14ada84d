"""A reader in a process of its own, with bounds of memory and time.

For formats whose parsers may hang, take all memory or crash on a damaged file. The
process is started with the first file and serves those that follow; after a fault it is
ended, and the next file gets a new one. Requests and answers are lines of JSON, arrays
are files in a folder that both know.

The module that runs there has two functions: `contents(path, folder, **given)` answers
with the keyword arguments of every `Column`, `signals(path, folder, *, wanted,
**given)` with `{"signals": [...], "notes": [...]}`; a signal tells its name, unit and
labels, which file holds its time, if it has any, and whether all of it is valid.
"""

import atexit
import contextlib
import importlib
import json
import os
import selectors
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.child_process import python_command, python_environment
from jaxnarx.data.readers.columns import Asked, Table, require_limit
from jaxnarx.data.readers.rasters import Signal, as_table, one_raster
from jaxnarx.data.record import RowSource
from jaxnarx.errors import DataFileError, JaxnarxError
from jaxnarx.files import TemporaryFolder

START_CODE = "from jaxnarx.data.readers.sandbox import serve; serve()"
INTERPRETER_BYTES = 1e9
"""Bytes of memory beside those of the samples: the interpreter and its libraries."""
LEAST_SECONDS, BYTES_PER_SECOND = 60.0, 2e6
"""Seconds for a file, and bytes of it that are read in one more."""


def ask(module: str, function: str, path: Path, **given: Any) -> Any:
    """The answer of `function(path, folder, **given)` of a module, run in the
    process."""
    if not _READING_PROCESS:
        _READING_PROCESS.append(SandboxedReader())
    return _READING_PROCESS[0].ask(module, function, path, **given)


def read_isolated_table(
    module: str, path: Path, wanted: Sequence[str], asked: Asked, **given: Any
) -> Table:
    """The signals that a module finds: on one raster where they have a time."""
    given |= {"wanted": list(wanted), "max_bytes": asked.max_bytes}
    answer = ask(module, "signals", path, **given)
    place = RowSource(str(path), 1, ", counted from 1")
    array = _READING_PROCESS[0].array
    found = answer["signals"]
    _READING_PROCESS[0].require_limit(path, asked.max_bytes)
    times = {key: array(key) for key in {one["time"] for one in found} - {None}}
    parts = [
        (
            one["name"],
            one["unit"],
            array(f"x{k}"),
            None if one["valid"] else array(f"valid{k}"),
        )
        for k, one in enumerate(found)
    ]
    if not times:
        return as_table(parts, None, place, tuple(answer["notes"]))
    signals = [
        Signal(name, times[one["time"]], x, valid, unit, tuple(one["labels"]))
        for one, (name, unit, x, valid) in zip(found, parts, strict=True)
    ]
    table = one_raster(signals, place, asked.sample_time)
    notes = (*answer["notes"], *table.notes)
    return Table(table.columns, place, table.units, table.time, notes)


def table_file(name: str, path: Path, max_bytes: float) -> dict[str, Any]:
    """Columns of an arrow file that was the last answer about `path`."""
    import pyarrow as pa

    _READING_PROCESS[0].require_limit(path, max_bytes)
    with pa.OSFile(str(_READING_PROCESS[0].folder / name), "rb") as file:
        table = pa.ipc.open_file(file).read_all()
    return dict(zip(table.column_names, table.columns, strict=True))


def close() -> None:
    """End the process, if there is one; the next file begins another."""
    while _READING_PROCESS:
        _READING_PROCESS.pop().close()


class SandboxedReader:
    """The process, and the folder of its arrays."""

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None
        self._folder: TemporaryFolder | None = None
        atexit.register(self.close)

    def ask(self, module: str, function: str, path: Path, **given: Any) -> Any:
        """The answer of `function(path, **given)` of a reader, run in the process."""
        request = {"module": module, "function": function, "path": str(path)}
        request |= {"given": given, "folder": str(self.folder)}
        if not path.is_absolute():  # the process began where we may be no longer
            request["working_folder"] = os.getcwd()
        process = self._ensure_process()
        self._clear()
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
        except OSError:
            self.close()
            raise self._fault(path, "ended before the file") from None
        seconds = LEAST_SECONDS + path.stat().st_size / BYTES_PER_SECOND
        with selectors.DefaultSelector() as waiting:
            waiting.register(process.stdout, selectors.EVENT_READ)
            if not waiting.select(seconds):
                self._end()
                raise self._fault(path, f"took more than {seconds:.0f} s")
        line = process.stdout.readline()
        if not line.endswith(b"\n"):
            self._end()
            raise self._fault(path, "broke down over it")
        answer = json.loads(line)
        if "error" in answer:
            raise DataFileError(answer["error"], path=path)
        return answer["value"]

    def _clear(self) -> None:
        """Remove what the answer before has left."""
        for file in self.folder.iterdir():
            with contextlib.suppress(OSError):  # in use, where that forbids it
                file.unlink()

    @property
    def folder(self) -> Path:
        """The folder that holds the arrays of answers."""
        if self._folder is None:
            self._folder = TemporaryFolder()
        return self._folder.path

    def require_limit(self, path: Path, max_bytes: float) -> None:
        """DataFileError where the last answer takes more than `max_bytes`."""
        size = sum(file.stat().st_size for file in self.folder.iterdir())
        require_limit(path, size, max_bytes)

    def array(self, name: str) -> np.ndarray:
        """An array of the last answer, once: it is read from its file when used."""
        path = self.folder / f"{name}.npy"
        found = np.load(path, mmap_mode="r")
        with contextlib.suppress(OSError):  # where files in use may not be removed
            path.unlink()
            return found
        return np.array(found)

    def close(self) -> None:
        """End the process, and take its files away."""
        self._end()
        folder, self._folder = self._folder, None
        if folder is not None:
            folder.cleanup()

    def _ensure_process(self) -> subprocess.Popen:
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                python_command(START_CODE),
                env=python_environment(),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        return self._process

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()

    def _fault(self, path: Path, what: str) -> DataFileError:
        return DataFileError(
            f"{path}: cannot be read: what reads it {what}. The file is damaged, or "
            "too large; export it anew.",
            path=path,
        )


_READING_PROCESS: list[SandboxedReader] = []
"""The process that reads, once there is one."""


def serve() -> None:
    """Answer requests until there are no more."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    for line in sys.stdin.buffer:
        request = json.loads(line)
        try:
            answer = {"value": _answer(request)}
        except JaxnarxError as error:
            answer = {"error": str(error)}
        except MemoryError:
            answer = {"error": f"{request['path']}: takes more memory than it may."}
        except Exception as error:
            said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            told = f"{request['path']}: cannot be read ({said}). Export it anew."
            answer = {"error": told}
        answers.write(json.dumps(answer).encode() + b"\n")
        answers.flush()


def _answer(request: dict[str, Any]) -> Any:
    if "working_folder" in request:
        os.chdir(request["working_folder"])
    module = importlib.import_module(f"jaxnarx.data.readers.{request['module']}")
    _limit_memory(INTERPRETER_BYTES + float(request["given"].get("max_bytes", 0.0)))
    function = getattr(module, request["function"])
    return function(Path(request["path"]), Path(request["folder"]), **request["given"])


def _limit_memory(size: float) -> None:
    """Limit the memory of this process [bytes], where the system can.

    A limit that the system has set already stays, where it is lower.
    """
    try:
        import resource
    except ImportError:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = int(size) + 4 * 2**30  # libraries reserve addresses that they never use
    if hard != resource.RLIM_INFINITY:
        most = min(most, hard)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
