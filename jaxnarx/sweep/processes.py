"""Several processes of this machine, a core for each: a dask cluster of its own."""

import contextlib
import dataclasses
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker

import dask.config
import jax
from distributed import Client, LocalCluster, Worker, WorkerPlugin
from distributed.scheduler import NoWorkerError
from distributed.utils import silence_logging_cmgr

from jaxnarx.child_process import SAFE_ENVIRONMENT, one_thread
from jaxnarx.errors import JaxnarxError
from jaxnarx.sweep.cluster import compute_on_cluster, worker_threads
from jaxnarx.sweep.folder.run_folder import RunFolder
from jaxnarx.sweep.precision import is_float64
from jaxnarx.sweep.work import Work

SILENT_LEVEL = logging.CRITICAL + 1
"""Level at which dask logs nothing: this package reports what matters."""

_WAIT_SETTINGS = {"distributed.deploy.lost-worker-timeout": "1 day"}
_SCHEDULER_SETTINGS = {
    "distributed.scheduler.allowed-failures": 1,
    "distributed.scheduler.no-workers-timeout": "5 minutes",
    "distributed.scheduler.worker-ttl": None,  # a compilation may keep Python waiting
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.multiprocessing-method": "spawn",  # jax does not survive a fork
}


def compute_in_processes(
    run: RunFolder, work: Work, workers: int, tell: Callable[[], None]
) -> list[str]:
    """Have `workers` new processes compute what is open; returns notes.

    Each runs on one thread and, where the system allows, one core, with this process's
    number type. One that is killed is replaced, and its chunks are computed again. All
    end with this process, at once, however it ends. They talk over this machine's own
    address (127.0.0.1), by keys that live as long as they do: nobody else is let in.
    """
    with (
        _environment(_child_environment()),
        silence_logging_cmgr(SILENT_LEVEL),
        _cluster(workers) as client,
    ):
        crew = set(worker_threads(client))
        try:
            notes = compute_on_cluster(run, work, client, tell)
        except NoWorkerError as error:
            raise JaxnarxError(
                f"{run.path}: the processes ended and no others could be started, with "
                f"{len(run.unfinished_chunks())} of {run.chunks} chunks open. That is "
                "often the system's answer to too little memory: use fewer workers. "
                "The same command continues."
            ) from error
        lost = len(crew - set(worker_threads(client)))
    return [f"{lost} of {len(crew)} processes were lost", *notes] if lost else notes


@contextlib.contextmanager
def _cluster(workers: int) -> Iterator[Client]:
    """A cluster of new processes; while they live, dask waits for a lost one's
    successor however long it takes to start."""
    with contextlib.ExitStack() as stack:
        # This dask reads when a process is lost, the others when the cluster begins.
        stack.enter_context(dask.config.set(_WAIT_SETTINGS))
        with _deaf(), dask.config.set(_SCHEDULER_SETTINGS):
            cluster = _start_cluster(workers)
            stack.callback(_end, cluster)
            client = stack.enter_context(Client(cluster, set_as_default=False))
        yield client


def _start_cluster(workers: int) -> LocalCluster:
    try:
        return LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,  # the system's own
            security=True,
            silence_logs=SILENT_LEVEL,
            plugins=(_Place(_cores()),),
        )
    except RuntimeError as error:
        raise JaxnarxError(
            f"the {workers} processes did not start ({error}). A script that asks for "
            'workers needs the guard `if __name__ == "__main__"`.'
        ) from error


def _end(cluster: LocalCluster) -> None:
    """At once, whatever they compute: a killed process leaves nothing that hurts."""
    crew = list(cluster.workers.values())
    for nanny in crew:
        nanny.close_gracefully()  # it starts no other in its place
    for nanny in crew:
        if nanny.pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(nanny.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
    cluster.close()


@dataclasses.dataclass(frozen=True)
class _Place(WorkerPlugin):
    """The first act of a worker: it takes a core, and leaves Ctrl-C to its parent."""

    cores: list[int]

    def setup(self, worker: Worker) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if self.cores:
            with contextlib.suppress(OSError):
                os.sched_setaffinity(0, {self.cores[worker.name % len(self.cores)]})


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """Threads and processes begun inside never hear Ctrl-C, which reaches the whole
    group; it is this process that ends them. Here signals are heard afterwards.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: list[int] = []
    numbers = [
        n for n in (signal.SIGINT, signal.SIGTERM) if callable(signal.getsignal(n))
    ]
    before = {n: signal.signal(n, lambda n, _: heard.append(n)) for n in numbers}
    resource_tracker.ensure_running()  # which, when it starts, would let signals in
    if hasattr(signal, "pthread_sigmask"):  # inherited; other threads may still hear
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if hasattr(signal, "pthread_sigmask"):
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        for number, handler in before.items():
            signal.signal(number, handler)
    for number in heard:
        signal.raise_signal(number)


def _cores() -> list[int]:
    """Cores this process may use; empty where the system does not tell."""
    with contextlib.suppress(AttributeError, OSError):
        return sorted(os.sched_getaffinity(0))
    return []


def _child_environment() -> dict[str, str]:
    """One thread for everything, and jax configured as it is here."""
    settings = (
        SAFE_ENVIRONMENT | one_thread() | {"JAX_ENABLE_X64": str(int(is_float64()))}
    )
    for name in ("jax_compilation_cache_dir", "jax_platforms"):
        if value := getattr(jax.config, name):
            settings[name.upper()] = str(value)
    return settings


@contextlib.contextmanager
def _environment(settings: dict[str, str]) -> Iterator[None]:
    """Variables that processes started inside inherit; ours are as before after, also
    those that dask sets.
    """
    before = dict(os.environ)
    os.environ.update(settings)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)
