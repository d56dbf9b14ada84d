"""Ctrl-C and SIGTERM: the command ends soon, in order if it can, and without noise.

Python hears a signal between two of its own steps. It is then raised as a
KeyboardInterrupt, on whose way out files are cleared away. Where it is swallowed (by an
import that takes it for a missing package, or by the garbage collector), whatever error
follows counts as the interrupt, see `requested_exit_code`. A program of jax may compute
for minutes between two such steps: after `ENDING_SECONDS` seconds the process ends all
the same. What it leaves then is cleared by later runs, as after a kill. Work that has a
result to show at any time is given the time to do so, see `finish_on_interrupt`.
"""

import contextlib
import dataclasses
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

ENDING_SECONDS = 3.0
"""Seconds that an interrupted command has to end by itself."""

RAISE_AGAIN_SECONDS = 0.05
"""Seconds until an interrupt that was swallowed is raised again."""

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)

_received: list[int] = []
_swallowed = threading.Event()
_last_words: list[Callable[[], object]] = []
_patient: list[Callable[[], object]] = []


def listen() -> None:
    """Take SIGINT and SIGTERM for the rest of this process."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    # The system writes here at once, even while Python is kept waiting.
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(read,), daemon=True).start()
    sys.unraisablehook = _hook(sys.unraisablehook)
    for number in ENDING_SIGNALS:
        signal.signal(number, _raise)


def requested_exit_code() -> int:
    """The exit code of the signal that asked this process to end; 0 if none did."""
    return 128 + _received[0] if _received else 0


@contextlib.contextmanager
def last_words(tell: Callable[[], object]) -> Iterator[None]:
    """Tell this if the process has to be ended while it lasts."""
    _last_words.append(tell)
    try:
        yield
    finally:
        _last_words.remove(tell)


@dataclasses.dataclass
class Patience:
    """Whether Ctrl-C has asked the work to end with what it has."""

    used: bool = False


@contextlib.contextmanager
def finish_on_interrupt(tell: Callable[[], object]) -> Iterator[Patience]:
    """Give the work inside all the time that it needs after a first Ctrl-C.

    It gets a KeyboardInterrupt as always, and `tell` is called at once, in another
    thread, to say that it was heard. A second Ctrl-C, or SIGTERM, ends the process as
    without this. If the work returns all the same, the interrupt is done with: `used`
    says that there was one.
    """
    patience = Patience()
    _patient.append(tell)
    try:
        yield patience
        if set(_received) == {signal.SIGINT}:
            patience.used = True
            _received.clear()
        elif _received:
            raise KeyboardInterrupt
    finally:
        _patient.remove(tell)


def _raise(number: int, frame: Any) -> None:
    _received.append(number)
    raise KeyboardInterrupt


def _hook(before: Callable[[Any], object]) -> Callable[[Any], object]:
    """Let no exception out of jax's callback in the garbage collector, for one."""

    def listen_to(found: Any) -> None:
        if issubclass(found.exc_type, KeyboardInterrupt):
            _swallowed.set()
        else:
            before(found)

    return listen_to


def _watch(signals: int) -> None:
    number = _end_on_signal(signals)
    if number == signal.SIGINT and _patient:
        with contextlib.suppress(Exception):
            _patient[-1]()
        number = _second_signal(signals)
    until = time.monotonic() + ENDING_SECONDS
    while time.monotonic() < until:
        time.sleep(RAISE_AGAIN_SECONDS)
        if _swallowed.is_set():
            _swallowed.clear()
            signal.raise_signal(number)
    with contextlib.suppress(Exception):
        for tell in list(_last_words):
            tell()
    with contextlib.suppress(OSError):
        os.write(2, b"jaxnarx: interrupted\n")
    os._exit(128 + number)


def _end_on_signal(signals: int) -> int:
    """The next signal that asks the process to end."""
    while (number := os.read(signals, 1)[0]) not in ENDING_SIGNALS:
        pass
    return number


def _second_signal(signals: int) -> int:
    """The signal after a first Ctrl-C, which is raised again where it is swallowed."""
    ours = 0
    while True:
        if _swallowed.is_set():
            _swallowed.clear()
            ours += 1  # it comes back to us
            signal.raise_signal(signal.SIGINT)
        if not select.select([signals], [], [], RAISE_AGAIN_SECONDS)[0]:
            continue
        number = _end_on_signal(signals)
        if ours and number == signal.SIGINT:
            ours -= 1
            continue
        return number
