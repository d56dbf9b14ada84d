"""The search for one output, here or in a process of its own.

A process is given its task by a file and answers by files in the same folder: a pickle
for every candidate, its model beside it. Whole files only, and none that any other
program reads or leaves behind. It ends with the process that has started it.
"""

import dataclasses
import os
import pickle
import signal
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax

from jaxnarx.child_process import one_thread, python_command, python_environment
from jaxnarx.data import Dataset, Groups
from jaxnarx.files import TemporaryFolder, write_whole
from jaxnarx.identification.candidates import (
    CandidateFactory,
    CandidateSearch,
    Tried,
    Trying,
    Watch,
)
from jaxnarx.identification.leaderboard import Candidate
from jaxnarx.models import Network, load, save
from jaxnarx.partition import DataProfile
from jaxnarx.settings import PRESETS, Partitioner, Physics

TASK_FILE, END_FILE, ERROR_FILE, TRYING_KEY, OUTPUT_FILE = (
    "task",
    "end",
    "error",
    "now",
    "said.txt",
)
START_CODE = f"import sys; from {__name__} import main; main(sys.argv[1])"
"""The module by its name, so that classes of pickles are its own."""
WATCH_SECONDS = 1.0
"""Seconds between looks whether the process that has started this one is there."""


@dataclasses.dataclass(frozen=True)
class OutputTask:
    """The arguments of the search for one output."""

    data: Dataset
    profile: DataProfile
    groups: Groups
    preset: str
    candidates: int | None
    until: float
    """Time of the clock after which no candidate is begun."""
    known: tuple[Candidate, ...]
    states: int | None = None
    added: Mapping[str, CandidateFactory] = dataclasses.field(default_factory=dict)
    partitions: Mapping[str, Partitioner] = dataclasses.field(default_factory=dict)
    physics: Physics | None = None
    at_rest: Dataset | None = None

    def run(self, watch: Watch) -> Iterator[Tried]:
        """Its candidates; `watch` hears of each while it is tried."""
        found = CandidateSearch(
            self.data,
            self.profile,
            self.groups,
            PRESETS[self.preset].with_orders(self.states),
            known=self.known,
            late=lambda: self._late(found.passed),
            added=self.added,
            partitions=self.partitions,
            watch=watch,
            physics=self.physics,
            at_rest=self.at_rest,
        )
        yield from found

    def _late(self, passed: int) -> bool:
        """Whether enough has been tried."""
        enough = self.candidates is not None and passed >= self.candidates
        return enough or time.time() > self.until


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class SearchWorker:
    """A process at work on a task, on one thread."""

    def __init__(self, task: OutputTask):
        self._folder = TemporaryFolder()
        self.place, self.read = self._folder.path, 0
        self.told: Trying | None = None
        _write(self.place / TASK_FILE, (task, _settings()))
        with open(self.place / OUTPUT_FILE, "wb") as said:
            self.process = subprocess.Popen(
                python_command(START_CODE, str(self.place)),
                env=python_environment(one_thread()),
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=said,
            )

    @property
    def ended(self) -> bool:
        """Whether all candidates are there to be read."""
        return (self.place / END_FILE).exists() or self.process.poll() is not None

    def read_new(self) -> Iterator[Tried]:
        """Candidates that are new; what has stopped the search is raised here."""
        while (path := self.place / str(self.read)).exists():
            row, has = _read(path)
            yield row, self._network() if has else None
            self.read += 1
        if (self.place / ERROR_FILE).exists():
            raise _read(self.place / ERROR_FILE)
        if self.process.poll() and not (self.place / END_FILE).exists():
            said = (
                (self.place / OUTPUT_FILE).read_text(errors="replace").strip()[-2000:]
            )
            raise RuntimeError(
                f"the search in process {self.process.pid} ended with "
                f"{self.process.returncode}: {said or 'it said nothing'}"
            )

    def read_trying(self) -> Trying | None:
        """The candidate that is being tried, where that is new."""
        path = self.place / TRYING_KEY
        if not path.exists() or (now := _read(path)) == self.told:
            return None
        self.told = now
        return now

    def _network(self) -> Network:
        return load(self.place / f"{self.read}.safetensors")

    def close(self) -> None:
        """End it, and take its files away."""
        self.process.kill()
        self.process.wait()
        self._folder.cleanup()


def _settings() -> dict[str, Any]:
    names = ("jax_enable_x64", "jax_compilation_cache_dir")
    names += ("jax_persistent_cache_min_compile_time_secs",)
    return {name: getattr(jax.config, name) for name in names}


def _write(path: Path, value: Any) -> None:
    write_whole(path, pickle.dumps(value))


def _read(path: Path) -> Any:
    return pickle.loads(path.read_bytes())


def _leave_with(parent: int) -> None:
    """End at once when the process that has started this one is gone."""
    while os.getppid() == parent:
        time.sleep(WATCH_SECONDS)
    os._exit(1)


def main(folder: str) -> None:
    """Search, and write every candidate into the folder."""
    place = Path(folder)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    task, settings = _read(place / TASK_FILE)

    def watch(trying: Trying) -> None:
        _write(place / TRYING_KEY, trying)

    for name, value in settings.items():
        jax.config.update(name, value)
    try:
        for n, (row, network) in enumerate(task.run(watch)):
            if network is not None:
                save(network, place / f"{n}.safetensors")
            _write(place / str(n), (row, network is not None))
        _write(place / END_FILE, None)
    except Exception as error:
        _write(place / ERROR_FILE, error)
