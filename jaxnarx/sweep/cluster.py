"""A sweep on a dask cluster: chunks are tasks, this process writes their results."""

import collections
import contextlib
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, cast

from distributed import CancelledError, Client, Future, KilledWorker

from jaxnarx.errors import JaxnarxError, SpecError
from jaxnarx.sweep.folder.claims import Claims
from jaxnarx.sweep.folder.run_folder import RunFolder
from jaxnarx.sweep.loop import PAUSE_SECONDS
from jaxnarx.sweep.precision import is_float64, number_type
from jaxnarx.sweep.rows import Row, compute_rows
from jaxnarx.sweep.work import Work

CHUNKS_PER_THREAD = 2
"""Chunks in flight for every thread of the cluster."""

Part = tuple[int, Sequence[int]]
"""Number of a chunk and some of its members."""


def compute_on_cluster(
    run: RunFolder, work: Work, client: Any, tell: Callable[[], None]
) -> list[str]:
    """Have the workers of a dask `Client` compute what is open; returns notes.

    This process claims the chunks it sends off and writes their files; other processes
    may help through the folder. dask gives the chunks of a worker that dies to another.
    A chunk at which several workers have died is halved, until the member that kills
    them is alone and a row with status `crashed`.
    """
    if not isinstance(client, Client):
        raise SpecError(
            f"client must be a dask.distributed Client, got {type(client).__name__}",
            field="client",
        )
    with _explain_silence(run, client), Claims(run.claims) as claims:
        crew = _Crew(run, work, client)
        try:
            while run.unfinished_chunks():
                _send(run, crew, claims)
                finished = crew.collect()
                for number, rows in finished:
                    run.write(number, rows)
                    claims.release(number)
                if not finished:
                    time.sleep(PAUSE_SECONDS)
                tell()
        finally:
            crew.dismiss()
    lost = crew.lost
    return [f"workers died at {lost} tasks, which were tried again"] if lost else []


@contextlib.contextmanager
def _explain_silence(run: RunFolder, client: Client) -> Iterator[None]:
    """JaxnarxError, with how to go on, where the scheduler is gone."""
    try:
        yield
    except (OSError, CancelledError) as error:
        if client.status == "running":
            raise
        raise JaxnarxError(
            f"{run.path}: the dask scheduler does not answer any more, with "
            f"{len(run.unfinished_chunks())} of {run.chunks} chunks open. Start "
            "another and make a client of it: the same call goes on where it stopped."
        ) from error


def _send(run: RunFolder, crew: "_Crew", claims: Claims) -> None:
    """Fill the cluster with chunks that nobody has."""
    for number in run.unfinished_chunks():
        if crew.is_full():
            return
        if number in crew.awaited or not claims.take(number):
            continue
        if run.is_finished(number):
            claims.release(number)
        else:
            crew.submit(number, run.members(number))


class _Crew:
    """Tasks in flight on a cluster, each a chunk or a part of one.

    dask blames a worker's death on all its tasks. So those that are blamed are tried
    again one at a time, with nothing else in flight, and only then divided.
    """

    def __init__(self, run: RunFolder, work: Work, client: Client):
        self.client, self.labels, self.size = client, work.members, run.manifest.chunk
        # A task rather than scattered data: dask makes it anew where it was lost.
        self.load = client.submit(_same, pickle.dumps(work), pure=False)
        self.tasks: dict[Future, Part] = {}
        self.suspects: list[Part] = []
        self.on_trial = False
        self.awaited: dict[int, int] = collections.Counter()
        self.rows: dict[int, list[Row]] = {}
        self.lost = 0

    def is_full(self) -> bool:
        """Whether every thread of the cluster has enough to do, or a trial is on."""
        threads = sum(worker_threads(self.client).values())
        busy = len(self.tasks) >= CHUNKS_PER_THREAD * max(threads, 1)
        return busy or self.on_trial or bool(self.suspects)

    def submit(self, number: int, members: Sequence[int]) -> None:
        """Send off a chunk."""
        self.awaited[number] += 1
        self._submit(number, members)

    def collect(self) -> list[tuple[int, list[Row]]]:
        """Chunks that are complete since the last call, with their rows in order."""
        complete = []
        for task in [task for task in self.tasks if task.done()]:
            number, members = self.tasks.pop(task)
            self._receive(task, number, members)
            self.awaited[number] -= 1
            if not self.awaited[number]:
                del self.awaited[number]
                rows = self.rows.pop(number)
                complete.append((number, sorted(rows, key=lambda row: row["index"])))
        if not self.tasks:
            self.on_trial = bool(self.suspects)
            if self.suspects:
                self._submit(*self.suspects.pop())
        return complete

    def dismiss(self) -> None:
        """Give up what is still in flight, where there is a scheduler to hear it."""
        if self.client.status == "running":
            self.client.cancel([*self.tasks, self.load])

    def _submit(self, number: int, members: Sequence[int]) -> None:
        labels = [self.labels[i] for i in members]
        arguments = (self.load, members, labels, self.size, is_float64())
        task = self.client.submit(_compute, *arguments, pure=False)
        self.tasks[task] = (number, members)

    def _receive(self, task: Future, number: int, members: Sequence[int]) -> None:
        rows = self.rows.setdefault(number, [])
        try:
            rows += task.result()
        except KilledWorker:
            self.lost += 1
            if self.on_trial and len(members) == 1:
                rows.append(_killed_row(members[0], self.labels[members[0]]))
                return
            half = len(members) // 2 if self.on_trial else 0
            parts = [part for part in (members[:half], members[half:]) if part]
            self.suspects += [(number, part) for part in parts]
            self.awaited[number] += len(parts)


def worker_threads(client: Client) -> dict[str, int]:
    """Number of threads of every worker that is there, by its address."""
    return cast(dict[str, int], client.nthreads())


def _same(load: bytes) -> bytes:
    return load


def _killed_row(index: int, label: dict[str, Any]) -> Row:
    message = (
        "it killed the workers that computed it; often the system does so for want of "
        "memory"
    )
    failed = {"seconds": 0.0, "status": "crashed", "message": message}
    return {"index": index, **label, **failed}


def _compute(
    load: bytes,
    members: Sequence[int],
    labels: list[dict[str, Any]],
    size: int,
    float64: bool,
) -> list[Row]:
    """The task: rows of some members, in the number type of the process that asks."""
    with number_type(float64):
        return compute_rows(pickle.loads(load), members, labels, size, size)[0]
