"""The search for the best model: outputs side by side, candidates one after another.

Outputs are searched in processes of their own where there are several and cores for
them. What was tried is on the disk after every candidate.
"""

import dataclasses
import multiprocessing
import os
import queue
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.data import Dataset, Groups
from jaxnarx.data import groups as make_groups
from jaxnarx.evaluation.notes import data_hash
from jaxnarx.identification.candidates import Candidates, Tried
from jaxnarx.identification.leaderboard import Leaderboard, Row
from jaxnarx.identification.search_folder import SearchFolder, open_search
from jaxnarx.methods import PRESETS
from jaxnarx.models import Network, load, merged, save
from jaxnarx.output_error import Look, look
from jaxnarx.solution import RESULTS, Solution

Tell = Callable[[dict[str, Any]], None]
SHARE = 100
"""Numbers that the candidates of one output have."""
POLL = 0.2
"""Seconds between looks at what the processes have found."""


@dataclasses.dataclass(frozen=True)
class Task:
    """What one output's search is told."""

    data: Dataset
    look: Look
    groups: Groups
    preset: str
    candidates: int | None
    until: float
    """Time of the wall clock after which no candidate is begun."""
    known: frozenset[str]

    def run(self) -> Iterator[Tried]:
        """Its candidates."""
        found = Candidates(
            self.data,
            self.look,
            self.groups,
            PRESETS[self.preset],
            known=self.known,
            late=lambda: time.time() > self.until,
        )
        for n, one in enumerate(found, 1):
            yield one
            if self.candidates is not None and n >= self.candidates:
                return


def search(
    data: Dataset,
    *,
    preset: str,
    budget: float | None,
    candidates: int | None,
    groups: Groups | None,
    outputs: Sequence[str],
    folder: Path | None,
    progress: Tell | None,
) -> Solution[Network]:
    """The best model by groups left out; see `jaxnarx.identify`."""
    tell = progress or (lambda event: None)
    begin = time.time()
    looks = {name: look(data, name) for name in outputs}
    if groups is None:
        groups = make_groups(data, gap=max(one.memory for one in looks.values()))
    rule = PRESETS[preset].rule
    board = Leaderboard((), groups.names, rule)
    key = {
        "data": data_hash(data),
        "preset": preset,
        "candidates": candidates,
        "outputs": list(outputs),
        "groups": list(groups.names),
    }
    until = begin + (PRESETS[preset].budget if budget is None else budget)
    with tempfile.TemporaryDirectory() as place:
        store = open_search(Path(place) if folder is None else folder, key, board)
        tasks = {
            name: Task(
                data, one, groups, preset, candidates, until, _known(store, name)
            )
            for name, one in looks.items()
        }
        race = Race(store, list(outputs), tell, begin)
        stopped = False
        try:
            race.run(tasks)
        except KeyboardInterrupt:
            if not len(race.store.leaderboard):
                raise
            stopped = True
        facts = {n: k.to_dict(data.channels.input_names) for n, k in looks.items()}
        return _solution(race.store, list(outputs), stopped, facts)


def _known(store: SearchFolder, output: str) -> frozenset[str]:
    rows = store.leaderboard.rows
    return frozenset(f"{r.family}: {r.name}" for r in rows if r.output == output)


class Race:
    """Candidates of all outputs as they come."""

    def __init__(self, store: SearchFolder, outputs: list[str], tell: Tell, begin):
        self.store, self.outputs, self.tell, self.begin = store, outputs, tell, begin

    def run(self, tasks: dict[str, Task]) -> None:
        """Search every output."""
        workers = min(len(os.sched_getaffinity(0)), len(tasks))
        if workers < 2:
            for name, task in tasks.items():
                for tried in task.run():
                    self.add(name, *tried)
        else:
            self._side_by_side(tasks, workers)

    def add(self, output: str, row: Row, network: Network | None) -> None:
        """Keep one candidate and tell of it."""
        rows = self.store.leaderboard.rows
        same = [
            r
            for r in rows
            if (r.output, r.family, r.name) == (output, row.family, row.name)
        ]
        if same:
            return
        own = sum(r.output == output for r in rows)
        number = SHARE * self.outputs.index(output) + own + 1
        row = dataclasses.replace(row, number=number)
        self.store = self.store.added(row, network)
        board = self.store.leaderboard
        self.tell(
            {
                "verb": "search",
                "row": row,
                "chosen": board.chosen(output),
                "done": len(board),
                "of": None,
                "seconds": time.time() - self.begin,
                "left": None,
            }
        )

    def _side_by_side(self, tasks: dict[str, Task], workers: int) -> None:
        """A process for every output, as many at a time as there are cores."""
        context = multiprocessing.get_context("spawn")
        found = context.Queue()
        waiting, running = list(tasks.items()), {}
        try:
            while waiting or running:
                while waiting and len(running) < workers:
                    name, task = waiting.pop(0)
                    running[name] = _started(context, name, task, found, self.store)
                self._take(found, running)
        finally:
            for process in running.values():
                process.terminate()
                process.join()

    def _take(self, found, running: dict) -> None:
        """What has come from the processes; those that have ended leave."""
        try:
            kind, name, payload = found.get(timeout=POLL)
        except queue.Empty:
            for name, process in list(running.items()):
                if not process.is_alive():
                    process.join()
                    del running[name]
                    if process.exitcode:
                        raise RuntimeError(
                            f"the search for {name} ended with {process.exitcode}"
                        ) from None
            return
        if kind == "row":
            row, path = payload
            network = None if path is None else load(path)
            if path is not None:
                Path(path).unlink()
            self.add(name, row, network)
        elif kind == "error":
            raise payload
        else:
            running.pop(name).join()


def _started(context, name: str, task: Task, found, store: SearchFolder):
    """A process at work on one output, with one thread for linear algebra."""
    place = store.path / f".{os.getpid()}-{name}"
    kept = {k: os.environ.get(k) for k in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        process = context.Process(
            target=work, args=(name, task, found, str(place)), daemon=True
        )
        process.start()
    finally:
        for k, value in kept.items():
            os.environ.pop(k, None) if value is None else os.environ.update({k: value})
    return process


THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def work(name: str, task: Task, found, place: str) -> None:
    """Search one output and send every candidate; models go by files."""
    import signal

    import jax

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    jax.config.update("jax_enable_x64", task.data.records[0].u.dtype == np.float64)
    try:
        for n, (row, network) in enumerate(task.run()):
            path = None
            if network is not None:
                path = f"{place}-{n}.safetensors"
                save(network, path)
            found.put(("row", name, (row, path)))
        found.put(("end", name, None))
    except Exception as error:
        found.put(("error", name, error))


def _solution(
    store: SearchFolder, outputs: list[str], stopped: bool, facts: dict
) -> Solution[Network]:
    """The chosen networks as one; the safest where all candidates are vetoed."""
    board, networks, vetoed = store.leaderboard, [], []
    for output in outputs:
        row = board.chosen(output)
        if row is None:
            vetoed.append(output)
            row = next((r for r in board.of(output) if r.family == "constant"), None)
        if row is not None:
            networks.append(store.network(row.number))
    status, detail = RESULTS.ok, ""
    if stopped:
        status, detail = RESULTS.budget_spent, "interrupted; the best so far"
    if vetoed:
        status = RESULTS.diverged
        detail = f"every candidate of {', '.join(vetoed)} diverges"
    stats = {"leaderboard": board, "look": facts}
    return Solution(merged(networks), status, stats, detail)
