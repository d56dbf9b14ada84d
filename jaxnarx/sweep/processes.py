"""Several processes of this machine on one run folder, a core for each."""

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any

import jax

from jaxnarx.errors import JaxnarxError
from jaxnarx.sweep.folder.claims import clear_dead
from jaxnarx.sweep.folder.run_folder import RunFolder
from jaxnarx.sweep.number_type import is_float64
from jaxnarx.sweep.work import Work

GLANCE = 0.2
"""Seconds between two looks of the parent at the folder."""

_ONE_THREAD = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
_POOLS = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")


def compute_in_processes(
    run: RunFolder, work: Work, workers: int, tell: Callable[[], None]
) -> list[str]:
    """Have `workers` new processes compute what is open; returns notes.

    Each runs on one thread and, where the system allows, one core, with this process's
    number type. They help one another through the claims of the folder: if one is
    killed the others do its part. An error in one of them is raised here.
    """
    load = pickle.dumps(work)
    cores = _cores()
    crew: list[tuple[Any, Connection]] = []
    try:
        with _environment(_child_environment()):
            for n in range(min(workers, len(run.unfinished()))):
                core = cores[n % len(cores)] if cores else None
                with _deaf():
                    crew.append(_start(run, load, core))
        while any([process.is_alive() for process, _ in crew]):  # reaps each
            tell()
            time.sleep(GLANCE)
        tell()
        return _outcome(run, crew)
    finally:
        _end([process for process, _ in crew])
        clear_dead(run.claims)


def _start(run: RunFolder, load: bytes, core: int | None) -> tuple[Any, Connection]:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_help, args=(run, load, core, theirs), daemon=True)
    process.start()
    theirs.close()
    return process, ours


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """A process started inside never hears Ctrl-C, which reaches the whole group; it is
    this process that ends it. Here signals are heard afterwards, not halfway.
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


def _help(run: RunFolder, load: bytes, core: int | None, answer: Connection) -> None:
    """What a child does. The work is unpickled once its core is settled."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, daemon=True).start()
    if core is not None:
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, {core})
    from jaxnarx.sweep.loop import work_through

    try:
        work_through(run, pickle.loads(load), lambda: None)
    except JaxnarxError as error:
        answer.send(error)


def _die_with_parent() -> None:
    """Where the parent was killed; chunks in flight are computed by the next run."""
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)


def _outcome(run: RunFolder, crew: list[tuple[Any, Connection]]) -> list[str]:
    for _, answer in crew:
        if (error := _received(answer)) is not None:
            raise error
    lost = [process.exitcode for process, _ in crew if process.exitcode]
    if not (missing := run.unfinished()):
        return [f"{len(lost)} of {len(crew)} processes were lost"] if lost else []
    codes = ", ".join(str(code) for code in lost)
    raise JaxnarxError(
        f"{run.path}: the processes ended (exit codes {codes}) with {len(missing)} of "
        f"{run.chunks} chunks open. A code of -9 is often the system's answer to too "
        "little memory: use fewer workers. The same command continues."
    )


def _received(answer: Connection) -> JaxnarxError | None:
    try:
        return answer.recv() if answer.poll() else None
    except EOFError:
        return None


def _end(processes: list[Any]) -> None:
    """At once, whatever they compute: a killed process leaves nothing that hurts."""
    for process in processes:
        process.kill()
    for process in processes:
        process.join()


def _cores() -> list[int]:
    """Cores this process may use; empty where the system does not tell."""
    with contextlib.suppress(AttributeError, OSError):
        return sorted(os.sched_getaffinity(0))
    return []


def _child_environment() -> dict[str, str]:
    """One thread for everything, and jax configured as it is here."""
    flags = os.environ.get("XLA_FLAGS", "")
    settings = {f"{name}_NUM_THREADS": "1" for name in _POOLS}
    settings["XLA_FLAGS"] = f"{flags} {_ONE_THREAD}".strip()
    settings["JAX_ENABLE_X64"] = str(int(is_float64()))
    for name in ("jax_compilation_cache_dir", "jax_platforms"):
        if value := getattr(jax.config, name):
            settings[name.upper()] = str(value)
    return settings


@contextlib.contextmanager
def _environment(settings: dict[str, str]) -> Iterator[None]:
    """Variables that a process started inside inherits; ours are as before after."""
    before = {name: os.environ.get(name) for name in settings}
    os.environ.update(settings)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
